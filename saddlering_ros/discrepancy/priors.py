"""Prior spreads of the errors of a sound simulator and a sound sensor."""

from __future__ import annotations

from dataclasses import dataclass

FREE_OFFSET = 10.0
"""Spread of a free constant, in ranges of the channel."""


@dataclass(frozen=True)
class ModelErrorPrior:
    """Smooth error of the simulator that is no finding, as a share of range.

    smooth: over the drive; loop: with its direction; rate: at the fastest change of the drive.
    instants [s]: uncertainty of the time of a channel against the drive, per run.
    """

    smooth: float = 3e-4
    loop: float = 1e-4
    rate: float = 1.5e-3
    degree: int = 4
    instants: float = 7e-4
