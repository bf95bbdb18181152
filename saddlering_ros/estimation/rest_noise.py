"""Noise learnt from stretches at rest: variances at all scales, read as relaxations."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from saddlering_ros.estimation.allan import allan_columns, allan_variances, mixture
from saddlering_ros.estimation.blocks import block_means
from saddlering_ros.estimation.errors import EstimationError
from saddlering_ros.estimation.process import ChannelNoise, mean_variance, TIME_CONSTANTS
from saddlering_ros.estimation.rest import RestSegment

Array = NDArray[np.float64]


MODEL_ERROR = 0.02
"""Relative error of a mixture of relaxations, because no real noise is exactly one."""

SHORT_MODEL_ERROR = 0.2
SMOOTHED = 3.5
"""Number of samples below which means have this error, because interpolated samples share the
noise of their neighbours."""

LEVEL_REACH = 1.5
"""Longest time constant, in lengths of the longest rest, if the level of a reading counts."""

MIN_NOISE = 1e-9
"""Smallest assumed noise of a displacement [m, or rad]: one nanometre."""

CORRELATED_OVER = 8
"""Readings in the means whose steps give the correlation of channels."""

TOO_SHORT = 'noise: the stretches at rest are too short to learn from'


@dataclass(frozen=True)
class HeldSeries:
    """Residual means (C, H) of consecutive holds at `time` (H,), each over `width` (H,) seconds.

    Second differences almost remove a simulator's smooth error and keep noise between holds.
    """

    means: Array
    time: Array
    width: Array


@dataclass(frozen=True)
class _Statistics:
    """Measured variances (S,), those of each part (S, 1 + T), and their weights."""

    seen: Array
    columns: Array
    pairs: Array


def measure_noise(
    segments: Sequence[RestSegment],
    count: int,
    series: Sequence[HeldSeries] = (),
    longest: float = np.inf,
    time_constants: Array = TIME_CONSTANTS,
) -> list[ChannelNoise]:
    """Noise of each of `count` channels, pooled over all stretches at rest.

    Parts with time constants above `longest` [s] are left out, because a few short stretches
    do not show slower noise, and a trend in them would count as a random walk.

    If there are many labelled stretches, whose common course can be subtracted, they are
    preferred.

    The channels share the shape of the slow part, because they are instruments of one kind and
    one channel alone shows too little slow noise. They do not share its size or the white
    part.
    """
    if not segments:
        raise EstimationError(
            'noise: no stretch at rest in any run: record one in which the input is held'
        )
    labelled = [segment for segment in segments if segment.label]
    if len(labelled) >= 20:
        segments = labelled
    statistics = [
        _statistics(segments, channel, series, time_constants) for channel in range(count)
    ]
    seen = np.append(True, longest >= time_constants)
    statistics = [replace(item, columns=item.columns * seen) for item in statistics]
    solved = [mixture(item.columns, item.seen, item.pairs) for item in statistics]
    totals = [max(float(item.seen.max()), np.finfo(float).tiny) for item in statistics]
    # One shape: the statistics of each channel over its own size, all in one mixture.
    pooled = mixture(
        np.vstack([item.columns for item in statistics]),
        np.concatenate(
            [item.seen / total for item, total in zip(statistics, totals, strict=True)]
        ),
        np.concatenate([item.pairs for item in statistics]),
    )
    answers = []
    for channel, item in enumerate(statistics):
        shape = pooled[1:]
        if shape.sum() > 0.0:
            columns = np.column_stack([item.columns[:, 0], item.columns[:, 1:] @ shape])
            white, size = mixture(columns, item.seen, item.pairs)
            slow = size * shape
        else:
            white, slow = solved[channel][0], np.zeros(time_constants.size)
        fine = min(segment.step for segment in segments)
        white = max(float(white), 1e-9 * totals[channel] * fine)
        step = _quantum(segments, channel)
        spread = float(np.sqrt(white / fine + slow.sum()))
        held = 0.0
        if step:
            held = 0.5 * (step / np.pi) ** 2 * float(np.exp(-4.0 * (np.pi * spread / step) ** 2))
        answers.append(ChannelNoise(white, slow, held, len(segments), time_constants))
    return answers


def _statistics(
    segments: Sequence[RestSegment],
    channel: int,
    series: Sequence[HeldSeries],
    time_constants: Array,
) -> _Statistics:
    """Allan variances at rest, and second differences from hold to hold."""
    rows = _without_common_course(segments, channel)
    scales, seen, pairs = allan_variances(rows)
    if scales.size == 0:
        raise EstimationError(TOO_SHORT)
    short = scales < SMOOTHED * min(step for _, step in rows)
    pairs = 1.0 / (1.0 / pairs + np.where(short, SHORT_MODEL_ERROR, MODEL_ERROR) ** 2)
    columns = [allan_columns(scales, time_constants)]
    differences, widths, spacings = [], [], []
    for item in series:
        spacing = np.diff(item.time)
        usual = float(np.median(spacing))
        even = (spacing[1:] < 1.5 * usual) & (spacing[:-1] < 1.5 * usual)
        differences.append(np.diff(item.means[channel], 2)[even])
        widths.append(float(np.median(item.width)))
        spacings.append(usual)
    joined = np.concatenate(differences) if differences else np.zeros(0)
    if joined.size >= 12:
        width, apart = float(np.mean(widths)), float(np.mean(spacings))
        columns.append(
            np.array(
                [
                    [6.0 / width]
                    + [_second_difference(width / tau, apart / tau) for tau in time_constants]
                ]
            )
        )
        robust = float(np.median(np.abs(joined)) / 0.6745) ** 2
        seen = np.append(seen, robust)
        pairs = np.append(pairs, joined.size / 3.0)
    return _Statistics(seen, np.vstack(columns), pairs)


def _second_difference(width: float, spacing: float) -> float:
    """Variance of second differences of means of unit OU noise; both in time constants."""
    shrink = float((-np.expm1(-width) / width) ** 2)
    near = shrink * float(np.exp(-max(spacing - width, 0.0)))
    far = shrink * float(np.exp(-max(2.0 * spacing - width, 0.0)))
    own = float(mean_variance(np.array([width]))[0])
    return max(6.0 * own - 8.0 * near + 2.0 * far, 1e-12)


def _without_common_course(
    segments: Sequence[RestSegment], channel: int
) -> list[tuple[Array, float]]:
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
            for row, member in zip(rows, members, strict=True)
        ]
    return cleaned


def _quantum(segments: Sequence[RestSegment], channel: int) -> float:
    """Step of the converter [unit], 0 if none shows."""
    values = np.unique(np.concatenate([segment.values[channel] for segment in segments]))
    if values.size < 3:
        return float(np.ptp(values)) if values.size > 1 else 0.0
    steps = np.diff(values)
    smallest = float(steps[steps > 1e-9 * np.abs(values).max()].min(initial=np.inf))
    if not np.isfinite(smallest):
        return 0.0
    multiples = steps / smallest
    regular = np.mean(np.abs(multiples - np.round(multiples)) < 0.05) > 0.95
    return (
        smallest
        if regular and values.size < 0.5 * sum(segment.values.shape[1] for segment in segments)
        else 0.0
    )


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
        [np.diff(block_means(segment.values, CORRELATED_OVER), axis=1) for segment in segments],
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
