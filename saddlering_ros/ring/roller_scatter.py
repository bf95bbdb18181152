"""The effect of the unequal rollers of a sound ring on its displacement: nuisance parameters.

Gap and stiffness of every roller differ a little. To first order a gap change g_i moves the ring
by S^-1 k_i v_i g_i and a stiffness change e_i by -S^-1 F_i v_i e_i, with v_i the roller's
penetration by (delta_x, delta_y, gamma), k_i its tangent stiffness and S the sum of k_i v_i v_i'.
Both are averaged over the scatter, because a roller that is about to touch is partly in contact.
"""

from collections.abc import Callable

import numpy as np

from saddlering_ros.rig import Displacement, Rig, RollerRow
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
KNOWN = ('clearance_axial', 'clearance_radial', 'weight')
"""Sources of `stated_errors.CERTIFIED` whose errors are those of `known_rigs`."""
GRID = 70
"""Loads at which the columns are computed. The spread of a run is within 0.5 to 5 % (rms) of that
with 1120. Single columns of a dynamic run, narrow where a roller touches, settle on no grid."""
SOUND_LOADS = 25
"""The same for `sound_deviation`, which 200 loads change by 5 %."""
CURVATURE = 1.5
"""Approximate standard deviation of the square of a standard normal number."""
COLUMNS = 60
"""Directions kept of the scatter; of a dynamic run they leave out 2e-7 of its variance."""
_NODES, _WEIGHTS = np.polynomial.hermite_e.hermegauss(7)
_WEIGHTS = _WEIGHTS / _WEIGHTS.sum()


def scatter_columns(
    rig: Rig, contact: Floats, elevation: float, zero_load: float, load: Floats, time: Floats,
    probes: Floats, *, static: bool
) -> Floats:
    """Probe increments (4, N, k) along a run by one standard deviation of the scatter.

    probes (4, N) [m] are simulated at the base values; `static`: the run lies in holds, in which
    the ring rests. The rollers in contact are those of the simulated motion, which lags behind the
    load. The dampers delay the contribution of the scatter too.
    """
    low, high = float(load.min()), float(load.max())
    # A finer grid where contact begins.
    grid = low + (high - low) * np.linspace(0.0, 1.0, GRID) ** 1.5
    motion = static_response(rig, contact, elevation, grid)
    per_load = np.gradient(motion, grid, axis=1)
    columns, moving, decay = map(np.nan_to_num, _columns_at(rig, contact, motion.T, per_load.T))

    zero = static_response(rig, contact, elevation, np.array([zero_load]))[:, 0]
    moved = probes_to_displacement(rig.probes, probes)
    parts = []
    for row, seen, rows in ((0, moved.delta_x, slice(0, 1)), (2, moved.gamma, slice(1, 3))):
        # Loads (N,) under which the ring would rest at its motion: by delta_x, and by gamma.
        rising = np.maximum.accumulate(motion[row] - zero[row])
        at_rest = np.interp(np.asarray(seen), rising, grid)
        rate = np.zeros(time.size) if static else np.gradient(at_rest, time)
        place = np.clip(np.searchsorted(grid, at_rest) - 1, 0, grid.size - 2)
        below = grid[place]
        share = np.clip((at_rest - below) / (grid[place + 1] - below), 0.0, 1.0)[:, None, None]
        still, by_rate, decays = ((1.0 - share) * at[place] + share * at[place + 1]
                                  for at in (columns[:, rows], moving[:, rows], decay[:, rows]))
        parts.append((still + rate[:, None, None] * by_rate, decays))
    q, decays = (np.concatenate(pair, axis=1) for pair in zip(*parts, strict=True))
    if not static:
        # The columns (N, 3, k) lag behind their equilibrium: dq/dt = decay (equilibrium - q). Two
        # implicit half steps per sample, to the equilibrium at half the step and at its end.
        late = q.copy()
        speed = 0.5 * np.diff(time)[:, None, None] * decays[1:]
        inverse = np.linalg.inv(np.eye(3) + speed)
        pull = inverse @ speed
        drawn = inverse @ (pull @ (0.5 * (q[:-1] + q[1:]))) + pull @ q[1:]
        kept = inverse @ inverse
        for index in range(time.size - 1):
            late[index + 1] = kept[index] @ late[index] + drawn[index]
        q = late
    return displacement_to_probes(rig.probes, Displacement(q[:, 0], q[:, 1], q[:, 2], 0.0))


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


