"""From a test to an engine's run: block means of four probes, load grid, stretches at rest."""

from collections.abc import Sequence
from dataclasses import dataclass
import math

import numpy as np
from numpy.typing import NDArray

from saddlering_ros.discrepancy import direction_of, RestSegment, RunBlocks
from saddlering_ros.errors import SaddleringError
from saddlering_ros.estimation.process import span_means
from saddlering_ros.estimation.rest import (
    BLOCK_SECONDS,
    level_stretches,
    probe_rounding,
    quiet_stretches,
    stretches_at_rest,
)
from saddlering_ros.record.displacement import displacement_of_run, MeasuredRun
from saddlering_ros.record.plateaus import plateaus
from saddlering_ros.record.quality import white_noise
from saddlering_ros.record.record import Record
from saddlering_ros.rig import Rig

Array = NDArray[np.float64]

STATIC_GRID = 0.2
"""Spacing of the simulated load between the holds of static runs [s]."""
SETTLING_GRID = 0.15
"""Shortest part of a held load [s]."""
SETTLING_SHARE = 0.25
"""Longest part of a held load, as a share of the time since it is held.

The middle of a part of length h stands for its mean, from which it differs by h^2 / (24 tau^2) of
what decays by exp(-t / tau): 0.14 % of a step at most, whatever tau is.
"""
STEADY_TIME = 1.0
"""A held load follows straight lines over this time to both sides [s]."""
NOISE_BAND = 4.0
"""Standard deviations by which a mean over BLOCK_SECONDS may be off the straight line of a held
load: one of 16 000 is further."""
BLOCKS_PER_PLATEAU = 4  # settling within a hold shows
LONGEST_BLOCK = 2.5  # [s]; creep within a long hold shows
DYNAMIC_BLOCKS = 600
"""Largest number of block means of a dynamic run."""
SHORTEST_BLOCK = 0.02  # [s], that of an identification
MOVING_PARTS = (4, 8, 40)
"""Fewest and most simulated load samples per block of a dynamic run while the load moves; most in
a long block."""
MOVING_PART = 0.0125
"""Length [s] of these samples from which on a block may have more of them."""
PART_CHANGE = 0.003
"""Change of load over one of them, as a share of full scale, unless there are that many."""
LONGEST_STEP = 1.0
"""Longest time step of the simulation [s]; samples are closer while the load moves."""
MIN_SAMPLES = 40
"""Fewest complete samples: noise and a few effects take the freedom of fewer."""


class DiagnosisError(SaddleringError):
    """A run or a set of runs that cannot be diagnosed."""


@dataclass(frozen=True)
class LoadGrid:
    """Input of the simulator: time, load (M,); block b is the mean of [first, last).

    load_noise (N,): standard deviation [N] of the white noise of each block's mean load.
    """

    elevation: float
    time: Array
    load: Array
    zero_load: float
    first: NDArray[np.int64]
    last: NDArray[np.int64]
    max_step: float
    load_noise: Array | None = None

    def block_means(self, simulated: Array) -> Array:
        """Means over the blocks of simulated (..., M)."""
        return span_means(simulated, self.first, self.last)


@dataclass(frozen=True)
class PreparedRecord:
    """A test run as measured, and in the form of the engine."""

    test_run: Record
    measured: MeasuredRun
    run: RunBlocks


@dataclass(frozen=True)
class _Blocks:
    """Division of a run: blocks, stretches at rest, hold and direction of each block.

    spans: samples [first, last) of each block and the number of parts of its simulated load;
    held: samples [start, stop) over which the load is held; between: samples of one part of the
    load outside of blocks.
    """

    spans: list[tuple[int, int, int]]
    rest: list[RestSegment]
    hold: Array
    held: list[tuple[int, int]]
    direction: Array | None
    between: int


