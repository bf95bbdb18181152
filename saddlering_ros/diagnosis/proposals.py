"""Load courses of possible next tests, which the engine compares."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from saddlering_ros.diagnosis.next_test import Course
from saddlering_ros.diagnosis.records import LoadGrid
from saddlering_ros.discrepancy import Proposal, RunBlocks
from saddlering_ros.rig import force_words, Rig

SLOW, FAST, CYCLES = 'Record a slow ramp', 'Record a fast ramp', 'Record two cycles'
KINDS = {SLOW: 'second_rate', FAST: 'second_rate', CYCLES: 'repeat_cycle'}
"""The kind of test (of effects/rig_tests.py) that each course is."""


def course_of(sentence: str | None) -> Course | None:
    """The proposal that the engine has chosen, with its kind."""
    kinds = [kind for start, kind in KINDS.items() if (sentence or '').startswith(start)]
    return Course(kinds[0], sentence) if sentence and kinds else None


def propose(rig: Rig, runs: Sequence[RunBlocks]) -> list[Proposal]:
    """Runs that this rig could make at the elevations on hand and at others."""
    full, low = rig.full_scale_load, rig.preload
    peak = force_words(full, rig.force_unit, 0)
    known = sorted({round(float(np.degrees(run.payload.elevation)), 1) for run in runs})
    proposals: list[Proposal] = []
    for degrees in sorted({*known, 30.0, 50.0, 70.0}):
        where = f'at {degrees:g} deg'
        courses: dict[str, tuple[list[float], list[float]]] = {
            f'{SLOW} to {peak} and back in 60 s {where}.': (
                [0, 1, 31, 61, 62],
                [low, low, full, low, low],
            ),
            f'{FAST} to {peak} and back in 3 s {where}.': (
                [0, 1, 2.5, 4, 6],
                [low, low, full, low, low],
            ),
            f'{CYCLES} to {peak} with holds of 30 s at full load and at preload {where}.': (
                [0, 1, 6, 36, 41, 71, 76, 106, 111, 141],
                [low, low, full, full, low, low, full, full, low, low],
            ),
        }
        for sentence, (times, loads) in courses.items():
            proposals.append(Proposal(sentence, _course(degrees, times, loads, full)))
    return proposals


def _course(
    degrees: float, times: Sequence[float], loads: Sequence[float], full: float
) -> RunBlocks:
    """An empty run along a course of load."""
    blocks = 250
    edge = np.linspace(times[0], times[-1], 2 * blocks + 1)
    time = 0.5 * (edge[:-1] + edge[1:])
    load = np.interp(time, times, loads)
    first = np.arange(0, 2 * blocks, 2)
    grid = LoadGrid(
        float(np.radians(degrees)),
        time,
        load,
        float(load[0]),
        first,
        first + 2,
        min(5e-3, float(np.diff(edge)[0])),
    )
    centre = time.reshape(blocks, 2).mean(axis=1)
    width = np.full(blocks, float(np.diff(edge)[0]) * 2.0)
    drive = load.reshape(blocks, 2).mean(axis=1)
    return RunBlocks(
        'proposal',
        f'{degrees:.1f} deg',
        centre,
        width,
        np.zeros((4, blocks)),
        {'load': drive},
        payload=grid,
        direction=np.sign(np.gradient(drive)),
    )
