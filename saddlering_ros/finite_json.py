"""Documents as JSON allows them: plain numbers, null for a number that is not finite."""

from __future__ import annotations

import math
from typing import Any

import numpy as np


def finite_json(value: Any) -> Any:
    """The same document with JSON numbers: infinite and undefined become null."""
    if isinstance(value, dict):
        return {key: finite_json(item) for key, item in value.items()}
    if isinstance(value, (list, tuple)):
        return [finite_json(item) for item in value]
    if isinstance(value, (bool, np.bool_)):
        return bool(value)
    if isinstance(value, (float, np.floating)):
        return float(value) if math.isfinite(value) else None
    if isinstance(value, np.integer):
        return int(value)
    return value