def build_record(rig: Rig, test_run: Record, *, held_out: bool) -> PreparedRecord:
    """Block means, load grid and stretches at rest of one bag."""
    test_run = test_run.without_spikes()
    measured = displacement_of_run(rig, test_run)
    good = measured.complete & np.isfinite(measured.load)
    good[: measured.zero.start] = False
    # Complete samples of the probes that the rig has; quiet: with noise in place of the rounding
    # of a coarse logger.
    time, load = measured.time[good], measured.load[good]
    probes, rounding = measured.d[:, good], probe_rounding(test_run)
    quiet = probes if rounding is None else probes + rounding[:, good]
    if rig.probes.absent:
        there = [number - 1 for number in rig.probes.present]
        probes, quiet = probes[there], quiet[there]
    if time.size < MIN_SAMPLES:
        raise DiagnosisError(f'{test_run.path}: {time.size} complete samples are too few for a '
                             'diagnosis: record longer')
    divided = _static if test_run.test == 'static' else _dynamic
    blocks = divided(rig, test_run, time, load, quiet)
    grid = _load_grid(test_run.elevation, time, load, measured.zero.load, blocks)
    spans = [slice(first, last) for first, last, _ in blocks.spans]
    centre = np.array([time[span].mean() for span in spans])
    drive, direction = grid.block_means(grid.load), blocks.direction
    if direction is None:
        direction = direction_of(drive, rig.limits.reversal_band)
    step = float(np.median(np.diff(time)))
    means = np.array([probes[:, span].mean(axis=1) for span in spans])
    return PreparedRecord(test_run, measured, RunBlocks(
        name=test_run.path.name or test_run.name,
        group=f'{np.degrees(test_run.elevation):.1f} deg', time=centre,
        width=np.array([(span.stop - span.start) * step for span in spans]),
        channels=means.reshape(-1, len(probes)).T, inputs={'load': drive},
        rest=tuple(blocks.rest), held_out=held_out, payload=grid, direction=direction,
        rate=np.zeros(drive.size) if test_run.test == 'static' else smooth_rate(drive, centre),
        hold=blocks.hold))


