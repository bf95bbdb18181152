"""The noise of every run and channel: as declared for any machine, or learnt at rest for a ring.

A declaration (`Noise.white`, `from_rest`, `unknown` ...) resolves to a process by the learner of
`estimation`. A misfit far from the noise gives a warning.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Literal

import numpy as np
from scipy.optimize import nnls
from scipy.special import ndtr

from saddlering_ros.discrepancy.problem.system import Array, DiscrepancyError, RunBlocks
from saddlering_ros.estimation import record_noise
from saddlering_ros.estimation.noise import HeldSeries, noise_by_class, RestSource, sampling_class
from saddlering_ros.estimation.process import ChannelNoise, fisher_chance, fisher_share_below
from saddlering_ros.estimation.record_noise import ChannelRecord, continued, noise_of_stretches
from saddlering_ros.estimation.rest import RestSegment

KNOWN_EXACTLY = 1_000_000
"""Degrees of freedom of a declared level."""

MAX_SPECTRUM_ERROR = 0.5
"""Largest rms error of the logarithm of a spectrum in the fit by relaxations."""

Records = Sequence[ChannelRecord]
NoiseOfRuns = Mapping[str, ChannelNoise]


@dataclass(frozen=True)
class Noise:
    """Declared noise of one channel. Use the constructors; the engine calls `resolve`.

    resolve: the process by run; the records hold readings first and residuals later.
    """

    resolve: Callable[[Records], NoiseOfRuns]
    learns_from_residuals: bool = False

    @staticmethod
    def white(std: float) -> Noise:
        """Independent noise of standard deviation `std` [the channel's unit] in every sample."""
        if not (isinstance(std, (int, float, np.number)) and 0.0 < std < np.inf):
            raise DiscrepancyError(f'noise: std is {std}: give a number above zero')
        noise = white_noise(float(std), KNOWN_EXACTLY)
        return Noise(partial(_in_every_run, noise))

    @staticmethod
    def from_rest(intervals: Sequence[tuple[float, float] | tuple[str, float, float]]) -> Noise:
        """Noise as measured while the system rests.

        Each interval is (start, end) [unit of time] in every run, or (run, start, end) in one.
        """
        if not intervals:
            raise DiscrepancyError('noise: from_rest needs at least one interval (start, end)')
        for interval in intervals:
            parts = list(interval) if isinstance(interval, (tuple, list)) else []
            run, *ends = parts if len(parts) == 3 else ['', *parts]
            if not (isinstance(run, str) and len(ends) == 2
                    and all(isinstance(end, (int, float, np.number)) for end in ends)):
                raise DiscrepancyError(f'noise: from_rest has {interval!r}: give a list of '
                                       'intervals (start, end) or (run, start, end)')
            start, end = interval[-2:]
            if not start < end:
                raise DiscrepancyError(
                    f'noise: the interval at rest from {start:g} to {end:g} is empty: give the '
                    'start first')
        return Noise(partial(_at_rest, [tuple(interval) for interval in intervals]))

    @staticmethod
    def from_repeats(repeats: Sequence[str | Array]) -> Noise:
        """Noise as the difference between repeats of one test.

        `repeats` are names of runs, or records (N,) of the channel sampled like the runs.
        """
        kinds = ['name' if isinstance(one, str) else (np.ndim(one), np.asarray(one).dtype.kind)
                 for one in repeats]
        if len(repeats) < 2 or not {*kinds} <= {'name', (1, 'f'), (1, 'i'), (1, 'u')}:
            raise DiscrepancyError('noise: from_repeats needs two repeats or more: give a list of '
                                   'the names of their runs, or of their readings')
        return Noise(partial(_between_repeats, tuple(repeats)))

    @staticmethod
    def spectrum(frequency: Array, density: Array) -> Noise:
        """Noise of a one-sided power spectral density [unit^2 / Hz] at `frequency` [1 / time]."""
        frequency, density = (np.asarray(one, dtype=np.float64) for one in (frequency, density))
        is_paired = frequency.size == density.size >= 2
        if not (is_paired and np.all(frequency > 0.0) and np.all(density > 0.0)):
            raise DiscrepancyError(
                'noise: a spectrum needs two frequencies or more, all above zero, and a density '
                'above zero at each')
        low, high = float(frequency.min()), float(frequency.max())
        constants = record_noise.relaxation_grid(0.5 / (np.pi * high), 0.5 / (np.pi * low))
        slow = 4.0 * constants / (1.0 + (2.0 * np.pi * frequency[:, None] * constants) ** 2)
        columns = np.column_stack([np.full(frequency.size, 2.0), slow])
        unit = columns.max(axis=0)
        solved = nnls(columns / unit / density[:, None], np.ones(density.size))[0] / unit
        error = np.log(np.maximum(columns @ solved, 1e-300) / density)
        if float(np.sqrt(np.mean(error**2))) > MAX_SPECTRUM_ERROR:
            raise DiscrepancyError(
                'noise: the spectrum rises with frequency or has lines, which white noise and '
                'relaxations cannot represent: give from_rest, or smooth the spectrum')
        white = max(float(solved[0]), 1e-9 * float(density.min()))
        return Noise(partial(_in_every_run, ChannelNoise(
            white, solved[1:], 0.0, KNOWN_EXACTLY, constants)))

    @staticmethod
    def unknown(walk: float = 0.0) -> Noise:
        """Noise learnt from the remainder of a flexible fit of the residuals (the default).

        walk: standard deviation by which a sensor wanders beside it in one unit of time, as a
        random walk [the channel's unit over the root of the unit of time].
        """
        if not (isinstance(walk, (int, float, np.number)) and 0.0 <= walk < np.inf):
            raise DiscrepancyError(f'noise: walk is {walk}: give a number, 0 for no random walk')
        return Noise(lambda records: {
            record.run: record_noise.noise_of_residuals(record, float(walk))
            for record in records}, learns_from_residuals=True)


WANDERING = Noise(lambda records: {
    record.run: record_noise.noise_of_residuals(record, record_noise.walk_of(record))
    for record in records}, learns_from_residuals=True)
"""Noise as unknown, and the random walk of greatest likelihood, its last relaxation."""

ONE_RELAXATION = Noise(lambda records: {
    record.run: record_noise.relaxation_of(record) for record in records},
    learns_from_residuals=True)
"""Noise with one correlation time, learnt from all of the residual, what is slow included."""


def white_noise(std: float, pairs: int) -> ChannelNoise:
    """Independent noise of every sample; pairs: degrees of freedom of its level."""
    return ChannelNoise(0.0, np.zeros(0), 0.0, pairs, np.zeros(0), floor=std**2)


def _in_every_run(noise: ChannelNoise, records: Records) -> NoiseOfRuns:
    return {record.run: noise for record in records}


def _at_rest(intervals: Sequence[tuple[str | float, ...]], records: Records) -> NoiseOfRuns:
    stretches: list[Array] = []
    longest = 0.0
    step = min(record.step for record in records)
    for record in records:
        for interval in intervals:
            if len(interval) == 3 and interval[0] != record.run:
                continue
            inside = list(record.stretches(*map(float, interval[-2:])))
            stretches += inside
            longest = max([longest, *(row.size * record.step for row in inside)])
    noise = noise_of_stretches(stretches, step, 0.25 * longest, 'the declared rest')
    return {record.run: continued(noise, 0.25 * longest, record.duration) for record in records}


def _between_repeats(repeats: Sequence[str | Array], records: Records) -> NoiseOfRuns:
    by_run = {record.run: record for record in records}
    rows, wanted = [], None
    for repeat in repeats:
        if not isinstance(repeat, str):
            rows.append(np.asarray(repeat, dtype=np.float64))
            continue
        if repeat not in by_run:
            raise DiscrepancyError(f'noise: from_repeats names the run {repeat!r}, which is not '
                                   f'among {", ".join(by_run)}')
        values, time = by_run[repeat].values, by_run[repeat].time
        time = time - time[0]
        if wanted is None:
            wanted = time
        if time.size != wanted.size or not np.allclose(time, wanted):
            values = np.interp(wanted, time, values, right=np.nan)
        rows.append(values)
    # Repeats (K, N) on the time of the first.
    stack = np.array([row[:min(row.size for row in rows)] for row in rows])
    step, count = min(record.step for record in records), len(stack)
    grown = np.sqrt(count / (count - 1.0))
    time = np.linspace(0.0, step * (stack.shape[1] - 1), stack.shape[1])
    stretches = [
        stretch for row in stack - stack.mean(axis=0)
        for stretch in ChannelRecord('', time, np.asarray(row * grown)).stretches()]
    longest = 0.25 * max((stretch.size for stretch in stretches), default=0) * step
    noise = noise_of_stretches(stretches, step, longest, 'the difference of the repeats')
    degrees = max(1, noise.pairs * (count - 1) // count)
    return dict.fromkeys(by_run, replace(noise, pairs=degrees))


PROVISIONAL_STD = 0.01
"""Unknown noise as a share of range in the first fit: any size gives plain least squares."""

EXACT = 1e-9
"""Share of range below which a residual is rounding: far below any instrument's noise."""

SURE = 1000
"""Degrees of freedom of the level of a residual that is nothing, or not yet known."""


def noise_of_channel(declared: Noise, readings: Records, left: Records | None,
                     scale: float) -> dict[str, ChannelNoise]:
    """The noise of one channel by run, as declared, or learnt from what a fit leaves of it."""
    if not declared.learns_from_residuals:
        own = dict(declared.resolve(readings))
        for record in left or ():
            if own[record.run].pairs < KNOWN_EXACTLY:  # Declared noise does not change.
                own[record.run] = record_noise.widened(own[record.run], record)
        return own
    if left is None:
        return {record.run: white_noise(PROVISIONAL_STD * scale, SURE) for record in readings}
    exact = white_noise(EXACT * scale, SURE)
    return {record.run: exact if np.nanmax(np.abs(record.values)) < EXACT * scale
            else declared.resolve([record])[record.run] for record in left}


MAX_CHANCE = 1e-3
"""Chance of as small or as large a misfit from noise alone, below which the noise is over- or
underestimated ..."""

MAX_RATIO = 0.5
"""... if the misfit is also below this share of the expected one, or above one over it."""


def wrong_level(statistic: float, dimensions: float,
                degrees: float) -> Literal['over', 'under'] | None:
    """Whether a whitened misfit over `dimensions` is far from the misfit of noise alone.

    degrees: degrees of freedom of the level of the noise, which is over- or underestimated.
    """
    ratio = statistic / dimensions
    if ratio < MAX_RATIO and fisher_share_below(ratio, dimensions, degrees) < MAX_CHANCE:
        return 'over'
    if ratio > 1.0 / MAX_RATIO and fisher_chance(ratio, dimensions, degrees) < MAX_CHANCE:
        return 'under'
    return None


def is_correlated(whitened: Array) -> bool:
    """Whether neighbours of a whitened misfit (n,) are alike, which noise of no level is.

    By their correlation (J. von Neumann, Ann. Math. Stat. 12 (1941) 367).
    """
    products, squares = whitened[1:] @ whitened[:-1], max(float(whitened @ whitened), 1e-300)
    return bool(ndtr(-products / squares * whitened.size**0.5) < MAX_CHANCE)


def noise_sentence(side: Literal['over', 'under'], statistic: float, dimensions: float,
                   where: str) -> str:
    """The warning for a reader if the noise is over- or underestimated."""
    remedy = {
        'under': ', and no cause explains it; give the noise of the channel as it is, leave it to '
                 'be learnt (Noise.unknown), or declare a model error',
        'over': ': nothing can be concluded on what is smaller than this noise; give the noise of '
                'the channel as it is (Noise.white, Noise.from_rest)'}[side]
    return (f'noise {side}estimated in {where}: the misfit is {statistic:.3g} where noise alone '
            f'would give about {dimensions:.3g}{remedy}')


def learn_noise(runs: Sequence[RunBlocks],
                residuals: Sequence[Array] | None = None) -> dict[tuple[str, int], ChannelNoise]:
    """Noise by run name and channel; runs with equal sampling share one estimate.

    `residuals` (C, N) per run, if given, add the noise between holds.
    """
    segments: dict[int, list[RestSegment]] = {}
    series: dict[int, list[HeldSeries]] = {}
    # A run without rest has a class of its own.
    keys = [sampling_class(run.rest[0].step) if run.rest else -1 for run in runs]
    for number, (key, run) in enumerate(zip(keys, runs, strict=True)):
        if run.rest:
            segments.setdefault(key, []).extend(run.rest)
        held = None if residuals is None else _held_series(run, residuals[number])
        if held is not None:
            series.setdefault(key, []).append(held)
    if not segments:
        raise DiscrepancyError(
            'noise: no stretch at rest in any run: record one in which the input is held')
    classes = {key: RestSource(rest, series.get(key, ())) for key, rest in segments.items()}
    count = runs[0].channels.shape[0]
    learnt = noise_by_class(classes, count)
    first = next(iter(learnt.values()))
    return {(run.name, channel): learnt.get(key, first)[channel]
            for key, run in zip(keys, runs, strict=True) for channel in range(count)}


def _held_series(run: RunBlocks, residual: Array) -> HeldSeries | None:
    """Means of a residual over consecutive holds, if the run is made of holds."""
    hold = run.hold
    if hold is None:
        return None
    levels, place = np.unique(hold, return_inverse=True)
    if levels.size < 8 or levels.size > 0.6 * hold.size:
        return None
    weight = np.bincount(place, run.width)
    time = np.bincount(place, run.width * run.time) / weight
    order = np.argsort(time)
    means = np.array([np.bincount(place, run.width * row) / weight for row in residual])
    return HeldSeries(means[:, order], time[order], weight[order].astype(np.float64))
