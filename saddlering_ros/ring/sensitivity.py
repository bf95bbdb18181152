"""Exact derivatives of motions and equilibria, and first-order readings of neighbours.

One simulation and one pass along it give the derivatives by all parameters of the contact law;
finite differences would take one simulation per parameter. The pass uses the implicit function
theorem (`kernels/tangents.py`).

A candidate is a contact law with an extension; its neighbours lie a small step away. Parameters of
the equation of motion are differentiated as above. Additions to motion and readings are computed
anew, which costs little. Elevation, time and load differ between runs; everything else is prepared
once for all runs.

The sensitivity to small errors of the load is that of the model linearised about a motion,
m d2(dq) + D(t) d(dq) + K(t) dq = b dP, with the tangent stiffness K and damping D of all rollers
in contact along the motion, by the difference formulas (BDF2) of the simulator.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike, NDArray

from saddlering_ros.effects import own_parameters
from saddlering_ros.effects.extension import READING, RingExtension
from saddlering_ros.rig import ContactParameters, Rig
from saddlering_ros.ring import model as ring_model
from saddlering_ros.ring import simulator
from saddlering_ros.ring.kernels import courses, integration, tangents
from saddlering_ros.ring.kernels.contact import LAW
from saddlering_ros.ring.kernels.tangents import LAWS, PLAIN_LAW
from saddlering_ros.ring.model import Floats, Model, model_of, Rows, rows_of
from saddlering_ros.ring.simulator import check_simulation, dynamic_batch


class FollowedMotion:
    """Motion (3, N) [m, m, rad] of a contact law (6,) from rest at load[0]; NaN if steps fail."""

    def __init__(self, rig: Rig, contact: ArrayLike, elevation: float, time: ArrayLike,
                 load: ArrayLike, max_step: float = 1e-3) -> None:
        seconds, force = check_simulation(time, load, elevation, max_step)
        self._model, self._rows = model_of(rig, elevation, contact), rows_of(rig)
        self.path = simulate_path(self._model, self._rows, seconds, force, float(force[0]),
                                  max_step)
        if not np.isfinite(self.path.readings).all():
            self.path.motion[:] = np.nan
        self.motion = np.ascontiguousarray(self.path.motion[self.path.samples].T)

    def sensitivities(self) -> Floats:
        """Derivatives (6, 3, N) by K1, n1, D1, K2, n2, D2, in SI."""
        changes = tangents_along(
            self._model, self._rows, unit_laws(self._model), np.empty((0, 3, 6)),
            np.zeros((6, 3, 4)), np.empty((0, self._rows.flat.size)), self.path)
        return np.ascontiguousarray(changes[self.path.samples].transpose(2, 1, 0))


def static_sensitivities(rig: Rig, contact: ArrayLike, elevation: float,
                         equilibria: Floats) -> Floats:
    """Derivatives (6, 3, N) of equilibria (3, N) by the contact law (6,), in SI."""
    model, rows = model_of(rig, elevation, contact), rows_of(rig)
    path = np.ascontiguousarray(equilibria.T)
    out = np.empty((path.shape[0], 3, 6))
    tangents.static_tangents(model, rows.flat, rows.uniform, unit_laws(model), path, out)
    return np.ascontiguousarray(out.transpose(2, 1, 0))


ROOM = 3
"""Records for each step of the largest length. Steps are divided where their error is too large:
a run of dirty rings had 1.8 times as many at most."""

K, N, D = (ring_model.columns(a, a, b) for a, b in (('K1', 'K2'), ('n1', 'n2'), ('D1', 'D2')))
"""Indices of K, n and D of the upper, the lower and the radial row."""

FACTORS = ring_model.columns('upper_row_stiffness', 'lower_row_stiffness', 'radial_row_stiffness')
GROWTH = ring_model.columns('damping_penetration_share', 'damping_penetration_exponent',
                            'damping_penetration_saturation')
FRICTIONS = ring_model.columns('radial_friction', 'axial_friction', 'tilt_friction')
LOADS = ring_model.columns('cosine', 'sine', *(
    entry[0] for entry, stage, _ in ring_model.EXTENSION_FIELDS if stage == 'load path'))


@dataclass(frozen=True)
class MotionPath:
    """Steps of a simulation; the first step is the rest at the zero."""

    time: Floats  # (M,) [s]
    load: Floats  # (M,) [N]
    motion: Floats  # (M, 3) [m, m, rad]
    samples: NDArray[np.intp]  # (N,): their steps
    readings: Floats  # (N, 4) [m]
    records: Floats  # (M, width): sums over the rollers, for tangents (kernels/courses.py)

    def read_by(self, model: Model, zero_load: float, time: Floats, load: Floats) -> 'MotionPath':
        """The same motion as read by a model with other additions; NaN if steps failed.

        zero_load [N]; time (N,) [s], load (N,) [N]: of the samples.
        """
        readings = np.empty((time.size, 4))
        courses.read_courses(model, zero_load, time, load, self.motion[self.samples],
                             *courses.UNCHANGED, readings[None])
        if not np.isfinite(self.readings).all():
            readings[:] = np.nan
        return replace(self, readings=readings)


def simulate_path(model: Model, rows: Rows, time: Floats, load: Floats, zero_load: float,
                  max_step: float, grows: bool = False) -> MotionPath:
    """A run of a model (1,) at every step; grows: for tangents by growing damping too."""
    grows = grows or bool(model['damping_penetration_share'][0])
    motion, readings = np.empty((time.size, 3)), np.empty((time.size, 4))
    # What is not used costs no memory, but without room the whole run is simulated once more.
    room = 2 + ROOM * int(np.maximum(1.0, np.ceil(np.diff(time) / max_step)).sum())
    while True:
        record = np.empty((room, LAWS + 5 * (LAW if grows else PLAIN_LAW)))
        integration.run_recorded(model, rows.flat, rows.uniform, time, load, zero_load, max_step,
                                 motion, readings, record, grows)
        steps = int(record[0, 0])
        if steps < room:
            break
        room = steps + 1
    step_time, step_load, moved = (np.empty((steps + 1, *more)) for more in ((), (), (3,)))
    samples = np.empty(time.size, dtype=np.intp)
    step_load[0], moved[0] = zero_load, motion[0]
    courses.steps_of_record(record, time, max_step, step_time, step_load, moved, samples)
    return MotionPath(step_time, step_load, moved, samples, readings, record[:steps + 1])


def tangents_along(model: Model, rows: Rows, law: Floats, external: Floats, friction: Floats,
                   geometry: Floats, path: MotionPath) -> Floats:
    """Changes (M, 3, P) at every step; NaN if that fails. See `tangents.motion_tangents`.

    rows: those to which `geometry` (G, 9 J) belongs.
    """
    changes = np.empty((path.time.size, 3, law.shape[2]))
    if not tangents.motion_tangents(model, rows.flat, law, external, friction, geometry,
                                    path.records, path.time, path.load[0], path.motion,
                                    changes):
        changes[:] = np.nan
    return changes


def external_along(model: Model, zero_load: float, path: MotionPath) -> Floats:
    """Force [N] and moment [N m] on the ring (M, 3) at every step."""
    external = np.empty((path.time.size, 3))
    courses.load_course(model, zero_load, path.load, external)
    return external


def laws_of(models: Floats) -> Floats:
    """Laws (B, 3, LAW) of upper, lower and radial row; an exponent of 0 means n of the row."""
    share, exponent, saturation = (models[:, [place] * 3] for place in GROWTH)
    exponent = np.where(exponent > 0.0, exponent, models[:, N])
    return np.stack([models[:, K] * models[:, FACTORS], models[:, N], models[:, D], share,
                     exponent, saturation], axis=-1)


def unit_laws(model: Model) -> Floats:
    """Change (3, LAW, 6) of the rows' laws by one unit of each contact parameter."""
    factors = ring_model.floats(model)[0, FACTORS]
    unit = np.zeros((3, LAW, 6))
    for row, first in ((0, 0), (1, 0), (2, 3)):
        unit[row, 0, first] = factors[row]
        unit[row, 1, first + 1] = unit[row, 2, first + 2] = 1.0
    return unit


