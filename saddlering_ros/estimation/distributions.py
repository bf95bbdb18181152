"""Tails of the distributions that tests of significance use.

The formulas are those of `scipy.stats`, which takes a second of processor time to import; the
functions below need `scipy.special` only.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from scipy.special import fdtr, fdtrc, fdtri, gammaincinv, ndtri


def fisher_chance(ratio: Any, between: Any, within: Any) -> Any:
    """Chance that an F-distributed ratio is larger than `ratio`.

    between, within: degrees of freedom of numerator and denominator. A ratio below 0, which no
    such variable has, counts as 0.
    """
    return fdtrc(between, within, np.maximum(ratio, 0.0))


def fisher_share_below(ratio: Any, between: Any, within: Any) -> Any:
    """Chance that an F-distributed ratio is smaller than `ratio`."""
    return fdtr(between, within, np.maximum(ratio, 0.0))


def fisher_limit(chance: float, between: float, within: float) -> float:
    """Return the ratio that an F-distributed one exceeds with probability `chance`."""
    return float(fdtri(between, within, 1.0 - chance))


def chi_squared_quantile(share: float, freedom: float) -> float:
    """Return the value below which a chi-squared variable lies with probability `share`."""
    return float(2.0 * gammaincinv(0.5 * freedom, share))


def normal_quantile(share: float) -> float:
    """Return the value below which a standard normal variable lies with probability `share`."""
    return float(ndtri(share))
