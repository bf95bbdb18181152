"""Residuals joined with their load by stamp, and watched."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, fields

import numpy as np
from numpy.typing import NDArray

from saddlering_ros.monitoring.monitor import Monitor, MonitorSettings, Sample
from saddlering_ros.monitoring.noise import least_wander, materiality
from saddlering_ros.record.alignment import JITTER_NS
from saddlering_ros.record.samples import Displacements, join, no_displacements, pick, Samples
from saddlering_ros.rig import ContactParameters, Rig

MAX_WAITING = 60_000
"""Samples kept until their partner and the parameters are known: a minute at 1 kHz."""

PORTION = 8192
"""Samples made numbers of Python together: a stretch of a long record has many."""


@dataclass
class AlarmCounters:
    """Residuals that could not be watched, by reason.

    without_load: no load sample of that stamp came; overflow: too many waited.
    """

    without_load: int = 0
    overflow: int = 0

    def as_dict(self) -> dict[str, int]:
        """Every counter by name."""
        return {field.name: getattr(self, field.name) for field in fields(self)}


class AlarmStream:
    """Watches batches of residuals and loads, in any interleaving of the two.

    A residual waits until its load is there, and until `use` has set the parameters.
    percent: materiality as a share of each channel's range from preload to full scale [%].
    """

    def __init__(self, rig: Rig, settings: MonitorSettings, percent: float) -> None:
        self._rig, self._percent = rig, percent
        self._contact: ContactParameters | None = None
        self.monitor = Monitor(settings, rig.limits.rest_band, self._materiality,
                               least_wander(rig))
        self.counters = AlarmCounters()
        self._forget()

    def _forget(self) -> None:
        """Discard waiting samples: another record begins."""
        self._residual = no_displacements()
        self._stamps: NDArray[np.int64] = np.empty(0, np.int64)
        self._loads: NDArray[np.float64] = np.empty(0)

    @property
    def waiting(self) -> int:
        """Residuals that wait."""
        return len(self._residual)

    @property
    def knows_parameters(self) -> bool:
        """Whether `use` was called."""
        return self._contact is not None

    def use(self, contact: ContactParameters) -> None:
        """The ring is simulated with these parameters."""
        if self._contact == contact:
            return
        is_first = self._contact is None
        self._contact = contact
        if not is_first:
            self.monitor.parameters_changed()

    def push(self, residual: Displacements, load: Samples) -> None:
        """Take a batch of either stream."""
        self._keep(residual, load)
        if self._contact is None or not len(self._residual) or not len(self._stamps):
            return
        batch = self._residual
        place = np.searchsorted(self._stamps, batch.stamps)
        inside = np.minimum(place, len(self._stamps) - 1)
        found = self._stamps[inside] == batch.stamps
        due = found | (batch.stamps < self._stamps[-1])
        self.counters.without_load += int((due & ~found).sum())
        for sample in residual_samples(pick(batch, found), self._loads[inside[found]]):
            self.monitor.step(sample)
        self._residual = pick(batch, np.flatnonzero(~due))
        if found.any():
            until = int(batch.stamps[found].max())
            after = int(np.searchsorted(self._stamps, until, side='right'))
            self._stamps, self._loads = self._stamps[after:], self._loads[after:]

    def _materiality(self, elevation: float) -> NDArray[np.float64]:
        assert self._contact is not None
        return materiality(self._rig, self._contact, elevation, self._percent)

    def _keep(self, residual: Displacements, load: Samples) -> None:
        if len(load):
            if len(self._stamps) and self._stamps[-1] - load.stamps[0] > JITTER_NS:
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
            self.counters.overflow += surplus
            self._residual = pick(together, np.arange(surplus, len(together)))


def residual_samples(batch: Displacements, loads: NDArray[np.float64]) -> Iterator[Sample]:
    """The rows (N,) of a batch and their loads (N,) [N] as samples of the monitor."""
    for start in range(0, len(batch), PORTION):
        rows = slice(start, start + PORTION)
        columns = (batch.stamps, *batch.channels[:3], loads, batch.zero_stamps, batch.elevations)
        for stamp, x, y, gamma, load, zero, elevation in zip(
                *(column[rows].tolist() for column in columns), strict=True):
            yield Sample(stamp, (x, y, gamma), load, zero, elevation)
