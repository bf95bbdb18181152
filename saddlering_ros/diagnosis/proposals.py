"""The possible next tests of a rig, in the form that the engine simulates."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
import math

import numpy as np
from numpy.typing import NDArray

from saddlering_ros.diagnosis.records import LoadGrid, LONGEST_STEP
from saddlering_ros.discrepancy import Point, Proposal, Reading, RunBlocks
from saddlering_ros.effects import catalogue
from saddlering_ros.effects.base import RIG_TESTS
from saddlering_ros.rig import Rig

ELEVATIONS = (30.0, 50.0, 70.0)
"""Elevations [deg] that are proposed besides those of the data."""

BLOCKS = 250
"""Number of block means of a simulated ramp."""

RAMP, HOLD, STEPS = 1.0, 5.0, 25
"""Seconds between the holds of a static test, seconds of a hold, and holds up to full scale."""

FAST_STEP = 5e-3
"""Longest step [s] of the simulation of a fast ramp, in which damping shows."""

REST_SECONDS = 600.0
"""Length of a record at constant preload."""

SAG = 1e-4
"""Wander of a held load in that time, as a share of full scale."""

CELL_GAIN, CELL_SHARE = 2e-3, 5e-4
"""Accuracy of a reference cell: share of the load, and share of full scale."""

INCLINOMETER, SCALE = math.radians(0.02), 1e-3
"""Standard deviations of an inclinometer [rad] and of a measured height [m]."""

OTHER_PROBE = {1.0: 3.0, 3.0: 1.0, 2.0: 4.0, 4.0: 2.0}
MOVES = 'a misfit that moves with the probe'
"""Outcome of swapped probes for an effect that belongs to the probe and not to its place."""


def propose(rig: Rig, runs: Sequence[RunBlocks]) -> list[Proposal]:
    """Possible tests of this rig at the elevations of the data and at others."""
    known = sorted({round(float(np.degrees(run.payload.elevation)), 1) for run in runs})
    answers = []
    for degrees in sorted({*known, *ELEVATIONS}):
        answers += _courses(rig, degrees)
        if degrees not in known:
            sentence = f'Repeat the static test at {degrees:g} deg.'
            answers.append(Proposal(sentence, _staircase(rig, degrees), 'other_elevation'))
    answers += _repeats(rig, known[0])
    return [
        replace(item, run=replace(item.run, name=f'proposed {number}'))
        for number, item in enumerate(answers)
    ]


def _courses(rig: Rig, degrees: float) -> list[Proposal]:
    """Ramps and cycles at an elevation."""
    full, low, peak = rig.full_scale_load, rig.preload, rig.full_scale_words
    where = f'at {degrees:g} deg'
    slow = LoadCourse([0, 1, 31, 61, 62], [low, low, full, low, low])
    fast = LoadCourse([0, 1, 2.5, 4, 6], [low, low, full, low, low], FAST_STEP)
    cycles = LoadCourse([0, 1, 6, 36, 41, 71, 76, 106, 111, 141],
                        [low, low, full, full, low, low, full, full, low, low])
    return [
        Proposal(f'Record a slow ramp to {peak} and back in 60 s {where}.',
                 slow.run(rig, degrees), 'second_rate'),
        Proposal(f'Record a fast ramp to {peak} and back in 3 s {where}.',
                 fast.run(rig, degrees), 'second_rate'),
        Proposal(f'Record two cycles to {peak} with holds of 30 s at full load and at preload '
                 f'{where}.', cycles.run(rig, degrees), 'repeat_cycle'),
    ]


def _repeats(rig: Rig, degrees: float) -> list[Proposal]:
    """Tests of the table that repeat a test with something changed or measured beside it."""
    static = _staircase(rig, degrees)
    low = rig.preload
    full = rig.full_scale_load
    rest = LoadCourse([0, REST_SECONDS], [low, low + SAG * full]).run(rig, degrees)
    cell = (Reading('load_gain', CELL_GAIN), Reading('load_offset', CELL_SHARE * full),
            Reading('load_nonlinearity', CELL_SHARE), Reading('cylinder_friction',
                                                              CELL_SHARE * full))
    angles = (Reading('elevation_error', INCLINOMETER), Reading('bracket_play', INCLINOMETER))
    heights = (Reading('moment_arm', SCALE), Reading('probe_height', SCALE))
    words = {test.id: test.instruction for test in RIG_TESTS}
    made = {
        'swapped_probes': Proposal('', static, as_made=with_swapped_probes),
        'slewed_ring': Proposal('', static, as_made=on_slewed_ring, is_other_place=True),
        'reference_load': Proposal('', static, readings=cell),
        'inclinometer': Proposal('', static, readings=angles),
        'heights': Proposal('', static, readings=heights),
        'zero_load': Proposal('', rest),
    }
    return [replace(item, sentence=words[kind], kind=kind) for kind, item in made.items()]


def with_swapped_probes(point: Point) -> Point:
    """The same with probes 1 and 3, and 2 and 4, in each other's place."""
    effects = {}
    for name, values in point.effects.items():
        probe = values.get('probe', 0.0)
        known = catalogue().get(name)
        moves = known is not None and known.outcomes.swapped_probes == MOVES
        effects[name] = {**values, 'probe': OTHER_PROBE[probe]} if moves and probe else values
    return Point(point.base, effects)


