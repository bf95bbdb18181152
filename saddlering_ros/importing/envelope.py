"""The course of a channel of any length in a few thousand points, for a picture."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

MAX_POINTS = 4096
POINTS_PER_BLOCK = 256


@dataclass
class Envelope:
    """Stretches of a channel, each with its first stamp [ns], its lowest and highest value."""

    stamps: list[int] = field(default_factory=list)
    lowest: list[float] = field(default_factory=list)
    highest: list[float] = field(default_factory=list)

    def add(self, stamps: NDArray[np.int64], values: NDArray[np.float64]) -> None:
        """Add a block of samples (N,), N above 0."""
        starts = np.unique(np.linspace(0, len(stamps), POINTS_PER_BLOCK + 1).astype(int)[:-1])
        self.stamps += stamps[starts].tolist()
        self.lowest += np.minimum.reduceat(values, starts).tolist()
        self.highest += np.maximum.reduceat(values, starts).tolist()
        if len(self.stamps) > MAX_POINTS:
            self._halve()

    def _halve(self) -> None:
        even = len(self.stamps) // 2 * 2
        self.stamps = self.stamps[:even:2]
        self.lowest = np.minimum(self.lowest[:even:2], self.lowest[1:even:2]).tolist()
        self.highest = np.maximum(self.highest[:even:2], self.highest[1:even:2]).tolist()
