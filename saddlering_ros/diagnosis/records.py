"""From a test to an engine's run: block means of four probes, load grid, stretches at rest."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from saddlering_ros.bags import displacement_of_run, MeasuredRun, plateaus, TestRun
from saddlering_ros.discrepancy import RestSegment, Run
from saddlering_ros.errors import SaddleringError
from saddlering_ros.rig import Rig

Array = NDArray[np.float64]

STATIC_GRID = 0.1
"""Spacing of the simulated load in static runs [s]."""
BLOCKS_PER_PLATEAU = 4
LONGEST_BLOCK = 2.5
DYNAMIC_BLOCKS = 600
"""At most so many block means for a dynamic run."""
SHORTEST_BLOCK = 0.02
SUBGRID = 10
"""Simulated load samples per block of a dynamic run."""
DYNAMIC_STEP = 2e-3
REST_BAND = 0.004
"""A load that stays within this share of full scale is at rest."""
SHORTEST_REST = 0.3
LEAST_SAMPLES = 40


class DiagnosisError(SaddleringError):
    """A run or a set of runs that cannot be diagnosed."""


@dataclass(frozen=True)
class LoadGrid:
    """What the simulator is driven with: time, load (M,); block b is the mean of [first, last)."""

    elevation: float
    time: Array
    load: Array
    zero_load: float
    first: NDArray[np.int64]
    last: NDArray[np.int64]
    max_step: float

    def block_means(self, simulated: Array) -> Array:
        """Means over the blocks of simulated (..., M)."""
        total = np.concatenate(
            [np.zeros((*simulated.shape[:-1], 1)), np.cumsum(simulated, axis=-1)], axis=-1
        )
        means = (total[..., self.last] - total[..., self.first]) / (self.last - self.first)
        return np.asarray(means)


@dataclass(frozen=True)
class Record:
    """A test run as measured, and as the engine sees it."""

    test_run: TestRun
    measured: MeasuredRun
    run: Run


def build_record(rig: Rig, test_run: TestRun, *, held_out: bool) -> Record:
    """Block means, load grid and stretches at rest of one bag."""
    measured = displacement_of_run(rig, test_run)
    good = measured.complete & np.isfinite(measured.load)
    good[: measured.zero.start] = False
    time, load, probes = measured.time[good], measured.load[good], measured.d[:, good]
    if time.size < LEAST_SAMPLES:
        raise DiagnosisError(
            f'{test_run.path}: {time.size} complete samples are too few to diagnose: record longer'
        )
    build = _static if test_run.test == 'static' else _dynamic
    return Record(test_run, measured, build(rig, test_run, measured, time, load, probes, held_out))


def _static(
    rig: Rig,
    test_run: TestRun,
    measured: MeasuredRun,
    time: Array,
    load: Array,
    probes: Array,
    held_out: bool,
) -> Run:
    found = plateaus(test_run)
    edges = np.arange(time[0], time[-1] + STATIC_GRID, STATIC_GRID)
    grid_time, grid_load, place = _binned(time, load, edges)
    first, last, hold, width, centre, values, branch = [], [], [], [], [], [], []
    rest: list[RestSegment] = []
    step = float(np.median(np.diff(time)))
    for number in range(len(found)):
        begin = float(test_run.time[found.hold_start[number]])
        end = float(test_run.time[found.hold_stop[number] - 1])
        inside = np.flatnonzero((time >= begin + min(0.3, 0.1 * (end - begin))) & (time <= end))
        if inside.size < 4:
            continue
        length = float(time[inside[-1]] - time[inside[0]]) + step
        parts = max(min(BLOCKS_PER_PLATEAU, inside.size // 2), int(length / LONGEST_BLOCK))
        for block in np.array_split(inside, parts):
            low, high = int(place[block[0]]), int(place[block[-1]]) + 1
            first.append(low)
            last.append(high)
            hold.append(float(number))
            width.append(block.size * step)
            centre.append(float(time[block].mean()))
            values.append(probes[:, block].mean(axis=1))
            branch.append(float(found.branch[number]))
        settled = inside[time[inside] >= begin + 0.35 * (end - begin)]
        if settled.size >= 8:
            rest.append(RestSegment(probes[:, settled], step, f'{int(found.branch[number])}'))
    grid = LoadGrid(
        test_run.elevation,
        grid_time,
        grid_load,
        measured.zero.load,
        np.array(first),
        np.array(last),
        STATIC_GRID,
    )
    return _run(
        rig,
        test_run,
        grid,
        np.array(centre),
        np.array(width),
        np.array(values).T,
        tuple(rest),
        held_out,
        np.array(hold),
        np.array(branch),
    )


def _dynamic(
    rig: Rig,
    test_run: TestRun,
    measured: MeasuredRun,
    time: Array,
    load: Array,
    probes: Array,
    held_out: bool,
) -> Run:
    step = float(np.median(np.diff(time)))
    duration = float(time[-1] - time[0])
    block = max(SHORTEST_BLOCK, duration / DYNAMIC_BLOCKS, step)
    fine = max(step, block / SUBGRID)
    edges = np.arange(time[0] - 0.5 * step, time[-1] + fine, fine)
    grid_time, grid_load, place = _binned(time, load, edges)
    number = np.floor((time - time[0]) / block + 1e-9).astype(np.int64)
    starts = np.flatnonzero(np.diff(number, prepend=-1))
    stops = np.append(starts[1:], time.size)
    kept = (stops - starts) >= 1
    starts, stops = starts[kept], stops[kept]
    centre = np.array([time[a:b].mean() for a, b in zip(starts, stops, strict=True)])
    values = np.array([probes[:, a:b].mean(axis=1) for a, b in zip(starts, stops, strict=True)]).T
    width = np.asarray((stops - starts) * step, dtype=np.float64)
    hold = np.arange(centre.size, dtype=float)
    rests = _rests(rig, time, load)
    # After a ramp the ring still creeps home, which is no noise: use what was before it, if any.
    quiet = [(begin, end) for begin, end in rests if begin == 0] or rests
    rest = [RestSegment(probes[:, begin:end], step) for begin, end in quiet]
    for begin, end in rests:
        hold[(centre >= time[begin]) & (centre <= time[end - 1])] = -float(begin) - 1.0
    grid = LoadGrid(
        test_run.elevation,
        grid_time,
        grid_load,
        measured.zero.load,
        place[starts],
        place[stops - 1] + 1,
        min(DYNAMIC_STEP, fine),
    )
    return _run(rig, test_run, grid, centre, width, values, tuple(rest), held_out, hold, None)


def _binned(time: Array, load: Array, edges: Array) -> tuple[Array, Array, NDArray[np.int64]]:
    """Mean time and load of each bin that holds samples; the bin's number of every sample."""
    number = np.clip(np.searchsorted(edges, time, side='right') - 1, 0, edges.size)
    _, place = np.unique(number, return_inverse=True)
    count = np.bincount(place).astype(float)
    mean_time = np.bincount(place, time) / count
    mean_load = np.bincount(place, load) / count
    return mean_time, mean_load, place.astype(np.int64)