def load_sensitivity(rig: Rig, contact: ContactParameters, elevation: float, time: Floats,
                     load: Floats, nodes: int) -> Floats:
    """Mean displacements (3, nodes, nodes) [m/N, m/N, rad/N] per load error of a record.

    time (N,) [s] is evenly spaced, and N is a multiple of `nodes`. Each node is the middle of a
    block. An error of 1 N at node j, which falls to zero at the next nodes, changes the mean of
    block i by [:, i, j]. The motion starts at rest under its first load with the errors.
    """
    law = contact.to_array()[None]
    step = float(np.mean(np.diff(time)))
    motion = np.ascontiguousarray(dynamic_batch(rig, law, elevation, time, load, 1.01 * step)[0].T)
    model, rows = model_of(rig, elevation, law), rows_of(rig)
    sensitivity = np.zeros((3, nodes, nodes))
    force = np.array([np.cos(elevation), -np.sin(elevation),
                      rig.trunnion.y * np.cos(elevation) + rig.trunnion.x * np.sin(elevation)])
    rate = np.ascontiguousarray(np.gradient(motion, time, axis=0))
    tangents.follow_errors(model, rows.flat, rows.uniform, motion, rate, step, force, sensitivity)
    return sensitivity


Places = NDArray[np.intp]
Candidate = tuple[ArrayLike, RingExtension]

