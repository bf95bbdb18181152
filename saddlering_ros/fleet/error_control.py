"""Error control over many sessions and rings: at 1 % a verdict, a thousand give ten false alarms.

Benjamini and Hochberg, J. R. Stat. Soc. B 57 (1995) 289; e-values: Vovk and Wang, Ann. Stat. 49
(2021) 1736; e-BH: Wang and Ramdas, J. R. Stat. Soc. B 84 (2022) 822.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


def benjamini_hochberg(p_values: Sequence[float] | Array, level: float) -> NDArray[np.bool_]:
    """Which findings (N,) stand when at most the share `level` of them may be false."""
    values = np.asarray(p_values, dtype=float)
    if not values.size:
        return np.zeros(0, dtype=bool)
    order = np.argsort(values)
    allowed = level * np.arange(1, values.size + 1) / values.size
    passing = np.flatnonzero(values[order] <= allowed)
    accepted = np.zeros(values.size, dtype=bool)
    if passing.size:
        accepted[order[: passing[-1] + 1]] = True
    return accepted


def e_value(p_value: float) -> float:
    """Evidence against a sound ring, 1/2 p^(-1/2): its mean is at most 1 if the ring is sound."""
    return 0.5 / float(np.sqrt(max(p_value, 1e-300)))


def e_value_of_sessions(p_values: Sequence[float]) -> float:
    """Evidence of a ring's own sessions: independent e-values are multiplied."""
    logs = sum(np.log(e_value(value)) for value in p_values)
    return float(np.exp(min(logs, 700.0)))


def e_benjamini_hochberg(e_values: Sequence[float], level: float) -> NDArray[np.bool_]:
    """Which rings (N,) stand, at any dependence between them."""
    values = np.asarray(e_values, dtype=float)
    with np.errstate(divide='ignore'):
        return benjamini_hochberg(1.0 / values, level)
