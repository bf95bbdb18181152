"""Operators with a memory, a sample at a time: plays, relaxations, the direction of a drive.

Each is causal: its value at a sample follows from that sample and those before. A law in such a
value can be simulated live, and gives the same numbers for any number of samples at once.
Rate-free hysteresis as a sum of plays with non-negative weights is the Prandtl-Ishlinskii model;
Krasnosel'skii and Pokrovskii, Systems with Hysteresis (1989).
"""

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


class Plays:
    """Plays of half widths `reaches` (R,) that begin in the middle of their widths."""

    def __init__(self, reaches: Array, start: float) -> None:
        self._reaches = reaches
        self._play = np.full(reaches.size, start)

    def push(self, value: float) -> Array:
        """The part of the drive (R,) that the plays do not follow over their reach, -1 to 1."""
        np.clip(self._play, value - self._reaches, value + self._reaches, out=self._play)
        return np.asarray((value - self._play) / self._reaches)


class Relaxations:
    """First-order lags of time constants (T,) [s] that begin at rest."""

    def __init__(self, constants: Array) -> None:
        self._constants = constants
        self._left = np.zeros(constants.size)

    def push(self, step: float, change: float) -> Array:
        """The drive minus the lags (T,) after it changed evenly by `change` during `step` [s]."""
        if step <= 0.0:
            self._left = self._left + change
            return self._left
        ratio = step / self._constants
        self._left = np.exp(-ratio) * self._left + change * -np.expm1(-ratio) / ratio
        return self._left


class Direction:
    """The direction of a drive: +1 while it rises, -1 while it falls, the last one at rest.

    A reversal counts once it exceeds `band`.
    """

    def __init__(self, band: float, start: float) -> None:
        self._band, self._extreme, self._sign = band, start, 1.0

    def push(self, value: float) -> float:
        """The direction at the next sample."""
        if self._sign * (value - self._extreme) > 0.0:
            self._extreme = value
        elif self._sign * (self._extreme - value) > self._band:
            self._sign, self._extreme = -self._sign, value
        return self._sign


def direction_of(drive: Array, band: float) -> Array:
    """+1 (N,) while the drive rises and -1 while it falls; at rest the last direction."""
    direction = Direction(band, float(drive[0]))
    return np.array([direction.push(value) for value in drive.tolist()])
