"""Rounding errors that readings at rest do not show, because they are the same for all of them.

A converter of step q rounds by up to q/2. Noise of several steps makes that error new in every
reading; a quieter sensor at rest is rounded alike for seconds, so that its readings seem free of
noise. What is hidden so has the variance (q^2 / 12) exp(-4 (pi s / q)^2) at noise s (Widrow and
Kollar, Quantization Noise, 2008, chapter 4: the part of the error that dither leaves).
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

HELD_SECONDS = 1.0
"""Time [s] after which a held load's rounding error counts as new: shorter than a plateau, so that
the noise of a mean over one is seen."""

HELD_FACTOR = math.sqrt(2.0)
"""A mean over a plateau has the whole error; one over several times HELD_SECONDS has less."""


def hidden_rounding(resolution: float, noise: float) -> float:
    """Rms rounding error that readings at rest hide, at a converter's step and rms of readings."""
    if not resolution > 0.0:
        return 0.0
    own = math.sqrt(max(noise**2 - resolution**2 / 12.0, 0.0))
    left = math.exp(-2.0 * (math.pi * own / resolution) ** 2)
    return resolution / math.sqrt(12.0) * left


def crossing_seconds(resolution: float, values: Array, seconds: float) -> float:
    """Time [s] that readings (N,) over `seconds` take to pass one step while they move."""
    travel = 2.0 * float(np.nanmax(values) - np.nanmin(values))
    return resolution / max(travel / max(seconds, 1e-9), 1e-300)


def rounding_record(rms: float, lasting: float, step: float, count: int, seed: int) -> Array:
    """An error (count,) of that rms at every `step` [s], new after each `lasting` [s]."""
    random = np.random.default_rng(seed)
    each = max(1, round(lasting / step))
    values = random.uniform(-1.0, 1.0, -(-count // each) + 1) * math.sqrt(3.0) * rms
    start = int(random.integers(each))
    return np.repeat(values, each)[start:start + count]