def _rests(rig: Rig, time: Array, load: Array) -> list[tuple[int, int]]:
    """Stretches [start, stop) over which the load stays put, their first bit left to settling."""
    band = REST_BAND * rig.full_scale_load
    step = float(np.median(np.diff(time)))
    count = max(1, round(0.05 / step))
    usable = time.size // count * count
    level = load[:usable].reshape(-1, count).mean(axis=1)
    found, start = [], 0
    for index in range(1, level.size + 1):
        if index < level.size and abs(level[index] - level[start:index].mean()) < band:
            continue
        begin, end = start * count, index * count
        settle = 0 if start == 0 else min(round(0.5 / step), (end - begin) // 2)
        if time[end - 1] - time[begin] > SHORTEST_REST and end - begin - settle >= 8:
            guard = min(round(0.1 / step), (end - begin) // 5)
            found.append((begin + settle, end - guard))
        start = index
    return found


def _run(
    rig: Rig,
    test_run: TestRun,
    grid: LoadGrid,
    centre: Array,
    width: Array,
    values: Array,
    rest: tuple[RestSegment, ...],
    held_out: bool,
    hold: Array,
    branch: Array | None,
) -> Run:
    load = grid.block_means(grid.load)
    direction = (
        _direction(load, 0.01 * rig.full_scale_load) if branch is None else _carried(branch)
    )
    inputs = {'load': load, 'direction': direction, 'hold': hold}
    if test_run.test != 'static':
        rate = np.gradient(load, centre)
        size = max(1, round(0.1 / float(np.median(np.diff(centre)))))
        inputs['rate'] = np.convolve(rate, np.ones(size) / size, mode='same')
    else:
        inputs['rate'] = np.zeros(load.size)
    degrees = np.degrees(test_run.elevation)
    name = test_run.path.name or test_run.name
    return Run(name, f'{degrees:.1f} deg', centre, width, values, inputs, rest, held_out, grid)


def _direction(load: Array, band: float) -> Array:
    """+1 while load rises, -1 while it falls, the last of them while it rests."""
    direction = np.empty(load.size)
    sign, extreme = 1.0, load[0]
    for index, value in enumerate(load):
        if sign * (value - extreme) > 0.0:
            extreme = value
        elif sign * (extreme - value) > band:
            sign, extreme = -sign, value
        direction[index] = sign
    return direction


def _carried(branch: Array) -> Array:
    """Branch of plateaus with the turning points counted to the branch that led there."""
    direction = branch.copy()
    for index in range(direction.size):
        if direction[index] == 0.0:
            direction[index] = direction[index - 1] if index else 1.0
    return direction


def check_set(records: Sequence[Record]) -> list[str]:
    """What a set of bags cannot tell, in plain sentences."""
    fitted = [record for record in records if not record.run.held_out]
    tests = {record.test_run.test for record in fitted}
    elevations = sorted({round(np.degrees(record.test_run.elevation), 1) for record in fitted})
    rigs = sorted({record.test_run.rig for record in records})
    notes: list[str] = []
    if len(fitted) == 1:
        notes.append('one run only: the gain on runs not fitted cannot be measured')
    if tests == {'static'}:
        notes.append('static runs only: D1, D2 and everything rate-dependent cannot be judged')
    if tests == {'dynamic'}:
        notes.append('dynamic runs only: slow effects and loops are told from damping poorly')
    if len(elevations) == 1:
        notes.append(
            f'one elevation only ({elevations[0]:g} deg): load gain, elevation error, '
            'moment arm and compliances are hard to tell apart'
        )
    if len(rigs) > 1:
        notes.append(
            f'bags from different rigs ({", ".join(rigs)}): taken as one rig; '
            'diagnose them apart if they are not'
        )
    for record in fitted:
        peak = float(np.max(record.measured.load))
        if peak < 0.5 * 25 * 9806.65:
            notes.append(
                f'{record.run.name}: peak load {peak / 1e3:.0f} kN is under half of full '
                'scale: thresholds above it cannot show'
            )
        if float(np.ptp(record.run.time)) < 5.0:
            notes.append(
                f'{record.run.name}: {np.ptp(record.run.time):.1f} s long: effects slower '
                'than this cannot show'
            )
    return notes