NO_TANGENT = [parameter for parameter in own_parameters()
              if parameter.acts_on != READING and parameter.stage != 'load path']
"""Parameters of laws inside the motion of the ring; only a simulation gives their effect."""


@dataclass(frozen=True)
class Responses:
    """Readings (4, B) [m] of a candidate, and first-order readings (P, 4, B) of its neighbours."""

    centre: Floats
    neighbours: Floats


def has_tangent(centre: Candidate, neighbour: Candidate) -> bool:
    """Whether a neighbour can be reached by the pass along the centre, which is cheaper.

    A saturation that begins has no derivative; nor has the law of an effect inside the motion.
    """
    (_, of_centre), (_, of_neighbour) = centre, neighbour
    if of_centre is of_neighbour and of_centre.damping_penetration_saturation == 0.0:
        return True
    if any(parameter.of(of_centre) != parameter.of(of_neighbour) for parameter in NO_TANGENT):
        return False
    return (of_centre.damping_penetration_saturation != 0.0
            or of_neighbour.damping_penetration_saturation == 0.0)


@dataclass(frozen=True)
class _Record:
    """A run under its load; readings are means over the blocks [starts, stops)."""

    elevation: float  # [rad]
    time: Floats  # (N,) [s]
    load: Floats  # (N,) [N]
    zero_load: float  # [N]
    max_step: float  # [s]
    starts: Places  # (B,)
    stops: Places  # (B,)

    def means(self, readings: Floats) -> Floats:
        """Block means (P, 4, B) of readings (P, N, 4)."""
        out = np.empty((readings.shape[0], 4, self.starts.size))
        courses.block_means(readings, self.starts, self.stops, out)
        return out


class Neighbourhoods:
    """Candidates with their neighbours, prepared for any number of runs of one rig.

    A group is a candidate (contact law, extension) and its neighbours.
    """

    def __init__(self, rig: Rig, groups: Sequence[tuple[Candidate, Sequence[Candidate]]]) -> None:
        self._groups = [_Neighbourhood(rig, centre, others) for centre, others in groups]
        # Motions are shared by candidates that differ in what is added to the readings only.
        alike: dict[int, list[int]] = {}
        if groups:
            centres = np.concatenate([one.models[:1] for one in self._groups])
            first = ring_model.same_motions(centres, [one.rows for one in self._groups])
            for index, leader in enumerate(first.tolist()):
                alike.setdefault(leader, []).append(index)
        self._members = list(alike.values())

    def along(self, elevation: float, time: ArrayLike, load: ArrayLike,
              zero_load: float | None = None, max_step: float = 1e-3,
              blocks: tuple[Places, Places] | None = None) -> list[Responses]:
        """Responses of every group in one run, with the arguments of `probe_batch`."""
        seconds, force = check_simulation(time, load, elevation, max_step)
        zero = float(force[0]) if zero_load is None else zero_load
        if blocks is None:
            each = np.arange(seconds.size)
            blocks = each, each + 1
        record = _Record(elevation, seconds, force, zero, max_step, *blocks)
        responses: dict[int, Responses] = {}

        def run(indices: list[int]) -> None:
            groups = [self._groups[index] for index in indices]
            grows = any(one.law[:, PLAIN_LAW:].any() for one in groups)
            path: MotionPath | None = None
            for index, one in zip(indices, groups, strict=True):
                models = ring_model.at_elevation(one.models, elevation)
                if path is None:
                    path = of_candidate = simulate_path(
                        models[:1], one.rows, seconds, force, zero, max_step, grows)
                else:
                    of_candidate = path.read_by(models[:1], zero, seconds, force)
                responses[index] = one.responses(models, of_candidate, record)

        simulator.in_parallel(run, self._members)
        return [responses[index] for index in range(len(self._groups))]


