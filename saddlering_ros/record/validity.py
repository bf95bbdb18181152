"""Bits of `validity`: unknown channels of a displacement, and values beside refused readings."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from saddlering_ros.rig import CHANNELS

NOT_KNOWN = dict(zip(CHANNELS, (1, 2, 4, 8), strict=True))
"""Bits of unknown channels, as in RingDisplacement.msg."""

BRIDGED = 16
"""Bit of a result that was interpolated across a reading that was refused."""

DOUBTFUL_LOAD = 32
"""Bit of a simulation by a load that came there in a step that the hydraulics cannot make."""


def unknown(channels: NDArray[np.float64]) -> NDArray[np.uint8]:
    """Bits (N,) for the channels (4, N) that are NaN."""
    bits = np.array(list(NOT_KNOWN.values()), np.uint8)[:, None]
    marks: NDArray[np.uint8] = (np.isnan(channels) * bits).sum(axis=0, dtype=np.uint8)
    return marks


def is_published(validity: NDArray[np.uint8]) -> NDArray[np.bool_]:
    """Mask (N,) of rows with any of delta_x, delta_y and gamma; the others are not published."""
    nothing = NOT_KNOWN['delta_x'] | NOT_KNOWN['delta_y'] | NOT_KNOWN['gamma']
    return np.asarray(validity & nothing != nothing)