def known_errors(
    rig: Rig, predict: Callable[[Rig], Floats], usual: Floats
) -> list[Floats]:
    """Changes of a prediction by one standard deviation of each quantity of `known_rigs`.

    The changes by the square of each follow. usual (...): the prediction for `rig` itself.
    """
    sides = [(predict(above), predict(below)) for above, below in known_rigs(rig)]
    return [*(0.5 * (above - below) for above, below in sides),
            *(CURVATURE * (0.5 * (above + below) - usual) for above, below in sides)]


def sound_deviation(
    rig: Rig, contact: Floats, elevation: float, load: Floats, zero_load: float
) -> Floats:
    """Rms (3,) [m, m, rad] by which small errors of a sound ring move it at loads (N,).

    One standard deviation of unequal rollers, of clearances and of the weight together, counted
    from the zero. Commands that judge a residual allow for it beside the noise.
    """
    low, high = float(load.min()), float(load.max())
    grid = np.append(zero_load, np.linspace(low, high, SOUND_LOADS))
    motion = static_response(rig, contact, elevation, grid)
    columns = _columns_at(rig, contact, motion.T, np.zeros_like(motion.T))[0]
    changes = [np.nan_to_num(columns)]
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


def _columns_at(rig: Rig, contact: Floats, q: Floats,
                per_load: Floats) -> tuple[Floats, Floats, Floats]:
    """Motion (G, 3, k) at q (G, 3) by one standard deviation of every gap and every stiffness.

    The second result is the part that the dampers add per rate of the load, where q moves by
    `per_load` (G, 3) [1/N]: a roller that touches early is damped early. The third result is the
    rate (G, 3, 3) [1/s] at which the dampers let a displacement decay. Mirror twins move the ring
    equally: one column of sqrt(2) times the height has the covariance of both.
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
    stiffness = np.repeat([contact[0], contact[3]], counts)
    exponent = np.repeat([contact[1], contact[4]], counts)
    dampers = np.repeat([contact[2], contact[5]], counts)
    depth = q @ directions - half_gap
    spread = depth[..., None] + GAP_SCATTER * _NODES
    touching = np.maximum(spread, 0.0)
    forces = stiffness[:, None] * touching ** exponent[:, None]
    tangents = exponent[:, None] * forces / np.maximum(touching, 1e-12)
    force, tangent = forces @ _WEIGHTS, tangents @ _WEIGHTS
    plain = stiffness * np.maximum(depth, 0.0) ** exponent
    touched = (spread > 0.0) @ _WEIGHTS
    density = np.exp(-0.5 * (depth / GAP_SCATTER) ** 2) / (GAP_SCATTER * np.sqrt(2.0 * np.pi))
    speed = per_load @ directions

    def per_roller(amounts: Floats) -> Floats:
        return np.asarray(directions * amounts[:, None, :])

    def together(amounts: Floats) -> Floats:
        return np.asarray((twins * amounts) @ directions.T)[..., None]

    system = _held(per_roller(twins * tangent) @ directions.T, 1e-9, axial.pitch_radius)
    answer = np.linalg.solve(system, np.concatenate([
        per_roller(spreads * tangent * GAP_SCATTER),
        -per_roller(spreads * force * STIFFNESS_SCATTER),
        -together(force - plain)], axis=2))
    by_gap = per_roller(spreads * dampers * density * speed * GAP_SCATTER)
    moving = np.linalg.solve(system, np.concatenate([
        by_gap, np.zeros_like(by_gap),
        -together(dampers * speed * (touched - (depth > 0.0)))], axis=2))
    damping = _held(per_roller(twins * dampers * touched) @ directions.T, 1e-6, axial.pitch_radius)
    return np.asarray(answer), np.asarray(moving), np.asarray(np.linalg.solve(damping, system))


def _held(matrices: Floats, share: float, radius: float) -> Floats:
    """Matrices (G, 3, 3) plus a share of their trace on the diagonal, so that none is singular."""
    trace = np.trace(matrices, axis1=1, axis2=2)[:, None, None]
    return np.asarray(matrices + share * trace * np.diag([1.0, 1.0, radius**2]))


def compressed(columns: Floats) -> Floats:
    """At most COLUMNS columns with almost the same covariance as columns (n, k)."""
    values, vectors = np.linalg.eigh(columns.T @ columns)
    order = np.argsort(values)[::-1][:COLUMNS]
    order = order[values[order] > 1e-12 * values[-1]]
    return np.asarray(columns @ vectors[:, order])
