"""Noise of channels learnt from data: the one learner, and what it reads while a system rests.

Every source gives variances that are observed, and those that white noise and relaxations of unit
size would have there (`Statistics`). The learner fits a non-negative mixture of them. This module
has the sources of runs at rest: Allan variances, differences between holds, and the parity of four
probes. `record_noise` has those of a single record: stretches, repeats and residuals.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.optimize import nnls

from saddlering_ros.estimation import process
from saddlering_ros.estimation.process import Array, ChannelNoise, EstimationError, TIME_CONSTANTS
from saddlering_ros.estimation.rest import RestSegment
from saddlering_ros.record.quality import common_step

MODEL_ERROR = 0.02
"""Relative error of a mixture of relaxations, because no real noise is exactly one."""

SHORT_MODEL_ERROR, SMOOTHED = 0.2, 3.5
"""That error for means over fewer than SMOOTHED samples, because interpolated samples share the
noise of their neighbours."""

MIN_WHITE = 1e-9
"""Smallest white part, as a share of the largest variance, so that no covariance is singular."""

LEVEL_REACH = 1.5
"""Longest time constant, in lengths of the longest rest, if the level of a reading counts."""

MIN_NOISE = 1e-9
"""Smallest assumed noise of a displacement [m, or rad]: one nanometre."""

CORRELATED_OVER = 8
"""Readings in the means whose steps give the correlation of channels."""

MIN_LABELLED = 20
"""Labelled stretches from which their common course is known better than unlabelled ones are
free of trends."""

MIN_DIFFERENCES = 12
"""Second differences between holds from which their median is a variance."""

SEEN_SHARE = 0.25
"""Share of its length up to which a stretch at rest shows time constants of noise."""

FEW_STRETCHES = 10
"""Smallest number of stretches at rest that show noise slower than a stretch."""

MIN_SAMPLES = 16
"""Smallest number of samples at rest, or of a record, from which noise is learnt: its standard
deviation is then known within a fifth."""

LENT_FROM = 0.3
"""Time constant [s] from which noise is that of the instrument at any rate."""

COMPARED_COUNTS = (4, 8)
"""Samples over which the noise of a channel is compared with that of the parity: longer than the
smoothing by interpolation between stamps, shorter than any movement of a ring at rest."""

MAX_RATIO = 10.0
"""Ratio of variances of channel and parity above which another kind of sensor reads the
channel."""

MAX_GROWTH = 2.0
"""The parity is noise alone if its Allan variance over the record is at most this multiple of that
at rest, and grows at most this much faster than that of a random walk."""

SURE_PAIRS = 10
"""Smallest number of differences at rest for a comparison at an averaging time."""

TOO_SHORT = 'noise: the stretches at rest are too short to learn from'


@dataclass(frozen=True)
class Statistics:
    """What a source shows of a channel."""

    observed: Array  # (S,) variances
    columns: Array  # (S, 1 + T) of unit white density and each unit relaxation
    weights: Array  # (S,)

    def mixture(self) -> Array:
        """Non-negative parts (1 + T,) that fit the observed variances best, in relative terms."""
        observed, columns = self.observed, self.columns
        if not observed.any():
            return np.zeros(columns.shape[1])
        floor = max(float(observed.max()) * 1e-9, np.finfo(float).tiny)
        target = np.maximum(observed, floor)
        unit = np.maximum(columns.max(axis=0), np.finfo(float).tiny)
        weight = np.sqrt(self.weights) / target
        for _ in range(4):
            solution, _ = nnls(columns / unit * weight[:, None], target * weight)
            fitted = np.maximum(columns @ (solution / unit), floor)
            weight = np.sqrt(self.weights) / np.maximum(fitted, 0.2 * target)
        return np.asarray(solution / unit)


@dataclass(frozen=True)
class HeldSeries:
    """Residual means of H consecutive holds.

    Second differences almost remove a simulator's smooth error and keep noise between holds.
    """

    means: Array  # (C, H)
    time: Array  # (H,) [s]
    width: Array  # (H,) [s]: what each is a mean over


@dataclass(frozen=True)
class RestSource:
    """Sources of the noise of runs with equal sampling."""

    segments: Sequence[RestSegment]  # stretches at rest
    series: Sequence[HeldSeries] = ()  # means over consecutive holds
    parities: Sequence[RestSegment] = ()  # (1, n): records that are noise alone: its shape
    ratios: Array | None = None  # (C,): variance of the noise of each channel over theirs

    @classmethod
    def beside(cls, segments: Sequence[RestSegment], parities: Sequence[RestSegment],
               still: Sequence[Array]) -> 'RestSource':
        """Stretches at rest and parities (1, N_i) of whole records, if these are noise alone.

        The parity of the radial probes is zero for a rigid ring with any contact. If it is noise
        alone, it shows the slow noise of the whole record. A diagnosis must not read noise from
        it, because a cause may act on it. still (n_i,): the stretches of the parities at rest.
        """
        if not segments:
            return cls(segments)
        records = process.RowTotals([one.values[0] for one in parities])
        whole = np.array([records.pooled_variance(count)[0] for count in COMPARED_COUNTS])
        at_rest = [process.RowTotals([one.values[row] for one in segments])
                   for row in range(len(segments[0].values))]
        channels = np.array([
            [totals.pooled_variance(count)[0] for count in COMPARED_COUNTS] for totals in at_rest])
        if not (np.all(np.isfinite(channels)) and np.all(whole > 0.0)):
            return cls(segments)
        ratios = np.mean(channels / whole, axis=1)
        if np.any(ratios < 1.0 / MAX_RATIO) or np.any(ratios > MAX_RATIO):
            return cls(segments)
        # Whether the parities move by more than their noise at rest.
        resting, last, walk, count = process.RowTotals(still), 0, np.inf, 1
        while count <= max(int(records.sizes.max()) // 8, 1):
            moving, _ = records.pooled_variance(count)
            quiet, pairs = resting.pooled_variance(count)
            if pairs >= SURE_PAIRS:
                if moving > MAX_GROWTH * quiet:
                    return cls(segments)
                last, walk = count, moving
            elif last and moving > MAX_GROWTH * walk * count / last:
                return cls(segments)
            count *= 2
        return cls(segments, (), parities, np.asarray(ratios)) if last else cls(segments)

    @property
    def is_usable(self) -> bool:
        """Whether there are enough samples."""
        return sum(segment.values.shape[1] for segment in self.segments) >= MIN_SAMPLES

    def noise(self, count: int, longest: float) -> list[ChannelNoise]:
        """Noise of each of `count` channels, of time constants up to `longest` [s]."""
        if self.ratios is None:
            return measure_noise(self.segments, count, self.series, longest)
        shape = measure_noise(self.parities, 1, (), SEEN_SHARE * _longest(self.parities))[0]
        return [shape.times(float(ratio)) for ratio in self.ratios]


def sampling_class(step: float) -> int:
    """Class of the sampling rate of samples `step` [s] apart."""
    return round(20 * np.log10(step))


def noise_by_class(classes: Mapping[int, RestSource], count: int,
                   slowest: float = np.inf) -> dict[int, list[ChannelNoise]]:
    """Noise of each of `count` channels, by class of sampling rates.

    slowest: largest time constant of the richest class in its longest stretches. Slower noise
    serves only an analysis in which the level of each channel is free.
    """
    usable = {key: source for key, source in classes.items() if source.is_usable}
    if not usable:
        raise EstimationError(TOO_SHORT)
    # Slow noise belongs to the instrument and not to the rate: the richest class gives it.
    richest = max(usable, key=lambda key: len(usable[key].segments))
    best = usable[richest]
    learnt = {
        key: source.noise(
            count, (slowest if key == richest else SEEN_SHARE) * _longest(source.segments))
        for key, source in usable.items()}
    if best.ratios is None and not best.series and len(best.segments) < FEW_STRETCHES:
        # Noise beyond the longest stretch at rest is assumed to be as large as at that stretch.
        span = _longest(best.segments)
        learnt[richest] = [
            replace(noise, slow=np.where(
                span < TIME_CONSTANTS, np.maximum(noise.slow, noise.deviation(0.25 * span) ** 2),
                noise.slow))
            for noise in learnt[richest]]
    lent = [np.where(TIME_CONSTANTS >= LENT_FROM, noise.slow, 0.0) for noise in learnt[richest]]
    return {
        key: [replace(noise, slow=np.maximum(noise.slow, slow))
              for noise, slow in zip(channels, lent, strict=True)]
        for key, channels in learnt.items()}


def _longest(segments: Sequence[RestSegment]) -> float:
    """Length [s] of the longest stretch."""
    return max(segment.step * segment.values.shape[1] for segment in segments)


def measure_noise(segments: Sequence[RestSegment], count: int, series: Sequence[HeldSeries] = (),
                  longest: float = np.inf) -> list[ChannelNoise]:
    """Noise of each of `count` channels, pooled over all stretches at rest.

    Parts with time constants above `longest` [s] are left out, because a trend in a few short
    stretches would count as a random walk. Labelled stretches are preferred if there are many,
    because their common course can be subtracted. The channels share the shape of the slow part,
    of which one channel alone shows too little, but neither its size nor the white part.
    """
    if not segments:
        raise EstimationError(
            'noise: no stretch at rest in any run: record one in which the input is held')
    labelled = [segment for segment in segments if segment.label]
    if len(labelled) >= MIN_LABELLED:
        segments = labelled
    used = np.append(True, longest >= TIME_CONSTANTS)
    channels = []
    for channel in range(count):
        statistics = _rest_statistics(segments, channel, series)
        channels.append(replace(statistics, columns=statistics.columns * used))
    totals = [max(float(one.observed.max()), np.finfo(float).tiny) for one in channels]
    # One shape: the statistics of each channel over its own size, all in one mixture.
    scaled = [one.observed / total for one, total in zip(channels, totals, strict=True)]
    shape = Statistics(
        np.concatenate(scaled), np.vstack([one.columns for one in channels]),
        np.concatenate([one.weights for one in channels])).mixture()[1:]
    fine = min(segment.step for segment in segments)
    noise = []
    for channel, (statistics, total) in enumerate(zip(channels, totals, strict=True)):
        slow = np.zeros(TIME_CONSTANTS.size)
        if shape.sum() > 0.0:
            columns = statistics.columns
            columns = np.column_stack([columns[:, 0], columns[:, 1:] @ shape])
            white, size = replace(statistics, columns=columns).mixture().tolist()
            slow = size * shape
        else:
            white = float(statistics.mixture()[0])
        white = max(white, MIN_WHITE * total * fine)
        # Step of the converter, 0 if none shows.
        step = common_step(np.concatenate([one.values[channel] for one in segments]), 0.5)
        held = 0.0
        if step:
            spread = float(np.sqrt(white / fine + slow.sum()))
            held = 0.5 * (step / np.pi) ** 2 * float(np.exp(-4.0 * (np.pi * spread / step) ** 2))
        noise.append(ChannelNoise(white, slow, held, len(segments)))
    return noise


def _rest_statistics(segments: Sequence[RestSegment], channel: int,
                     series: Sequence[HeldSeries]) -> Statistics:
    """Allan variances at rest, and second differences from hold to hold."""
    rows = _without_common_course(segments, channel)
    scales, observed, pairs = process.allan_variances(rows)
    if scales.size == 0:
        raise EstimationError(TOO_SHORT)
    short = scales < SMOOTHED * min(step for _, step in rows)
    weights = 1.0 / (1.0 / pairs + np.where(short, SHORT_MODEL_ERROR, MODEL_ERROR) ** 2)
    columns = process.allan_columns(scales, TIME_CONSTANTS)
    differences, widths, spacings = [np.zeros(0)], [], []
    for holds in series:
        spacing = np.diff(holds.time)
        usual = float(np.median(spacing))
        even = (spacing[1:] < 1.5 * usual) & (spacing[:-1] < 1.5 * usual)
        differences.append(np.diff(holds.means[channel], 2)[even])
        widths.append(float(np.median(holds.width)))
        spacings.append(usual)
    joined = np.concatenate(differences)
    if joined.size < MIN_DIFFERENCES:
        return Statistics(observed, columns, weights)
    width, apart = float(np.mean(widths)), float(np.mean(spacings))
    # Variance of second differences of means of unit OU noise, in time constants.
    between = []
    for tau in TIME_CONSTANTS:
        ratio, spacing = width / tau, apart / tau
        shrink = float((-np.expm1(-ratio) / ratio) ** 2)
        near = shrink * float(np.exp(-max(spacing - ratio, 0.0)))
        far = shrink * float(np.exp(-max(2.0 * spacing - ratio, 0.0)))
        alone = float(process.mean_variance(np.array([ratio]))[0])
        between.append(max(6.0 * alone - 8.0 * near + 2.0 * far, 1e-12))
    robust = float(np.median(np.abs(joined)) / 0.6745) ** 2
    return Statistics(np.append(observed, robust),
                      np.vstack([columns, np.array([[6.0 / width, *between]])]),
                      np.append(weights, joined.size / 3.0))


def _without_common_course(segments: Sequence[RestSegment],
                           channel: int) -> list[tuple[Array, float]]:
    """Each stretch minus its own mean and the mean course of its label."""
    labels: dict[str, list[RestSegment]] = {}
    for segment in segments:
        labels.setdefault(segment.label, []).append(segment)
    cleaned: list[tuple[Array, float]] = []
    for label, members in labels.items():
        length = min(member.values.shape[1] for member in members)
        rows = [member.values[channel] for member in members]
        if label and len(rows) >= 6 and length >= 4:
            stack = np.array([row[:length] - row[:length].mean() for row in rows])
            shrink = np.sqrt(len(rows) / (len(rows) - 1.0))
            rows = list((stack - stack.mean(axis=0)) * shrink)
        cleaned += [
            (np.asarray(row - row.mean()), member.step)
            for row, member in zip(rows, members, strict=True)]
    return cleaned


def noise_alone(stretches: Sequence[Array], step: float) -> ChannelNoise:
    """Noise of one channel from its stretches (n_i,) at rest, sampled every `step` [s]."""
    segments = [RestSegment(row[None, :], step) for row in stretches]
    longest = max((row.size for row in stretches), default=0) * step
    noise = measure_noise(segments, 1, longest=LEVEL_REACH * longest)[0]
    return noise.at_least(MIN_NOISE, step)


def channel_correlation(segments: Sequence[RestSegment]) -> Array:
    """Correlation (C, C) of the noise of channels, from steps between means of a few readings.

    Single readings would show the correlation of the interpolation between stamps: the probe
    whose stamps lie between those of the load seems quieter. Insignificant values are 0.
    """
    steps = np.concatenate(
        [np.diff(process.block_means(one.values, CORRELATED_OVER), axis=1) for one in segments],
        axis=1)
    count = max(1, steps.shape[1])
    scale = np.sqrt(np.mean(steps**2, axis=1)) if steps.size else np.ones(len(steps))
    standard = steps / np.where(scale > 0.0, scale, 1.0)[:, None]
    correlation = standard @ standard.T / count
    noticeable = np.abs(correlation) > 4.0 / np.sqrt(count)
    correlation = np.where(noticeable, np.clip(correlation, -0.95, 0.95), 0.0)
    np.fill_diagonal(correlation, 1.0)
    if np.linalg.eigvalsh(correlation)[0] < 1e-3:
        return np.eye(len(correlation))
    return np.asarray(correlation)
