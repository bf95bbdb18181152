"""Small errors of a sound ring, of its rig file, and of instruments: nuisance parameters.

An error that a certificate states is a size of effects of the catalogue or of dimensions, by their
ids: an identification and a diagnosis simulate the same one.

Gap and stiffness of every roller differ a little. To first order a gap change g_i moves the ring
by S^-1 k_i v_i g_i and a stiffness change e_i by -S^-1 F_i v_i e_i, with v_i the roller's
penetration by (delta_x, delta_y, gamma), k_i its tangent stiffness and S the sum of k_i v_i v_i'.
Both are averaged over the scatter, because a roller that is about to touch is partly in contact.
A roller can only push: where the load falls, its damper ends the contact before its gap opens.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
import math
from typing import Any

import numpy as np

from saddlering_ros.effects.extension import at_probe, NO_EXTENSION, RingExtension
from saddlering_ros.rig import Displacement, Rig, RollerRow
from saddlering_ros.rig.description import place_of
from saddlering_ros.rig.geometry import displacement_to_probes, probes_to_displacement
from saddlering_ros.ring.model import Floats
from saddlering_ros.ring.simulator import static_response

GAP_SCATTER = 1.5e-6
"""Standard deviation of the gaps of single rollers [m] in a sound ring."""
STIFFNESS_SCATTER = 0.03
"""Standard deviation of the stiffness of single rollers, as a share."""
CLEARANCE_UNKNOWN = 1e-6
"""Standard deviation [m] of the mean clearance of a row."""
WEIGHT_UNKNOWN = 0.02
"""Standard deviation of the weight of the carriage, as a share."""
LOAD_WANDER = 1e-4
"""Slow wander of a load cell as a share of full scale."""
KNOWN = ('clearance_axial', 'clearance_radial', 'weight')
"""Sources of `CERTIFIED` whose errors are those of `known_rigs`."""
SOUND_LOADS = 25
"""Loads at which `sound_deviation` is computed; 200 change it by 5 %."""
CURVATURE = 1.5
"""Approximate standard deviation of the square of a standard normal number."""
PHASES = np.arange(1, 5) / 8.0
"""Places of the first roller, in the pitch, that show four periods of what the place does. With
two, rings of 24 and 36 rollers kept 5 to 57 times as much squared misfit."""
PHASE_SPREAD = math.sqrt(1.5)
"""Root of the mean square of 1 - cos(phase), of any phase alike."""
COLUMNS = 60
"""Directions kept of the scatter; of a dynamic run they leave out 2e-7 of its variance."""
_NODES, _WEIGHTS = np.polynomial.hermite_e.hermegauss(7)
_WEIGHTS = _WEIGHTS / _WEIGHTS.sum()


def scatter_columns(rig: Rig, contact: Floats, elevation: float, zero_load: float, time: Floats,
                    probes: Floats, *, static: bool) -> Floats:
    """Probe increments (4, N, k) along a run by one standard deviation of the scatter.

    probes (4, N) [m] are simulated at the base values; `static`: the run lies in holds, in which
    the ring rests. The rollers in contact are those of the simulated motion, which lags behind the
    load. The dampers delay the contribution of the scatter too.
    """
    zero = static_response(rig, contact, elevation, np.array([zero_load]))[:, 0]
    moved = probes_to_displacement(rig.probes, probes)
    motion = zero + np.stack([moved.delta_x, moved.delta_y, moved.gamma], axis=1)
    rate = np.zeros_like(motion) if static else np.gradient(motion, time, axis=0)
    ring = _linearised(rig, contact, motion, rate)
    q = _at_rest(ring) if static else _delayed(ring, np.diff(time))
    return displacement_to_probes(rig.probes, Displacement(q[:, 0], q[:, 1], q[:, 2], 0.0))


def at_other_phases(extension: RingExtension) -> list[RingExtension]:
    """Rings whose first roller of one row is at each of `PHASES`."""
    return [replace(extension, **{row: replace(getattr(extension, row), phase=phase)})
            for row in ('upper_row', 'lower_row', 'radial_row') for phase in PHASES.tolist()]


def phase_errors(changes: Floats) -> Floats:
    """Changes (12, ...) by one standard deviation of the phases, from those of `at_other_phases`.

    Nobody knows at which angle the rollers of a row stand. Mirror symmetry leaves the cosines of
    whole multiples of the phase, whose amplitudes the changes give.
    """
    multiples = np.arange(1, PHASES.size + 1)
    cosines = np.cos(2.0 * np.pi * np.outer(PHASES, multiples)) - 1.0
    of_rows = changes.reshape(-1, PHASES.size, math.prod(changes.shape[1:]))
    amplitudes = np.linalg.solve(cosines, of_rows)
    return np.asarray(PHASE_SPREAD * amplitudes.reshape(changes.shape))


def known_rigs(rig: Rig) -> list[tuple[Rig, Rig]]:
    """The rig with each uncertain quantity one standard deviation above and below its value.

    With exact clearances and weight, a fit would separate a common gain of the load from the
    stiffnesses, which real data do not allow.
    """
    stated = rig.instruments
    clearance = CLEARANCE_UNKNOWN if stated.clearance is None else stated.clearance
    share = WEIGHT_UNKNOWN if stated.weight is None else stated.weight
    quantities = (('axial_rows', 'clearance', clearance), ('radial_row', 'clearance', clearance),
                  ('carriage', 'weight', share * rig.carriage.weight))
    return [(rig.changed(part, entry, std), rig.changed(part, entry, -std))
            for part, entry, std in quantities]


def known_errors(rig: Rig, predict: Callable[[Rig], Floats], usual: Floats) -> list[Floats]:
    """Changes of a prediction by one standard deviation of each quantity of `known_rigs`.

    The changes by the square of each follow. usual (...): the prediction for `rig` itself.
    """
    sides = [(predict(above), predict(below)) for above, below in known_rigs(rig)]
    return [*(0.5 * (above - below) for above, below in sides),
            *(CURVATURE * (0.5 * (above + below) - usual) for above, below in sides)]


def sound_deviation(rig: Rig, contact: Floats, elevation: float, load: Floats,
                    zero_load: float) -> Floats:
    """Rms (3,) [m, m, rad] by which small errors of a sound ring move it at loads (N,).

    One standard deviation of unequal rollers, of clearances and of the weight together, counted
    from the zero. Commands that judge a residual allow for it beside the noise.
    """
    low, high = float(load.min()), float(load.max())
    grid = np.append(zero_load, np.linspace(low, high, SOUND_LOADS))
    motion = static_response(rig, contact, elevation, grid)
    changes = [_at_rest(_linearised(rig, contact, motion.T, np.zeros_like(motion.T)))]
    for above, below in known_rigs(rig):
        sides = [static_response(other, contact, elevation, grid) for other in (above, below)]
        changes.append(np.nan_to_num(0.5 * (sides[0] - sides[1])).T[:, :, None])
    moved = np.concatenate(changes, axis=2)
    variance = ((moved[1:] - moved[:1]) ** 2).sum(axis=2)
    at_loads = [np.interp(load, grid[1:], of_channel) for of_channel in variance.T]
    return np.sqrt(np.mean(at_loads, axis=1))


def _half(row: RollerRow) -> tuple[Floats, Floats]:
    """Cosines of the rollers of one side of a row, and the number of rollers with each."""
    index = np.arange(row.rollers // 2 + 1)
    twins = np.where((index == 0) | (2 * index == row.rollers), 1.0, 2.0)
    return np.cos(2.0 * np.pi * index / row.rollers), twins


@dataclass(frozen=True)
class _Linearised:
    """The ring along a motion of N samples, with k columns of one standard deviation."""

    force: Floats  # (N, 3, k): that the columns add
    landed: Floats  # (N, 3, R): impulse of dampers that act anew, by gaps (the first R columns)
    stiffness: Floats  # (N, 3, 3)
    damping: Floats  # (N, 3, 3)
    kept: Floats  # (N, 3, 3): damping by rollers that touched at the sample before, too


def _linearised(rig: Rig, contact: Floats, q: Floats, rate: Floats) -> _Linearised:
    """The ring at motion q (N, 3) of this rate, by one deviation of every gap and stiffness.

    Rollers can only push. Mirror twins move the ring equally: one column of sqrt(2) times the
    height has the covariance of both.
    """
    axial, middle = rig.axial_rows, rig.radial_row
    (first, axial_twins), (second, radial_twins) = _half(axial), _half(middle)
    twins = np.concatenate([axial_twins, axial_twins, radial_twins])
    spreads = np.sqrt(twins)
    zero, one = np.zeros_like(first), np.ones_like(first)
    upper = np.stack([zero, one, -axial.pitch_radius * first])
    radial = np.stack([second, np.zeros_like(second), middle.height * second])
    directions = np.hstack([upper, -upper, radial])
    counts = (2 * first.size, second.size)
    half_gap = np.repeat([0.5 * axial.clearance, 0.5 * middle.clearance], counts)
    stiffness, exponent, dampers = np.repeat(np.reshape(contact, (2, 3)), counts, axis=0).T
    depth, speed = q @ directions - half_gap, rate @ directions

    def pushing(penetration: Floats) -> tuple[Floats, Floats]:
        """Elastic forces (N, ...) of rollers that push, and whether they do."""
        elastic = stiffness * np.maximum(penetration, 0.0) ** exponent
        pushes = (elastic > 0.0) & (elastic + dampers * speed > 0.0)
        return np.where(pushes, elastic, 0.0), pushes

    force, tangent, touched = (np.zeros_like(depth) for _ in range(3))
    for node, weight in zip(_NODES, _WEIGHTS, strict=True):
        penetration = depth + GAP_SCATTER * node
        elastic, pushes = pushing(penetration)
        force += weight * elastic
        tangent += weight * exponent * elastic / np.maximum(penetration, 1e-12)
        touched += weight * pushes
    plain, pushes = pushing(depth)
    before = np.concatenate([touched[:1], touched[:-1]])

    def per_roller(amounts: Floats) -> Floats:
        return np.asarray(directions * amounts[:, None, :])

    def between(amounts: Floats) -> Floats:
        return np.asarray(per_roller(twins * amounts) @ directions.T)

    mean = twins * (force - plain + dampers * speed * (touched - pushes))
    return _Linearised(
        np.concatenate([
            per_roller(spreads * tangent * GAP_SCATTER),
            -per_roller(spreads * force * STIFFNESS_SCATTER), -(mean @ directions.T)[..., None],
        ], axis=2),
        per_roller(spreads * dampers * np.maximum(touched - before, 0.0) * GAP_SCATTER),
        _held(between(tangent), axial.pitch_radius), between(dampers * touched),
        between(dampers * np.minimum(touched, before)))


def _at_rest(ring: _Linearised) -> Floats:
    """Motion (N, 3, k) that the columns add to a ring at rest."""
    return np.nan_to_num(np.linalg.solve(ring.stiffness, ring.force))


def _delayed(ring: _Linearised, steps: Floats) -> Floats:
    """Motion (N, 3, k) that the columns add in time steps (N - 1,) [s]: D dq/dt + S q = force.

    A damper that begins to act leaves the impulse D q of the others as it is, and adds that of
    its gap. There are two implicit half steps per sample.
    """
    half = 0.5 * steps[:, None, None]
    force, damping = ring.force, ring.damping[1:]
    inverse = np.linalg.inv(damping + half * ring.stiffness[1:])
    first = inverse @ damping @ inverse
    drawn = first @ (half * 0.5 * (force[:-1] + force[1:])) + inverse @ (half * force[1:])
    drawn[..., :ring.landed.shape[2]] += first @ ring.landed[1:]
    kept = first @ ring.kept[1:]
    late = _at_rest(ring)
    for index in range(steps.size):
        late[index + 1] = kept[index] @ late[index] + drawn[index]
    return np.nan_to_num(late)


def _held(matrices: Floats, radius: float) -> Floats:
    """Stiffnesses (N, 3, 3) plus 1e-9 of their trace on the diagonal: then none is singular.

    A trace below 1 N/m is that of a ring within its clearances, which no roller touches.
    """
    trace = np.maximum(np.trace(matrices, axis1=1, axis2=2), 1.0)[:, None, None]
    return np.asarray(matrices + 1e-9 * trace * np.diag([1.0, 1.0, radius**2]))


def compressed(columns: Floats) -> Floats:
    """At most COLUMNS columns with almost the same covariance as columns (n, k)."""
    values, vectors = np.linalg.eigh(columns.T @ columns)
    order = np.argsort(values)[::-1][:COLUMNS]
    order = order[values[order] > 1e-12 * values[-1]]
    return np.asarray(columns @ vectors[:, order])


SmallError = Mapping[str, Mapping[str, float]]
"""Sizes by parameter, by the id of an effect or a dimension."""


@dataclass(frozen=True)
class Dimension:
    """An entry of the rig file.

    usual: an error [unit] that a wrong drawing would give; reach: the largest that is searched;
    least: the smallest possible value.
    """

    entry: str
    title: str
    unit: str
    usual: float
    reach: float
    least: float = -np.inf

    def read(self, rig: Rig) -> float:
        part, field = place_of(self.entry)
        return float(getattr(getattr(rig, part), field))

    def changed(self, rig: Rig, change: float) -> Rig:
        """The rig with another value of the entry."""
        part, field = place_of(self.entry)
        return rig.changed(part, field, change)


DIMENSIONS: Mapping[str, Dimension] = {
    'rig_weight': Dimension('carriage.weight', 'Weight', 'N', 8e3, 1e5, 0.0),
    'rig_weight_x': Dimension('carriage.weight_x', 'Place of the weight', 'm', 0.05, 1.0),
    'rig_trunnion_x': Dimension('trunnion.x', 'trunnion.x', 'm', 0.05, 0.5),
    'rig_axial_span': Dimension(
        'probes.axial_span', 'Span of the axial probes', 'm', 0.03, 0.6, 0.1),
    'rig_axial_radius': Dimension(
        'axial_rows.pitch_radius', 'Pitch radius of the axial rows', 'm', 0.02, 0.3, 0.1),
    'rig_radial_row_height': Dimension(
        'middle_row.height', 'Height of the radial row', 'm', 0.02, 0.3)}
"""By the id of the effect."""

ROWS: Mapping[str, tuple[str, ...]] = {
    'axial_clearance': ('upper_row', 'lower_row'), 'radial_clearance': ('radial_row',)}
"""Rows of which an effect changes the clearance."""

CERTIFIED = {
    'load_gain': ('load_gain', 'load_gain', 'gain'),
    'load_offset': ('load_offset', 'load_offset', 'offset'),
    'load_nonlinearity': ('load_nonlinearity', 'load_nonlinearity', 'curvature'),
    'elevation': ('elevation', 'elevation_error', 'angle'),
    'probe_lag': ('probe_lag', 'probe_lag', 'time'), 'clock': ('clock', 'clock_offset', 'offset'),
    'clearance_axial': ('clearance', 'axial_clearance', 'change'),
    'clearance_radial': ('clearance', 'radial_clearance', 'change'),
    'weight': ('weight', 'rig_weight', 'change'),
    'trunnion_x': ('trunnion', 'rig_trunnion_x', 'change'),
    'trunnion_y': ('trunnion', 'moment_arm', 'offset'),
    'axial_span': ('axial_span', 'rig_axial_span', 'change'),
    'radial_height': ('radial_height', 'probe_height', 'height'),
    'probe_gain': ('probe_gain', 'probe_gain', 'gain'),
    'probe_nonlinearity': ('probe_nonlinearity', 'probe_nonlinearity', 'curvature')}
"""Entry of rig.instruments, effect or dimension, and its parameter, by source in a budget."""


def certified_errors(rig: Rig) -> dict[str, SmallError]:
    """One standard uncertainty of each instrument and dimension that a certificate states.

    By source in a budget. The size comes last, after the number of a probe.
    """
    errors: dict[str, SmallError] = {}
    for source, (entry, effect_id, parameter) in CERTIFIED.items():
        stated = getattr(rig.instruments, entry)
        if stated is None:
            continue
        if entry in ('probe_gain', 'probe_nonlinearity'):
            sizes = np.broadcast_to(stated, 4).tolist()
            for number in rig.probes.present:
                errors[f'{source}_{number}'] = {
                    effect_id: {'probe': float(number), parameter: sizes[number - 1]}}
        else:
            size = stated * rig.carriage.weight if entry == 'weight' else stated
            errors[source] = {effect_id: {parameter: size}}
    return errors


Machine = tuple[Rig, RingExtension]
"""A rig with its dimensions, and the errors of its ring."""


def with_error(rig: Rig, error: SmallError) -> Machine:
    """The rig with the dimensions of an error, and the extension by its effects.

    The extension has a field for each of these effects, so that a catalogue may lack them.
    """
    extension = NO_EXTENSION
    for name, values in error.items():
        size = [*values.values()][-1]
        if name in DIMENSIONS:
            rig = DIMENSIONS[name].changed(rig, size)
            continue
        changed: dict[str, Any] = {row: replace(getattr(extension, row), gap=0.5 * size)
                                   for row in ROWS.get(name, ())}
        if not changed:
            field = getattr(extension, name)
            changed[name] = at_probe(
                field, round(values.get('probe', 0.0)), size) if isinstance(field, tuple) else size
        extension = replace(extension, **changed)
    return rig, extension
