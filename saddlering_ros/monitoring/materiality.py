"""Materiality: the residual that is allowed without an alarm, a share of the ring's motion."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from saddlering_ros.monitoring.errors import MonitoringError
from saddlering_ros.rig import ContactParameters, Rig
from saddlering_ros.ring.simulator import static_response

DEFAULT_PERCENT = 2.0
"""Share of the range of the motion from preload to full scale [%]."""

LOADS = 26
"""Loads at which the motion is looked at: a channel may turn back on the way to full scale."""


def materiality(
    rig: Rig, contact: ContactParameters, elevation: float, percent: float = DEFAULT_PERCENT
) -> NDArray[np.float64]:
    """`percent` of the range of each channel from preload to full scale, (3,) [m, m, rad].

    elevation: of the load [rad].
    """
    if not 0.0 <= percent < math.inf:
        raise MonitoringError(f'materiality is {percent:g} %: give 0 or more')
    loads = np.linspace(rig.preload, rig.full_scale_load, LOADS)
    motion = static_response(rig, contact.to_array(), elevation, loads)
    return np.asarray(0.01 * percent * np.ptp(motion, axis=1))
