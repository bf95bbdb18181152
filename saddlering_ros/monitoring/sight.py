"""Whether the watch of the residual sees the ring now: by arrival and by stamp of its streams.

A residual that does not come, or comes late, cannot raise an alarm. The watch is then blind, which
must not look like a sound ring.
"""

from __future__ import annotations

from collections.abc import Sequence
import math

import numpy as np
from numpy.typing import NDArray

SECOND = 1_000_000_000

PATIENCE = 0.2
"""A stream may be silent, and a residual be behind its load, for so long [s] in real time."""

PERIODS = 3.0
"""The same in periods of the load, for a load of fewer than 15 samples a second."""

LOCKSTEP_LAG = 2.0
"""A residual may be so far behind its load [s by stamp] where a replay waits for its nodes."""

REPLAY_SILENCE = 2.5
"""A replay that has not reported for so long [s] is over; it reports once a second."""

SEEN, NO_LOAD, NO_RESIDUAL, LATE, NO_CHANNEL = '', 'load', 'residual', 'late', 'channel'
"""What the watch lacks: nothing, a load, a residual, a residual in time, a known channel."""


class Sight:
    """Hears when load and residual arrive; `now` is monotonic [s] throughout."""

    def __init__(self) -> None:
        self.load_stamp = self.residual_stamp = 0
        self.load_at = self.residual_at = self._known_at = -math.inf
        self._period = 0.0
        self._speed, self._replay_at = 1.0, -math.inf

    def hear_load(self, stamps: NDArray[np.int64], now: float) -> None:
        """Take the stamps (N,) [ns] of loads that have arrived."""
        if not len(stamps):
            return
        newest = int(stamps[-1])
        step = (newest - self.load_stamp) / SECOND / len(stamps)
        if self.load_stamp and 0.0 < step < 1.0:
            self._period += 0.1 * (step - self._period)
        self.load_stamp, self.load_at = newest, now

    def hear_residual(self, stamps: NDArray[np.int64], channels: NDArray[np.float64], now: float,
                      ) -> None:
        """Take residuals that have arrived: stamps (N,) [ns], channels (C, N), NaN: not known."""
        if not len(stamps):
            return
        self.residual_stamp, self.residual_at = int(stamps[-1]), now
        if np.isfinite(channels).any():
            self._known_at = now

    def hear_replay(self, speed: float, now: float) -> None:
        """A replay goes on at `speed` times real time; 0: it stands, or waits for its nodes."""
        self._speed, self._replay_at = speed, now

    def lacks(self, now: float) -> str:
        """SEEN, or what the watch lacks."""
        if self.load_at == -math.inf:
            return NO_LOAD
        speed = self._speed if now - self._replay_at < REPLAY_SILENCE else 1.0
        patience = max(PATIENCE, PERIODS * self._period / (speed or 1.0))
        if speed > 0.0:
            if now - self.load_at > patience:
                return NO_LOAD
            if now - self.residual_at > patience:
                return NO_RESIDUAL
            if now - self._known_at > patience:
                return NO_CHANNEL
        elif self.residual_at == -math.inf:
            return NO_RESIDUAL
        lag = (self.load_stamp - self.residual_stamp) / SECOND
        allowed = patience * speed if speed > 0.0 else LOCKSTEP_LAG
        return LATE if lag > allowed else SEEN


def blind_words(lacks: str, missing: Sequence[str], lag: float) -> str:
    """What the watch lacks, in one line; missing: topics; lag [s]: of the residual by stamp."""
    topics = ' and '.join(missing)
    if lacks == NO_LOAD:
        return f'BLIND: no load arrives on {topics}: start the driver, or see to its network'
    if lacks == LATE:
        return f'BLIND: {topics} is {lag:.2f} s behind the load: see to the load of the machine'
    if lacks == NO_CHANNEL:
        return f'BLIND: {topics} holds no known channel: repair the probes, then call ~/zero'
    return (f'BLIND: nothing arrives on {topics}: its node is not running or not active, or has '
            'no zero (go to preload, or call /ring_displacement/zero)')
