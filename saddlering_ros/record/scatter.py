"""The noise of samples of something smooth, judged from the samples alone."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

MAD_TO_STD = 1.4826
"""Standard deviation over median absolute deviation, for Gaussian noise."""


def white_noise(values: NDArray[np.float64], lag: int = 1) -> float:
    """Standard deviation of the noise on samples (N,) of something smooth.

    From second differences over `lag` samples, which a straight line has none of and whose
    variance is six times that of the samples; by their median, which steps do not move. Noise that
    changes more slowly than over `lag` samples does not count.
    """
    seen = values[np.isfinite(values)]
    if seen.size < 2 * lag + 1:
        return math.nan
    second = seen[2 * lag:] - 2.0 * seen[lag:-lag] + seen[:-2 * lag]
    return float(MAD_TO_STD * np.median(np.abs(second - np.median(second))) / math.sqrt(6.0))
