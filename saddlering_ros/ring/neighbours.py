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
from saddlering_ros.ring.model import Floats, Model, Rows
from saddlering_ros.ring.sensitivity import MotionPath, tangents_along
from saddlering_ros.ring.simulator import check_simulation, in_parallel, of_probes_clock

Places = NDArray[np.intp]
Candidate = tuple[ArrayLike, RingExtension]

NO_TANGENT = [item for item in own_parameters()
              if item.acts_on != READING and item.stage != 'load path']
"""Parameters of laws inside the motion of the ring; only a simulation gives their effect."""


@dataclass(frozen=True)
class Responses:
    """Readings (4, B) [m] of a candidate, and first-order readings (P, 4, B) of its neighbours."""

    centre: Floats
    neighbours: Floats


def has_tangent(centre: Candidate, neighbour: Candidate) -> bool:
    """Whether a neighbour can be reached by the pass along the centre, which is cheaper.

    A saturation that begins has no derivative, and neither has the own law of an effect inside the
    motion.
    """
    (_, own), (_, other) = centre, neighbour
    if own is other and own.damping_penetration_saturation == 0.0:
        return True
    if any(item.of(own) != item.of(other) for item in NO_TANGENT):
        return False
    return (own.damping_penetration_saturation != 0.0
            or other.damping_penetration_saturation == 0.0)


@dataclass(frozen=True)
class _Neighbourhood:
    """A candidate and its P neighbours, common to every run.

    models (1 + P,) without an elevation; extensions of the P neighbours; moved (P,): index of the
    direction of the pass that a neighbour takes, -1 for none; first (S,): the neighbour of each
    direction; law (3, LAW, S), friction (S, 3, 4) and geometry are those of the pass, whose rows
    are `along`; loaded: directions with another load path; plain (P,): neighbours without
    additions to the motion.
    """

    models: Model
    extension: RingExtension
    extensions: Sequence[RingExtension]
    rows: Rows
    along: Rows
    moved: Places
    first: Places
    law: Floats
    friction: Floats
    geometry: Sequence[Floats]
    loaded: Places
    plain: NDArray[np.bool_]


@dataclass(frozen=True)
class _Record:
    """A run: time, load (N,), its zero; readings are means over the blocks [starts, stops)."""

    elevation: float
    time: Floats
    load: Floats
    zero_load: float
    max_step: float
    starts: Places
    stops: Places

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
        self._groups = [_neighbourhood(rig, centre, others) for centre, others in groups]
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
        """Responses of every group in one run; as means over blocks [start, stop) if given.

        The other arguments and the readings are those of `simulator.probe_batch`.
        """
        seconds, force = check_simulation(time, load, elevation, max_step)
        zero = float(force[0]) if zero_load is None else zero_load
        if blocks is None:
            each = np.arange(seconds.size)
            blocks = each, each + 1
        record = _Record(elevation, seconds, force, zero, max_step, *blocks)
        found: dict[int, Responses] = {}

        def run(part: slice) -> None:
            for indices in self._members[part]:
                found.update(zip(
                    indices, _together([self._groups[index] for index in indices], record),
                    strict=True))

        if self._members:
            in_parallel(run, len(self._members))
        return [found[index] for index in range(len(self._groups))]


def _together(groups: Sequence[_Neighbourhood], record: _Record) -> list[Responses]:
    """Responses of groups that share one motion."""
    answers: list[Responses] = []
    path: MotionPath | None = None
    grows = any(one.law[:, PLAIN_LAW:].any() for one in groups)
    for one in groups:
        models = model.at_elevation(one.models, record.elevation)
        if path is None:
            path = own = sensitivity.simulate_path(models[:1], one.rows, record.time, record.load,
                                                   record.zero_load, record.max_step, grows)
        else:
            own = path.read_by(models[:1], record.zero_load, record.time, record.load)
        answers.append(_responses(one, models, own, record))
    return answers