class _Neighbourhood:
    """A candidate and its P neighbours, common to every run: `models` (1 + P,).

    A pass along the motion takes S directions. Its `rows` are those of the candidate; they have a
    place for every roller if a direction moves some rollers.
    """

    def __init__(self, rig: Rig, centre: Candidate, others: Sequence[Candidate]) -> None:
        every = [centre, *others]
        self._extensions = [extension for _, extension in every]
        self.models = ring_model.models_of(
            rig, 0.0, np.array([law for law, _ in every], dtype=np.float64), self._extensions)
        rollers = [ring_model.rows_of(rig, extension) for extension in self._extensions]
        self.rows = rollers[0]
        leader = ring_model.same_motions(self.models, rollers)[1:]
        # Directions that move rollers come first: the kernel knows them by their number.
        first = np.array(sorted(np.flatnonzero(leader).tolist(),
                                key=lambda index: rollers[index + 1] is rollers[0]), dtype=np.intp)
        self._first = first
        # The direction of each neighbour, -1 for none.
        self._moved = np.full(len(others), -1)
        self._moved[first] = np.arange(first.size)
        self._along, self._geometry = self.rows, np.empty((0, self.rows.flat.size))
        moving = [index + 1 for index in first.tolist() if rollers[index + 1] is not rollers[0]]
        if moving:
            self._along = ring_model.spread_rows(rig, centre[1])
            self._geometry = np.array([
                ring_model.spread_rows(rig, self._extensions[index]).flat - self._along.flat
                for index in moving])
        numbers = ring_model.floats(self.models)
        at_centre, aside = numbers[:1], numbers[1:][first]
        self.law = np.ascontiguousarray((laws_of(aside) - laws_of(at_centre)).transpose(1, 2, 0))
        frictions, loads = FRICTIONS, LOADS
        self._friction = (aside[:, frictions] - at_centre[:, frictions]).reshape(-1, 3, 4)
        self._loaded = np.flatnonzero((aside[:, loads] != at_centre[:, loads]).any(axis=1))
        plain = ring_model.read_motion_only(self.models)
        self._plain, self._added = (np.flatnonzero(chosen) for chosen in (
            plain[1:] & plain[0], ~(plain[1:] & plain[0])))

    def responses(self, models: Model, path: MotionPath, record: _Record) -> Responses:
        """Readings of the candidate, whose path is known, and of its neighbours."""
        usual = simulator.of_probes_clock(path.readings, self._extensions[0], record.time)
        centre = record.means(usual[None])[0]
        answers = np.empty((self._moved.size, *centre.shape))
        changes = self._changes(models, path, record)
        if self._plain.size:
            rise = np.empty((self._plain.size, *centre.shape))
            courses.plain_changes(models, changes, path.samples, self._moved[self._plain],
                                  record.starts, record.stops, rise)
            answers[self._plain] = centre + rise
        if self._added.size:
            read = np.empty((self._added.size, record.time.size, 4))
            courses.read_courses(
                models[1 + self._added], record.zero_load, record.time, record.load,
                path.motion[path.samples], changes[path.samples], self._moved[self._added], read)
            for place, index in enumerate((1 + self._added).tolist()):
                read[place] = simulator.of_probes_clock(
                    read[place], self._extensions[index], record.time)
            answers[self._added] = record.means(read)
        return Responses(centre, answers)

    def _changes(self, models: Model, path: MotionPath, record: _Record) -> Floats:
        """Changes (M, 3, S) of the motion by every direction."""
        centre, directions = models[:1], self._first.size
        if not directions:
            return np.empty((path.time.size, 3, 0))
        external = np.zeros((path.time.size if self._loaded.size else 0, 3, directions))
        if self._loaded.size:
            usual = external_along(centre, record.zero_load, path)
        for number in self._loaded.tolist():
            index = 1 + self._first[number]
            external[:, :, number] = external_along(
                models[index:index + 1], record.zero_load, path) - usual
        if self._along is not self.rows:
            centre = centre.copy()
            centre['axial_rollers'], centre['radial_rollers'] = self._along.counts
        return tangents_along(centre, self._along, self.law, external, self._friction,
                              self._geometry, path)