def _static(rig: Rig, test_run: Record, time: Array, load: Array, quiet: Array) -> _Blocks:
    """Blocks within the plateaus of a static run."""
    levels, hold, direction, held = plateaus(test_run), [], [], []
    blocks: list[tuple[int, int, int]] = []
    rest: list[RestSegment] = []
    step = float(np.median(np.diff(time)))
    for number in range(len(levels)):
        begin = float(test_run.time[levels.hold_start[number]])
        end = float(test_run.time[levels.hold_stop[number] - 1])
        inside = np.flatnonzero((time >= begin + min(0.3, 0.1 * (end - begin))) & (time <= end))
        if inside.size < 4 or load[inside].mean() < rig.limits.hold_min:
            continue
        held.append((int(inside[0]), int(inside[-1]) + 1))
        length = float(time[inside[-1]] - time[inside[0]]) + step
        parts = max(min(BLOCKS_PER_PLATEAU, inside.size // 2), int(length / LONGEST_BLOCK))
        for block in np.array_split(inside, parts):
            bins = _held_parts(float(time[block[0]]) - begin, block.size * step)
            blocks.append((int(block[0]), int(block[-1]) + 1, min(bins, block.size)))
            hold.append(float(number))
            direction.append(levels.direction[number])
        settled = inside[time[inside] >= test_run.time[levels.start[number]]]
        if settled.size >= 8:
            rest.append(RestSegment(quiet[:, settled], step, f'{int(levels.branch[number])}'))
    between = max(1, round(STATIC_GRID / step))
    return _Blocks(blocks, rest, np.array(hold), held, np.array(direction), between)


def _held_parts(since: float, length: float) -> int:
    """Parts of a block of this length [s] that begins `since` [s] after its load is held."""
    longest = max(SETTLING_GRID, SETTLING_SHARE * since)
    return max(1, math.ceil(length / longest - 0.2))


def _dynamic(rig: Rig, _: Record, time: Array, load: Array, quiet: Array) -> _Blocks:
    """Even blocks of a dynamic run; one that lacks half of its length is divided there."""
    step = float(np.median(np.diff(time)))
    length = max(SHORTEST_BLOCK, float(time[-1] - time[0]) / DYNAMIC_BLOCKS, step)
    number = np.floor((time - time[0]) / length + 1e-9).astype(np.int64)
    is_pause = np.diff(time, prepend=time[0]) > max(0.5 * length, 1.5 * step)
    starts = np.flatnonzero(np.diff(number, prepend=-1).astype(bool) | is_pause)
    stops = np.append(starts[1:], time.size)
    rests = stretches_at_rest(time, load, rig.limits.rest_band)
    rest = [RestSegment(quiet[:, begin:end], step) for begin, end in quiet_stretches(rests)]
    hold = np.arange(starts.size, dtype=float)
    change = np.maximum.reduceat(load, starts) - np.minimum.reduceat(load, starts)
    fewest, most, in_long_block = MOVING_PARTS
    parts = np.clip(np.ceil(change / rig.full_scale_load / PART_CHANGE), fewest,
                    np.clip(length // MOVING_PART, most, in_long_block))
    for begin, end in rests:
        inside = (starts >= begin) & (stops <= end)
        hold[inside] = -float(begin) - 1.0
        parts[inside] = [_held_parts(since, length)
                         for since in (time[starts[inside]] - time[begin]).tolist()]
    blocks = [(int(a), int(b), min(int(count), int(b - a)))
              for a, b, count in zip(starts, stops, parts, strict=True)]
    count = max(1, round(BLOCK_SECONDS / step))
    wider = [(max(begin - count, 0), min(end + count, time.size))
             for begin, end in level_stretches(time, load, rig.limits.rest_band)]
    held = [_held(time, load, begin, end, count) for begin, end in wider
            if end - begin >= 6 * count]
    return _Blocks(blocks, rest, hold, held, None, 1)


def _held(time: Array, load: Array, begin: int, end: int, count: int) -> tuple[int, int]:
    """Samples [start, stop) about the middle of [begin, end) that lie on a straight line.

    The line is that of the middle half; means over `count` samples are compared with it.
    """
    size, quarter, first = end - begin, (end - begin) // 4, max(begin - count, 0)
    place = np.arange(size) + begin - first
    around = load[first:end + count]
    short = span_means(around, np.maximum(place - count // 2, 0),
                       np.minimum(place + count // 2 + 1, around.size))
    seconds, middle = time[begin:end] - time[begin], slice(quarter, size - quarter)
    line = np.polyval(np.polyfit(seconds[middle], load[begin:end][middle], 1), seconds)
    away = np.flatnonzero(
        np.abs(short - line) > NOISE_BAND * white_noise(load[begin:end]) / math.sqrt(count))
    before, after = away[away < size // 2], away[away >= size // 2]
    return (begin + int(before[-1]) + 1 if before.size else begin,
            begin + int(after[0]) if after.size else end)


def _steady(time: Array, load: Array, held: Sequence[tuple[int, int]]) -> Array:
    """The load (N,) with local straight lines while it is held.

    The simulated friction of cylinder and bracket would follow the noise of the load cell, which
    the ring does not feel, and lose its memory.
    """
    steady, half = load.copy(), max(1, round(STEADY_TIME / float(np.median(np.diff(time)))))
    for start, stop in held:
        seconds, force = time[start:stop] - time[start], load[start:stop]
        place = np.arange(stop - start)
        first, last = np.maximum(place - half, 0), np.minimum(place + half + 1, stop - start)
        means = span_means(np.stack([seconds, force, seconds**2, seconds * force]), first, last)
        slope = (means[3] - means[0] * means[1]) / np.maximum(
            means[2] - means[0] ** 2, np.finfo(float).tiny)
        steady[start:stop] = means[1] + slope * (seconds - means[0])
    return steady


def _load_grid(elevation: float, time: Array, load: Array, zero_load: float,
               blocks: _Blocks) -> LoadGrid:
    """Mean time and load of the parts of every block, and of the samples between blocks.

    The parts of a block end at its edges, because a part beyond an edge would shift the mean.
    """
    cuts: list[int] = []
    first, last, reached = [], [], 0
    for start, stop, parts in blocks.spans:
        cuts += range(reached, start, blocks.between)
        first.append(len(cuts))
        cuts += [round(cut) for cut in np.linspace(start, stop, parts + 1)[:-1].tolist()]
        last.append(len(cuts))
        reached = stop
    cuts += range(reached, time.size, blocks.between)
    starts = np.array(cuts, dtype=np.int64)
    count = np.diff(np.append(starts, time.size))
    return LoadGrid(
        elevation=elevation, time=np.add.reduceat(time, starts) / count,
        load=np.add.reduceat(_steady(time, load, blocks.held), starts) / count,
        zero_load=zero_load,
        first=np.array(first), last=np.array(last), max_step=LONGEST_STEP,
        load_noise=white_noise(load) / np.sqrt([stop - start for start, stop, _ in blocks.spans]))


STILL_SHARE, PASSING_SHARE = 0.01, 0.05
"""Share of a probe's motion in which it stands still at an end, and of the load's that passes."""


def cut_off_probes(runs: Sequence[RunBlocks], rig: Rig) -> list[tuple[str, int, float]]:
    """Variants and limits [m] of `probe_saturation` at which probes stand still under load."""
    channels = np.hstack([run.channels for run in runs])
    load = np.concatenate([run.inputs['load'] for run in runs])
    return [('probe_saturation', number - 1 + 4 * int(end < 0.0), float(abs(end)))
            for number, own in zip(rig.probes.present, channels, strict=True)
            for end in (own.min(), own.max())
            if np.ptp(load[np.abs(own - end) < STILL_SHARE * np.ptp(own)])
            > PASSING_SHARE * np.ptp(load)]


def smooth_rate(load: Array, time: Array) -> Array:
    """Change of a load (N,) per second, as a running mean over 0.1 s."""
    size = max(1, round(0.1 / float(np.median(np.diff(time)))))
    return np.convolve(np.gradient(load, time), np.ones(size) / size, mode='same')


def rigs_of(records: Sequence[PreparedRecord]) -> list[str]:
    """Names of the rigs in the metadata of the bags."""
    return sorted({record.test_run.rig for record in records})


def check_set(records: Sequence[PreparedRecord], rig: Rig) -> list[str]:
    """Limits of a set of bags, one sentence each."""
    fitted = [record for record in records if not record.run.held_out]
    tests = {record.test_run.test for record in fitted}
    elevations = sorted({round(np.degrees(record.test_run.elevation), 1) for record in fitted})
    rigs = rigs_of(records)
    notes: list[str] = []
    if len(fitted) == 1:
        notes.append('one run only: the misfit reduction on held-out runs cannot be measured')
    if tests == {'static'}:
        notes.append('static runs only: D1, D2 and rate-dependent causes cannot be judged; '
                     'if these show no cause, a held-out dynamic run is fitted, too')
    if tests == {'dynamic'}:
        notes.append('dynamic runs only: slow effects and loops are hard to tell from damping')
    if len(elevations) == 1:
        notes.append(f'one elevation only ({elevations[0]:g} deg): load gain, elevation error, '
                     'moment arm and compliances are hard to tell apart')
    if len(rigs) > 1:
        notes.append(f'bags from different rigs ({", ".join(rigs)}), simulated as one: a '
                     'difference between the rigs is a misfit too, so that no cause is certain; '
                     'diagnose each rig separately')
    for record in fitted:
        peak = float(np.max(record.measured.load))
        if peak < rig.limits.threshold_min:
            notes.append(f'{record.run.name}: peak load {rig.force_words(peak)} is under half of '
                         f'full scale ({rig.force_words(rig.full_scale_load)}): effects that '
                         'begin above this load cannot show')
        if float(np.ptp(record.run.time)) < 5.0:
            notes.append(f'{record.run.name}: {np.ptp(record.run.time):.1f} s long: slower '
                         'effects cannot show')
    return notes
