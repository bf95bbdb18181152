"""Readings of candidates, and first-order readings of their neighbours, by one pass each.

A candidate is a contact law with an extension; its neighbours lie a small step away. Parameters of
the equation of motion are differentiated by the implicit function theorem (`kernels/tangents.py`).
Additions to motion and readings are computed anew, which costs little. Elevation, time and load
differ between runs; everything else is prepared once for all runs.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from saddlering_ros.effects import own_parameters
from saddlering_ros.effects.extension import READING, RingExtension
from saddlering_ros.rig import Rig
from saddlering_ros.ring import model, sensitivity
from saddlering_ros.ring.kernels import courses
from saddlering_ros.ring.kernels.row_tangents import PLAIN_LAW
from saddlering_ros.ring.model import Floats, Model
from saddlering_ros.ring.simulator import check_simulation, in_parallel, of_probes_clock

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
            first = model.same_motions(centres, [one.rows for one in self._groups])
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
            path: sensitivity.MotionPath | None = None
            for index, one in zip(indices, groups, strict=True):
                models = model.at_elevation(one.models, elevation)
                if path is None:
                    path = of_candidate = sensitivity.simulate_path(
                        models[:1], one.rows, seconds, force, zero, max_step, grows)
                else:
                    of_candidate = path.read_by(models[:1], zero, seconds, force)
                responses[index] = one.responses(models, of_candidate, record)

        in_parallel(run, self._members)
        return [responses[index] for index in range(len(self._groups))]


class _Neighbourhood:
    """A candidate and its P neighbours, common to every run: `models` (1 + P,).

    A pass along the motion takes S directions. Its `rows` are those of the candidate; they have a
    place for every roller if a direction moves some rollers.
    """

    def __init__(self, rig: Rig, centre: Candidate, others: Sequence[Candidate]) -> None:
        every = [centre, *others]
        self._extensions = [extension for _, extension in every]
        self.models = model.models_of(
            rig, 0.0, np.array([law for law, _ in every], dtype=np.float64), self._extensions)
        rollers = [model.rows_of(rig, extension) for extension in self._extensions]
        self.rows = rollers[0]
        leader = model.same_motions(self.models, rollers)[1:]
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
            self._along = model.spread_rows(rig, centre[1])
            self._geometry = np.array([
                model.spread_rows(rig, self._extensions[index]).flat - self._along.flat
                for index in moving])
        numbers = model.floats(self.models)
        at_centre, aside = numbers[:1], numbers[1:][first]
        self.law = np.ascontiguousarray(
            (sensitivity.laws_of(aside) - sensitivity.laws_of(at_centre)).transpose(1, 2, 0))
        frictions, loads = sensitivity.FRICTIONS, sensitivity.LOADS
        self._friction = (aside[:, frictions] - at_centre[:, frictions]).reshape(-1, 3, 4)
        self._loaded = np.flatnonzero((aside[:, loads] != at_centre[:, loads]).any(axis=1))
        plain = model.read_motion_only(self.models)
        self._plain, self._added = (np.flatnonzero(chosen) for chosen in (
            plain[1:] & plain[0], ~(plain[1:] & plain[0])))

    def responses(self, models: Model, path: sensitivity.MotionPath, record: _Record) -> Responses:
        """Readings of the candidate, whose path is known, and of its neighbours."""
        usual = of_probes_clock(path.readings.T, self._extensions[0], record.time)
        centre = record.means(np.ascontiguousarray(usual.T)[None])[0]
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
                read[place] = of_probes_clock(read[place].T, self._extensions[index],
                                              record.time).T
            answers[self._added] = record.means(read)
        return Responses(centre, answers)

    def _changes(self, models: Model, path: sensitivity.MotionPath, record: _Record) -> Floats:
        """Changes (M, 3, S) of the motion by every direction."""
        centre, directions = models[:1], self._first.size
        if not directions:
            return np.empty((path.time.size, 3, 0))
        external = np.zeros((path.time.size if self._loaded.size else 0, 3, directions))
        if self._loaded.size:
            usual = sensitivity.external_along(centre, record.zero_load, path)
        for number in self._loaded.tolist():
            index = 1 + self._first[number]
            external[:, :, number] = sensitivity.external_along(
                models[index:index + 1], record.zero_load, path) - usual
        if self._along is not self.rows:
            centre = centre.copy()
            centre['axial_rollers'], centre['radial_rollers'] = self._along.counts
        return sensitivity.tangents_along(centre, self._along, self.law, external, self._friction,
                                          self._geometry, path)