def on_slewed_ring(point: Point) -> Point:
    """The same with the ring turned by a quarter, so that an oval and worn arcs lie elsewhere."""
    effects = {}
    for name, values in point.effects.items():
        if name == 'out_of_round':
            effects[name] = {**values, 'amplitude': -values['amplitude']}
        elif name in ('worn_sector_axial', 'worn_sector_radial'):
            centre = values['centre'] + math.pi / 2
            effects[name] = {**values, 'centre': min(centre, 2.0 * math.pi - centre)}
        else:
            effects[name] = dict(values)
    return Point(point.base, effects)


@dataclass(frozen=True)
class LoadCourse:
    """A course of load: times [s] and loads [N], linear in between.

    max_step [s]: longest step of its simulation. The samples of a slow course are close
    enough.
    """

    times: Sequence[float]
    loads: Sequence[float]
    max_step: float = LONGEST_STEP

    def run(self, rig: Rig, degrees: float) -> RunBlocks:
        """An empty run along the course."""
        edge = np.linspace(self.times[0], self.times[-1], 2 * BLOCKS + 1)
        time = 0.5 * (edge[:-1] + edge[1:])
        load = np.interp(time, self.times, self.loads)
        first = np.arange(0, 2 * BLOCKS, 2)
        width = 2.0 * float(np.diff(edge)[0])
        drive = load.reshape(BLOCKS, 2).mean(axis=1)
        centre = time.reshape(BLOCKS, 2).mean(axis=1)
        grid = LoadGrid(float(np.radians(degrees)), time, load, float(load[0]), first, first + 2,
                        self.max_step)
        change = np.gradient(drive, centre)
        return _empty_run(rig, grid, centre, np.full(BLOCKS, width), np.sign(change),
                          rate=change)


def _staircase(rig: Rig, degrees: float) -> RunBlocks:
    """An empty static run: holds up to full scale and back, four blocks each."""
    rise = np.arange(1, STEPS + 1) * rig.full_scale_load / STEPS
    levels = np.concatenate([[rig.preload], rise, rise[-2::-1]])
    time, load = [0.0], [float(levels[0])]
    first: list[int] = []
    hold, branch = [], []
    now = 0.0
    for number, (before, level) in enumerate(pairwise(levels)):
        for share in (0.1, 0.3, 0.5, 0.7, 0.9):
            time.append(now + share * RAMP)
            load.append(float(before + share * (level - before)))
        for share in (0.125, 0.375, 0.625, 0.875):
            if level >= rig.limits.hold_min:
                first.append(len(time))
                hold.append(float(number))
                branch.append(1.0 if level > before else -1.0)
            time.append(now + RAMP + share * HOLD)
            load.append(float(level))
        now += RAMP + HOLD
    starts = np.array(first)
    grid = LoadGrid(float(np.radians(degrees)), np.array(time), np.array(load), load[0], starts,
                    starts + 1, 1.0)
    blocks = len(first)
    return _empty_run(rig, grid, grid.time[starts], np.full(blocks, HOLD / 4), np.array(branch),
                      hold=np.array(hold), rate=np.zeros(blocks))


def _empty_run(
    rig: Rig,
    grid: LoadGrid,
    time: NDArray[np.float64],
    width: NDArray[np.float64],
    direction: NDArray[np.float64],
    *,
    rate: NDArray[np.float64],
    hold: NDArray[np.float64] | None = None,
) -> RunBlocks:
    drive = grid.block_means(grid.load)
    return RunBlocks(
        'proposed', f'{np.degrees(grid.elevation):.1f} deg', time, width,
        np.zeros((len(rig.probes.present), time.size)), {'load': drive}, payload=grid,
        direction=direction, rate=rate, hold=hold)
