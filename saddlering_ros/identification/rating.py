"""ISO/TS 18571 objective rating of two signals: corridor, phase, magnitude and slope.

Formulas and constants of ISO/TS 18571:2014 (metric R = 0.4 Z + 0.2 E_P + 0.2 E_M + 0.2 E_S).
The standard requires 10 kHz and 1 ms averages of the slope; signals here are resampled to at
most LONGEST points over the compared span, and the slope is averaged over nine of them.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from saddlering_ros.compiled import Compiler

Array = NDArray[np.float64]

LONGEST = 400
INNER_CORRIDOR, OUTER_CORRIDOR = 0.05, 0.50
MAX_SHIFT = 0.2
MAX_MAGNITUDE_ERROR = 0.5
MAX_SLOPE_ERROR = 2.0
WARPING_WINDOW = 0.1


@dataclass(frozen=True, slots=True)
class Rating:
    """Scores from 0 to 1; overall above 0.94 is excellent, 0.80 good, 0.58 fair."""

    corridor: float
    phase: float
    magnitude: float
    slope: float

    @property
    def overall(self) -> float:
        """The weighted rating R."""
        return 0.4 * self.corridor + 0.2 * (self.phase + self.magnitude + self.slope)


def rate(reference: Array, signal: Array) -> Rating:
    """Rate `signal` (N,) against `reference` (N,), both on one even time grid."""
    reference, signal = _shortened(reference), _shortened(signal)
    peak = float(np.max(np.abs(reference)))
    if len(reference) < 10 or peak == 0.0:
        same = float(np.array_equal(reference, signal))
        return Rating(same, same, same, same)
    shift = _best_shift(reference, signal)
    matched_reference, matched_signal = _shifted(reference, signal, shift)
    return Rating(
        corridor=_corridor(reference, signal, peak),
        phase=_score(abs(shift) / len(reference), MAX_SHIFT),
        magnitude=_magnitude(matched_reference, matched_signal),
        slope=_slope(matched_reference, matched_signal),
    )


def _shortened(values: Array) -> Array:
    if len(values) <= LONGEST:
        return np.asarray(values, dtype=float)
    return np.interp(np.linspace(0, len(values) - 1, LONGEST), np.arange(len(values)), values)


def _score(error: float, largest: float) -> float:
    return float(max(0.0, 1.0 - error / largest))


def _corridor(reference: Array, signal: Array, peak: float) -> float:
    inner, outer = INNER_CORRIDOR * peak, OUTER_CORRIDOR * peak
    score = (outer - np.abs(reference - signal)) / (outer - inner)
    return float(np.mean(np.clip(score, 0.0, 1.0) ** 2))


def _shifted(reference: Array, signal: Array, shift: int) -> tuple[Array, Array]:
    """Both signals over their common span when `signal` is taken `shift` samples later."""
    if shift >= 0:
        return reference[: len(reference) - shift], signal[shift:]
    return reference[-shift:], signal[: len(signal) + shift]


def _best_shift(reference: Array, signal: Array) -> int:
    """Shift of the highest cross-correlation, at most a fifth of the record; 0 when none gains."""
    best, highest = 0, -np.inf
    largest = int(MAX_SHIFT * len(reference))
    for shift in sorted(range(-largest, largest + 1), key=abs):
        first, second = _shifted(reference, signal, shift)
        norm = np.linalg.norm(first) * np.linalg.norm(second)
        correlation = float(first @ second / norm) if norm > 0.0 else -np.inf
        if correlation > highest + 1e-12:
            best, highest = shift, correlation
    return best


def _magnitude(reference: Array, signal: Array) -> float:
    window = max(1, int(WARPING_WINDOW * len(reference)))
    distance = float(_warping_distance(reference, signal, window))
    return _score(distance / float(np.sum(np.abs(reference))), MAX_MAGNITUDE_ERROR)


@Compiler(__file__)()
def _warping_distance(reference: Array, signal: Array, window: int) -> float:
    """L1 distance along the best dynamic time warping path (squared local cost) in a window."""
    count = len(reference)
    cost = np.full((count + 1, count + 1), np.inf)
    distance = np.zeros((count + 1, count + 1))
    cost[0, 0] = 0.0
    for i in range(1, count + 1):
        for j in range(max(1, i - window), min(count, i + window) + 1):
            error = abs(reference[i - 1] - signal[j - 1])
            a, b = i - 1, j - 1
            if cost[i - 1, j] < cost[a, b]:
                a, b = i - 1, j
            if cost[i, j - 1] < cost[a, b]:
                a, b = i, j - 1
            cost[i, j] = cost[a, b] + error * error
            distance[i, j] = distance[a, b] + error
    return float(distance[count, count])


def _slope(reference: Array, signal: Array) -> float:
    smooth = np.ones(9) / 9.0
    first = np.convolve(np.gradient(reference), smooth, mode='valid')
    second = np.convolve(np.gradient(signal), smooth, mode='valid')
    size = float(np.sum(np.abs(first)))
    if size == 0.0:
        return float(np.array_equal(first, second))
    return _score(float(np.sum(np.abs(first - second))) / size, MAX_SLOPE_ERROR)
