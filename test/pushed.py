"""What a ring simulator gives for a record in batches of some sizes."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from saddlering_ros.ring.simulator import RingSimulator

Floats = NDArray[np.float64]


def pushed(simulator: RingSimulator, time: Floats, load: Floats,
           sizes: Sequence[int] = (1,)) -> tuple[Floats, Floats]:
    """Times (M,) and probe increments (4, M) of a record pushed in batches of `sizes` in turn."""
    found, start = [], 0
    while start < len(time):
        part = slice(start, start + sizes[len(found) % len(sizes)])
        found.append(simulator.push(time[part], load[part]))
        start = part.stop
    return np.concatenate([times for times, _ in found]), np.hstack([one for _, one in found])
