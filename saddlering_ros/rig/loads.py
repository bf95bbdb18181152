"""From the cylinder's load to force and moment at the ring's reference point C."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from saddlering_ros.rig.description import Rig


@dataclass(frozen=True)
class ResolvedLoad:
    """Force [N] and moment [N m] at C, load-positive; the dead weight is not in it."""

    force_x: NDArray[np.float64]
    force_y: NDArray[np.float64]
    moment: NDArray[np.float64]


def resolve_load(rig: Rig, load: ArrayLike, elevation: ArrayLike) -> ResolvedLoad:
    """Resolve load P [N] along the barrel axis at `elevation` [rad], applied at the trunnion.

    F_x = P cos(theta), F_y = -P sin(theta), M = P (y_t cos(theta) + x_t sin(theta)).
    """
    magnitude = np.asarray(load, dtype=np.float64)
    cosine, sine = np.cos(elevation), np.sin(elevation)
    arm = rig.trunnion.y * cosine + rig.trunnion.x * sine
    return ResolvedLoad(magnitude * cosine, -magnitude * sine, magnitude * arm)
