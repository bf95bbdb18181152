"""Assumptions on the probes that a rest of seconds cannot show."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from saddlering_ros.monitoring.innovations import BlockNoise
from saddlering_ros.rig import Rig

Array = NDArray[np.float64]

WANDER_SHARE = 5e-5
"""Wander assumed of a probe at least, as a share of its range: catalogues of eddy-current probes
state resolutions and drifts of 0.005 % of it. A rest of seconds shows too little of a wander that
takes seconds."""

FASTEST_WANDER = 1.0
"""Time [s] within which the wander is assumed to move: a slower one is more predictable."""

FAST_MEMORY = 0.5
"""Noise of a block of which less stays to the next block is no wander."""


def least_wander(rig: Rig) -> Array:
    """Standard deviation of the wander of delta_x, delta_y, gamma that is assumed at least (3,).

    The first two are half a difference or sum of two probes, gamma a difference over their span.
    """
    probes = rig.probes
    single = WANDER_SHARE * (probes.max_range - probes.min_range)
    half = single / math.sqrt(2.0)
    return np.array([half, half, 2.0 * half / probes.axial_span])


def assumed_noise(read: BlockNoise, least: float, block: float) -> BlockNoise:
    """The noise for watching: that of a rest, and a wander of at least `least`.

    Noise between white and a slow wander is counted to both.
    """
    is_slow = read.memory >= math.exp(-block / FASTEST_WANDER)
    white = read.white + (0.0 if is_slow else read.wander)
    wander = max(read.wander if read.memory >= FAST_MEMORY else 0.0, least**2)
    if wander == 0.0:
        return BlockNoise(white, 0.0, 0.0)
    return BlockNoise(white, wander, math.exp(-block / FASTEST_WANDER))
