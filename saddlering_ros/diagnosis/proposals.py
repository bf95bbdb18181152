"""Tests the rig could make next: load courses for the engine to weigh, and general advice."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from saddlering_ros.diagnosis.records import LoadGrid
from saddlering_ros.discrepancy import Proposal, Run
from saddlering_ros.rig import Rig

GENERAL_ADVICE = {
    'load': 'Repeat the static test with the probes swapped in pairs: a misfit that moves with a '
    "probe is the probe's, one that stays is the ring's.",
    'direction': 'Record a second cycle at once with holds at zero and full load: friction '
    'repeats, settling does not, creep closes during the hold.',
    'rate': 'Repeat the dynamic test four times slower: what scales with the rate is damping or '
    'delay, what does not is stiffness or friction.',
    'time': 'Record ten minutes at constant preload: drift and pick-up show without any load.',
}


def propose(rig: Rig, runs: Sequence[Run]) -> list[Proposal]:
    """Runs that this rig could make at the elevations on hand and at others."""
    full, low = rig.full_scale_load, rig.preload
    known = sorted({round(float(np.degrees(run.payload.elevation)), 1) for run in runs})
    proposals: list[Proposal] = []
    for degrees in sorted({*known, 30.0, 50.0, 70.0}):
        where = f'at {degrees:g} deg'
        courses: dict[str, tuple[list[float], list[float]]] = {
            f'Record a slow ramp to 25 t and back in 60 s {where}.': (
                [0, 1, 31, 61, 62],
                [low, low, full, low, low],
            ),
            f'Record a fast ramp to 25 t and back in 3 s {where}.': (
                [0, 1, 2.5, 4, 6],
                [low, low, full, low, low],
            ),
            f'Record two cycles to 25 t with holds of 30 s at full load and at preload {where}.': (
                [0, 1, 6, 36, 41, 71, 76, 106, 111, 141],
                [low, low, full, full, low, low, full, full, low, low],
            ),
        }
        for sentence, (times, loads) in courses.items():
            proposals.append(Proposal(sentence, _course(degrees, times, loads, full)))
    return proposals


def _course(degrees: float, times: Sequence[float], loads: Sequence[float], full: float) -> Run:
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
    return Run(
        'proposal',
        f'{degrees:.1f} deg',
        centre,
        width,
        np.zeros((4, blocks)),
        {'load': drive, 'direction': np.sign(np.gradient(drive))},
        payload=grid,
    )
