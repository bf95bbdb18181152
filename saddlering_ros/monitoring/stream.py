"""Residuals joined with their load by stamp, and watched; whether the watch sees the ring now.

A residual that does not come, or comes late, cannot raise an alarm. The watch is then blind, which
must not look like a sound ring.
"""

from collections.abc import Sequence
import math

import numpy as np
from numpy.typing import NDArray

from saddlering_ros.monitoring.detector import least_wander, materiality
from saddlering_ros.monitoring.monitor import Monitor, MonitorSettings, Sample
from saddlering_ros.record import batches
from saddlering_ros.record.batches import Displacements, join, Samples
from saddlering_ros.rig import ContactParameters, Rig

MAX_WAITING = 60_000
"""Samples kept until their partner and the parameters are known: a minute at 1 kHz."""

PORTION = 8192
"""Samples made numbers of Python together: a stretch of a long record has many."""


class AlarmStream:
    """Watches batches of residuals and loads, in any interleaving of the two.

    A residual waits for its load, and for the parameters by `use`. percent: materiality as a share
    of each channel's range from preload to full scale [%]. `counters`: residuals that were not
    watched, because no load of their stamp came or too many waited.
    """

    def __init__(self, rig: Rig, settings: MonitorSettings, percent: float) -> None:
        self._contact: ContactParameters | None = None

        def allowed(elevation: float) -> NDArray[np.float64]:
            assert self._contact is not None
            return materiality(rig, self._contact, elevation, percent)

        self.monitor = Monitor(settings, rig.limits.rest_band, allowed, least_wander(rig))
        self.counters = {'without_load': 0, 'overflow': 0}
        self._forget()

    def _forget(self) -> None:
        """Discard waiting samples: another record begins."""
        self._residual = batches.no_displacements()
        self._stamps: NDArray[np.int64] = np.empty(0, np.int64)
        self._loads: NDArray[np.float64] = np.empty(0)

    @property
    def waiting(self) -> int:
        return len(self._residual)

    @property
    def knows_parameters(self) -> bool:
        return self._contact is not None

    def use(self, contact: ContactParameters) -> None:
        """The ring is simulated with these parameters."""
        before, self._contact = self._contact, contact
        if before not in (None, contact):
            self.monitor.parameters_changed()

    def push(self, residual: Displacements, load: Samples) -> None:
        if len(load):
            if len(self._stamps) and self._stamps[-1] - load.stamps[0] > batches.JITTER_NS:
                self._forget()
            sound = np.isfinite(load.values) & (load.stamps > 0)
            stamps = np.append(self._stamps, load.stamps[sound])
            loads = np.append(self._loads, load.values[sound])
            if len(stamps) > 1 and (np.diff(stamps) <= 0).any():
                stamps, first = np.unique(stamps, return_index=True)
                loads = loads[first]
            self._stamps, self._loads = stamps[-MAX_WAITING:], loads[-MAX_WAITING:]
        if len(residual):
            together = join([self._residual, residual]) if len(self._residual) else residual
            surplus = max(0, len(together) - MAX_WAITING)
            self.counters['overflow'] += surplus
            self._residual = together.pick(np.arange(surplus, len(together)))
        if self._contact is None or not len(self._residual) or not len(self._stamps):
            return
        batch = self._residual
        place = np.searchsorted(self._stamps, batch.stamps)
        inside = np.minimum(place, len(self._stamps) - 1)
        has_load = self._stamps[inside] == batch.stamps
        due = has_load | (batch.stamps < self._stamps[-1])
        self.counters['without_load'] += int((due & ~has_load).sum())
        self.watch(batch.pick(has_load), self._loads[inside[has_load]])
        self._residual = batch.pick(np.flatnonzero(~due))
        if has_load.any():
            until = int(batch.stamps[has_load].max())
            after = int(np.searchsorted(self._stamps, until, side='right'))
            self._stamps, self._loads = self._stamps[after:], self._loads[after:]

    def watch(self, batch: Displacements, loads: NDArray[np.float64]) -> None:
        """Watch residuals (N,) whose loads (N,) [N] are known."""
        columns = (batch.stamps, *batch.channels[:3], loads, batch.zero_stamps, batch.elevations)
        for start in range(0, len(batch), PORTION):
            rows = slice(start, start + PORTION)
            for stamp, x, y, gamma, load, zero, elevation in zip(
                    *(column[rows].tolist() for column in columns), strict=True):
                self.monitor.step(Sample(stamp, (x, y, gamma), load, zero, elevation))


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
        step = (newest - self.load_stamp) / batches.SECOND / len(stamps)
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
        lag = (self.load_stamp - self.residual_stamp) / batches.SECOND
        allowed = patience * speed if speed > 0.0 else LOCKSTEP_LAG
        return LATE if lag > allowed else SEEN


def blind_words(lacks: str, missing: Sequence[str], lag: float) -> str:
    """What the watch lacks, in one line; missing: topics; lag [s]: of the residual by stamp."""
    topics = ' and '.join(missing)
    return 'BLIND: ' + {
        NO_LOAD: f'no load arrives on {topics}: start the driver, or see to its network',
        LATE: f'{topics} is {lag:.2f} s behind the load: see to the probes, and to the '
              'load of the machine',
        NO_CHANNEL: f'{topics} holds no known channel: repair the probes, then call ~/zero',
        NO_RESIDUAL: f'nothing arrives on {topics}: its node is not running or not active, or has '
                     'no zero (go to preload, or call /ring_displacement/zero)'}[lacks]