def _neighbourhood(rig: Rig, centre: Candidate, others: Sequence[Candidate]) -> _Neighbourhood:
    """The common part of a candidate and its neighbours in every run."""
    extensions = [extension for _, extension in others]
    every = [centre, *others]
    models = model.models_of(rig, 0.0, np.array([law for law, _ in every], dtype=np.float64),
                             [extension for _, extension in every])
    rollers = [model.rows_of(rig, extension) for _, extension in every]
    leader = model.same_motions(models, rollers)[1:]
    # Directions that move rollers come first: the kernel knows them by their number.
    first = np.array(sorted(np.flatnonzero(leader).tolist(),
                            key=lambda index: rollers[index + 1] is rollers[0]), dtype=np.intp)
    moved = np.full(len(others), -1)
    moved[first] = np.arange(first.size)
    geometry: list[Floats] = []
    along = rollers[0]
    count = sum(rollers[index + 1] is not rollers[0] for index in first.tolist())
    if count:
        along = model.spread_rows(rig, centre[1])
        geometry = [model.spread_rows(rig, extensions[index]).flat - along.flat
                    for index in first[:count].tolist()]
    numbers = model.floats(models)
    own, aside = numbers[:1], numbers[1:][first]
    return _Neighbourhood(
        models, centre[1], extensions, rollers[0], along, moved, first,
        np.ascontiguousarray(
            (sensitivity.laws_of(aside) - sensitivity.laws_of(own)).transpose(1, 2, 0)),
        (aside[:, sensitivity.FRICTIONS] - own[:, sensitivity.FRICTIONS]).reshape(-1, 3, 4),
        geometry,
        np.flatnonzero((aside[:, sensitivity.LOADS] != own[:, sensitivity.LOADS]).any(axis=1)),
        (model.read_motion_only(models[1:]) & model.read_motion_only(models[:1])[0]),
    )


def _responses(one: _Neighbourhood, models: Model, path: MotionPath, record: _Record) -> Responses:
    """Readings of a candidate, whose path is known, and of its neighbours."""
    usual = of_probes_clock(path.readings.T, one.extension, record.time)
    centre = record.means(np.ascontiguousarray(usual.T)[None])[0]
    answers = np.empty((len(one.extensions), *centre.shape))
    if not len(answers):
        return Responses(centre, answers)
    # Changes (M, 3, S) of the motion by every direction.
    changes, own = np.empty((path.time.size, 3, 0)), models[:1]
    if one.first.size:
        external = np.zeros((path.time.size if one.loaded.size else 0, 3, one.first.size))
        if one.loaded.size:
            course = sensitivity.external_along(own, record.zero_load, path)
        for number in one.loaded.tolist():
            index = 1 + one.first[number]
            external[:, :, number] = sensitivity.external_along(
                models[index:index + 1], record.zero_load, path) - course
        if one.along is not one.rows:
            own = own.copy()
            own['axial_rollers'], own['radial_rollers'] = one.along.counts
        changes = tangents_along(own, one.along, one.law, external, one.friction, one.geometry,
                                 path)
    plain = np.flatnonzero(one.plain)
    if plain.size:
        rise = np.empty((plain.size, *centre.shape))
        courses.plain_changes(models, changes, path.samples, one.moved[plain], record.starts,
                              record.stops, rise)
        answers[plain] = centre + rise
    added = np.flatnonzero(~one.plain)
    if added.size:
        read = np.empty((added.size, record.time.size, 4))
        courses.read_courses(
            models[1 + added], record.zero_load, record.time, record.load,
            path.motion[path.samples], changes[path.samples], one.moved[added], read)
        for place, index in enumerate(added.tolist()):
            extension = one.extensions[index]
            if extension.clock_offset != 0.0 or extension.clock_skew != 0.0:
                read[place] = of_probes_clock(read[place].T, extension, record.time).T
        answers[added] = record.means(read)
    return Responses(centre, answers)
