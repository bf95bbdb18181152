"""Exact derivatives of motion and readings by contact law, loads, friction and rollers.

One simulation and one pass along it give the derivatives by all parameters; finite differences
would take one simulation per parameter. Parameters of the equation of motion are differentiated by
the implicit function theorem (`kernels/tangents.py`). Additions to motion and readings are
computed anew, which costs little.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike, NDArray

from saddlering_ros.effects import own_parameters
from saddlering_ros.effects.extension import READING, RingExtension
from saddlering_ros.rig import Rig
from saddlering_ros.ring.kernels import courses, integration, tangents
from saddlering_ros.ring.kernels.row_tangents import LAW
from saddlering_ros.ring.model import (
    EXTENSION_FIELDS,
    MODEL,
    Model,
    model_of,
    read_motion_only,
    Rows,
    rows_of,
    same_motions,
    spread_rows,
    stacked_models,
    with_contact,
)
from saddlering_ros.ring.simulator import check_simulation, in_parallel, of_probes_clock

Floats = NDArray[np.float64]
Candidate = tuple[ArrayLike, RingExtension]


def _columns(*names: str) -> list[int]:
    """Indices of fields of the model's record, with all their parts, in its row of floats."""
    places: list[int] = []
    for name in names:
        kind, start = MODEL.fields[name][:2]  # type: ignore[index]
        places += range(start // 8, (start + kind.itemsize) // 8)
    return places


K, N, D = (_columns(a, a, b) for a, b in (('K1', 'K2'), ('n1', 'n2'), ('D1', 'D2')))
"""Indices of K, n and D of the upper, the lower and the radial row."""

CONTACT, (ELEVATION,) = _columns('K1', 'n1', 'D1', 'K2', 'n2', 'D2'), _columns('elevation')
FACTORS = _columns('upper_row_stiffness', 'lower_row_stiffness', 'radial_row_stiffness')
GROWTH = _columns('damping_penetration_share', 'damping_penetration_exponent',
                  'damping_penetration_saturation')
FRICTIONS = _columns('radial_friction', 'tilt_friction')
LOADS = _columns('cosine', 'sine', *(part[0] for part, stage, _ in EXTENSION_FIELDS
                                     if stage == 'load path'))
NO_TANGENT = [item for item in own_parameters()
              if item.acts_on != READING and item.stage != 'load path']
"""Parameters of laws inside the motion of the ring; only a simulation gives their effect."""


@dataclass(frozen=True)
class Responses:
    """Readings (4, N) [m] of a candidate, and first-order readings (P, 4, N) of its neighbours."""

    centre: Floats
    neighbours: Floats


@dataclass(frozen=True)
class _Path:
    """Steps of a simulation: time and load (M,), motion (M, 3), indices of the samples, readings.

    The first step is the rest at the zero. Readings (N, 4).
    """

    time: Floats
    load: Floats
    motion: Floats
    samples: NDArray[np.intp]
    readings: Floats

    def read_by(self, model: Model, zero_load: float, time: Floats, load: Floats) -> _Path:
        """The same motion as read by a model with other additions; NaN if steps failed."""
        readings = _read(model, zero_load, time, load, self.motion[self.samples])
        if not np.isfinite(self.readings).all():
            readings[:] = np.nan
        return replace(self, readings=readings)


@dataclass(frozen=True)
class FollowedMotion:
    """A motion of the ring without extension, (3, N) at the samples, and all its steps."""

    model: Model
    rows: Rows
    path: _Path

    @property
    def motion(self) -> Floats:
        return np.ascontiguousarray(self.path.motion[self.path.samples].T)

    def sensitivities(self) -> Floats:
        """Derivatives (6, 3, N) by K1, n1, D1, K2, n2, D2, in SI."""
        none = np.zeros((self.path.time.size, 3, 6))
        changes = _tangents(self.model, self.rows, _unit_laws(self.model), none,
                            np.zeros((6, 2, 4)), [], self.path)
        return np.ascontiguousarray(changes[self.path.samples].transpose(2, 1, 0))


def followed_motion(rig: Rig, contact: ArrayLike, elevation: float, time: ArrayLike,
                    load: ArrayLike, max_step: float = 1e-3) -> FollowedMotion:
    """Motion of a contact law (6,) from rest at load[0], NaN where a step failed."""
    seconds, force = check_simulation(time, load, elevation, max_step)
    model = with_contact(model_of(rig, elevation), contact)
    rows = rows_of(rig)
    path = _simulate(model, rows, seconds, force, float(force[0]), max_step)
    if not np.isfinite(path.readings).all():
        path.motion[:] = np.nan
    return FollowedMotion(model, rows, path)


def motion_sensitivities(rig: Rig, contact: ArrayLike, elevation: float, time: ArrayLike,
                         load: ArrayLike, max_step: float = 1e-3) -> tuple[Floats, Floats]:
    """Motion (3, N) of a contact law (6,) from rest at load[0], and its derivatives (6, 3, N)."""
    followed = followed_motion(rig, contact, elevation, time, load, max_step)
    return followed.motion, followed.sensitivities()


def steps_taken(rig: Rig, contact: ArrayLike, elevation: float, time: ArrayLike, load: ArrayLike,
                max_step: float = 1e-3) -> tuple[Floats, Floats, Floats]:
    """Time (M,) [s], load (M,) [N], motion (3, M) at every step of a run from rest at load[0]."""
    seconds, force = check_simulation(time, load, elevation, max_step)
    model = with_contact(model_of(rig, elevation), contact)
    path = _simulate(model, rows_of(rig), seconds, force, float(force[0]), max_step)
    return path.time, path.load, np.ascontiguousarray(path.motion.T)


def static_sensitivities(rig: Rig, contact: ArrayLike, elevation: float,
                         equilibria: Floats) -> Floats:
    """Derivatives (6, 3, N) of equilibria (3, N) by the contact law (6,), in SI."""
    model = with_contact(model_of(rig, elevation), contact)
    rows = rows_of(rig)
    path = np.ascontiguousarray(equilibria.T)
    out = np.empty((path.shape[0], 3, 6))
    tangents.static_tangents(model, rows.flat, rows.uniform, _unit_laws(model), path, out)
    return np.ascontiguousarray(out.transpose(2, 1, 0))


def has_tangent(rig: Rig, centre: Candidate, neighbour: Candidate) -> bool:
    """Whether the pass along the centre is a cheaper way to a neighbour than a simulation.

    A pass with unequal rollers takes as long as several simulations. A saturation that begins has
    no derivative, and neither has the user's own law inside the motion.
    """
    (_, own), (_, other) = centre, neighbour
    if own is other and own.damping_penetration_saturation == 0.0:
        return True
    if any(item.of(own) != item.of(other) for item in NO_TANGENT):
        return False
    return rows_of(rig, own) is rows_of(rig, other) and (
        own.damping_penetration_saturation != 0.0 or other.damping_penetration_saturation == 0.0)


def probe_sensitivities(rig: Rig, groups: Sequence[tuple[Candidate, Sequence[Candidate]]],
                        elevation: float, time: ArrayLike, load: ArrayLike,
                        zero_load: float | None = None,
                        max_step: float = 1e-3) -> list[Responses]:
    """Readings of each candidate, and first-order readings of its neighbours.

    A group is a candidate (contact law, extension) and its neighbours, each a small step away.
    Arguments and readings are those of `simulator.probe_batch`.
    """
    seconds, force = check_simulation(time, load, elevation, max_step)
    if not groups:
        return []
    zero = float(force[0]) if zero_load is None else zero_load
    laws = np.array([np.asarray(law, dtype=np.float64) for (law, _), _ in groups])
    models = stacked_models(rig, laws, elevation, [extra for (_, extra), _ in groups])
    rows = [rows_of(rig, extra) for (_, extra), _ in groups]
    alike: dict[int, list[int]] = {}
    for index, first in enumerate(same_motions(models, rows).tolist()):
        alike.setdefault(first, []).append(index)
    members = list(alike.values())
    found: dict[int, Responses] = {}

    def run(part: slice) -> None:
        for indices in members[part]:
            first = indices[0]
            path = _simulate(models[first:first + 1], rows[first], seconds, force, zero, max_step)
            for index in indices:
                (_, extension), neighbours = groups[index]
                own = models[index:index + 1]
                same = path if index == first else path.read_by(own, zero, seconds, force)
                found[index] = _responses(rig, own, extension, neighbours, elevation, seconds,
                                          force, zero, same)

    in_parallel(run, len(members))
    return [found[index] for index in range(len(groups))]


def _responses(rig: Rig, model: Model, extension: RingExtension, neighbours: Sequence[Candidate],
               elevation: float, time: Floats, load: Floats, zero_load: float,
               path: _Path) -> Responses:
    """Readings of a candidate with a known path, and of its neighbours."""
    usual = of_probes_clock(path.readings.T, extension, time)
    if not neighbours:
        return Responses(usual, np.empty((0, *usual.shape)))
    laws = np.array([np.asarray(law, dtype=np.float64) for law, _ in neighbours])
    extensions = [extra for _, extra in neighbours]
    others = stacked_models(rig, laws, elevation, extensions)
    rollers = [rows_of(rig, extra) for extra in extensions]
    changes, moved = _neighbouring_motions(
        rig, model, others, extension, extensions, rollers, zero_load, path)
    answers = np.empty((len(others), 4, time.size))
    plain = read_motion_only(others) & read_motion_only(model)[0]
    answers[plain] = usual + _plain_readings(model, changes)[:, :, moved[plain]].transpose(2, 1, 0)
    sampled = path.motion[path.samples]
    for index in np.flatnonzero(~plain).tolist():
        read = _read(others[index:index + 1], zero_load, time, load,
                     sampled + changes[:, :, moved[index]])
        answers[index] = of_probes_clock(read.T, extensions[index], time)
    return Responses(usual, answers)


def _neighbouring_motions(rig: Rig, model: Model, others: Model, extension: RingExtension,
                          extensions: Sequence[RingExtension], rollers: Sequence[Rows],
                          zero_load: float, path: _Path) -> tuple[Floats, NDArray[np.intp]]:
    """Changes (N, 3, P) of the motion at the samples, and the index of each neighbour's change.

    The last change is zero; it belongs to neighbours with the same motion.
    """
    rows = rows_of(rig, extension)
    first = same_motions(np.concatenate([_floats(model), _floats(others)]).view(MODEL)[:, 0],
                         [rows, *rollers])[1:]
    moving = [index for index in range(len(others)) if first[index] != 0]
    moved = np.full(len(others), len(moving))
    sampled = np.zeros((path.samples.size, 3, len(moving) + 1))
    if not moving:
        return sampled, moved
    # Directions that change rollers come first, because the kernel identifies them by number.
    order = sorted(moving, key=lambda index: rollers[index] is rows)
    geometry = []
    count = sum(rollers[index] is not rows for index in order)
    if count:
        along = spread_rows(rig, extension)
        geometry = [spread_rows(rig, extensions[index]).flat - along.flat
                    for index in order[:count]]
        rows = along
        numbers = _floats(model)[0]
        model = with_contact(
            model_of(rig, float(numbers[ELEVATION]), extension, counts=rows.counts),
            numbers[CONTACT])
    own, aside = _floats(model), _floats(others)[order]
    external = np.zeros((path.time.size, 3, len(order)))
    loaded = np.flatnonzero((aside[:, LOADS] != own[:, LOADS]).any(axis=1))
    if loaded.size:
        course = _external(model, zero_load, path)
        for number in loaded.tolist():
            other = others[order[number]:order[number] + 1]
            external[:, :, number] = _external(other, zero_load, path) - course
    law = np.ascontiguousarray((_laws(aside) - _laws(own)).transpose(1, 2, 0))
    friction = (aside[:, FRICTIONS] - own[:, FRICTIONS]).reshape(-1, 2, 4)
    changes = _tangents(model, rows, law, external, friction, geometry, path)
    sampled[:, :, :-1] = changes[path.samples]
    moved[order] = np.arange(len(order))
    return sampled, moved


def _simulate(model: Model, rows: Rows, time: Floats, load: Floats, zero_load: float,
              max_step: float) -> _Path:
    """A run, and the motion at every step of the simulator."""
    motion, readings = np.empty((time.size, 3)), np.empty((time.size, 4))
    room = 2 + int(np.maximum(1.0, np.ceil(np.diff(time) / max_step)).sum())
    while True:
        record = np.empty((room, 5))
        record[0] = 0.0
        integration.run_recorded(model, rows.flat, rows.uniform, time, load, zero_load, max_step,
                                 motion, readings, record)
        steps = int(record[0, 0])
        if steps < room:
            break
        room = steps + 1
    lengths = record[1:steps + 1, 0].copy()
    samples = np.searchsorted(time[0] + np.append(0.0, np.cumsum(lengths)),
                              time - 1e-6 * max_step)
    # A step of twice the last one is still of second order; rounding must not exceed that.
    lengths[1:][lengths[1:] > 1.5 * lengths[:-1]] *= 1.0 - 1e-8
    return _Path(time[0] + np.append(0.0, np.cumsum(lengths)),
                 np.append(zero_load, record[1:steps + 1, 1]),
                 np.concatenate([motion[:1], record[1:steps + 1, 2:]]),
                 np.minimum(samples, steps), np.ascontiguousarray(readings))


def _tangents(model: Model, rows: Rows, law: Floats, external: Floats, friction: Floats,
              geometry: Sequence[Floats], path: _Path) -> Floats:
    changes = np.empty((path.time.size, 3, law.shape[2]))
    rollers = np.array(geometry) if geometry else np.empty((0, rows.flat.size))
    if not tangents.motion_tangents(model, rows.flat, rows.uniform, law, external, friction,
                                    rollers, path.time, path.motion, changes):
        changes[:] = np.nan
    return changes


def _external(model: Model, zero_load: float, path: _Path) -> Floats:
    external = np.empty((path.time.size, 3))
    courses.load_course(model, zero_load, path.load, external)
    return external


def _read(model: Model, zero_load: float, time: Floats, load: Floats, motion: Floats) -> Floats:
    out = np.empty((time.size, 4))
    courses.read_course(model, zero_load, time, load, np.ascontiguousarray(motion), out)
    return out


def _plain_readings(model: Model, motion: Floats) -> Floats:
    """Readings (N, 4, P) of motions (N, 3, P) without additions, as `courses.read_course`."""
    since = motion - motion[0]
    one = model[0]
    tilt = since[:, 2]
    radial, lean = since[:, 0] + one['probe_plane_height'] * tilt, 0.5 * one['axial_span'] * tilt
    return np.stack([radial, since[:, 1] + lean, -radial, since[:, 1] - lean], axis=1)


def _floats(model: Model) -> Floats:
    return model.view(np.float64).reshape(model.size, -1)


def _laws(models: Floats) -> Floats:
    """Laws (B, 3, LAW) of upper, lower and radial row; an exponent of 0 means n of the row."""
    share, exponent, saturation = (models[:, [place] * 3] for place in GROWTH)
    exponent = np.where(exponent > 0.0, exponent, models[:, N])
    return np.stack([models[:, K] * models[:, FACTORS], models[:, N], models[:, D], share,
                     exponent, saturation], axis=-1)


def _unit_laws(model: Model) -> Floats:
    """Change (3, LAW, 6) of the rows' laws by one unit of each contact parameter."""
    factors = _floats(model)[0, FACTORS]
    unit = np.zeros((3, LAW, 6))
    for row, first in ((0, 0), (1, 0), (2, 3)):
        unit[row, 0, first] = factors[row]
        unit[row, 1, first + 1] = unit[row, 2, first + 2] = 1.0
    return unit
