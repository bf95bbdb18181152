"""Prior spreads of the errors of a sound simulator and a sound sensor."""

from __future__ import annotations

from dataclasses import dataclass

FREE_OFFSET = 10.0
"""Spread of a free constant, in ranges of the channel."""


@dataclass(frozen=True)
class ModelErrorPrior:
    """How wrong the simulator may be, smoothly, without that being a finding; share of range.

    smooth: over the drive; loop: with its direction; rate: at the fastest change of the drive.
    instants [s]: how well a channel's time is known beside the drive's, run by run.
    """

    smooth: float = 3e-4
    loop: float = 1e-4
    rate: float = 1.5e-3
    degree: int = 4
    instants: float = 7e-4
