"""Measured minus simulated displacement, joined by exact stamp; no ROS in it."""

from __future__ import annotations

from dataclasses import dataclass, fields

import numpy as np

from saddlering_ros.bags.alignment import JITTER_NS
from saddlering_ros.nodes.wire import Displacements, join, no_displacements, SECOND
from saddlering_ros.rig.zeroing import STEADY_SHARE, WINDOW_SECONDS

KEEP_NS = 2 * SECOND
"""A sample this far behind the newest match will find no partner any more."""

MOST_WAITING = 100_000


@dataclass
class JoinCounters:
    """What was not subtracted, by reason.

    measured_alone, simulated_alone: samples without a partner of their stamp; zero_differs:
    pairs that count from different zeros; jumps: stamps that jumped back.
    """

    measured_alone: int = 0
    simulated_alone: int = 0
    zero_differs: int = 0
    jumps: int = 0

    def as_dict(self) -> dict[str, int]:
        """Every counter by name."""
        return {field.name: getattr(self, field.name) for field in fields(self)}


class _Side:
    """Samples of one stream that wait for their partners, each stamp once."""

    def __init__(self) -> None:
        self.waiting = no_displacements()
        self.newest = 0

    def push(self, batch: Displacements) -> bool:
        """Take a batch; whether its stamps jumped back."""
        if not len(batch):
            return False
        jumped = self.newest - int(batch.stamps[0]) > JITTER_NS
        if jumped:
            self.waiting = no_displacements()
        newest = int(batch.stamps.max())
        self.newest = newest if jumped else max(self.newest, newest)
        together = join([self.waiting, batch]) if len(self.waiting) else batch
        if len(together) > 1 and (np.diff(together.stamps) <= 0).any():
            _, first = np.unique(together.stamps, return_index=True)
            together = pick(together, first)
        self.waiting = together
        return jumped

    def forget(self, used: np.ndarray, before: int) -> int:
        """Drop rows `used` and rows stamped before `before`; how many of the latter."""
        keep = np.ones(len(self.waiting), dtype=bool)
        keep[used] = False
        old = keep & (self.waiting.stamps < before)
        keep &= ~old
        self.waiting = pick(self.waiting, np.flatnonzero(keep)[-MOST_WAITING:])
        return int(old.sum())


def pick(batch: Displacements, rows: np.ndarray) -> Displacements:
    """The given rows of a batch."""
    return Displacements(batch.stamps[rows], batch.channels[:, rows], batch.zero_stamps[rows],
                         batch.zero_loads[rows])


class ResidualStream:
    """Residuals from batches of measured and simulated displacements.

    Only samples of equal stamp are subtracted, and only when both count from the same zero: the
    zeros' stamps within the zero window's length, their loads within its steadiness.
    """

    def __init__(self, full_scale_load: float) -> None:
        self._load_tolerance = STEADY_SHARE * full_scale_load
        self._measured, self._simulated = _Side(), _Side()
        self.counters = JoinCounters()
        self.zeros_agree = True

    def reset(self) -> None:
        """Forget what waits."""
        self._measured, self._simulated = _Side(), _Side()

    @property
    def waiting(self) -> tuple[int, int]:
        """Measured and simulated samples that wait for a partner."""
        return len(self._measured.waiting), len(self._simulated.waiting)

    def push(self, measured: Displacements, simulated: Displacements) -> Displacements:
        """Take a batch of either stream; return measured minus simulated where both are there."""
        self.counters.jumps += self._measured.push(measured) + self._simulated.push(simulated)
        ours, theirs = self._measured.waiting, self._simulated.waiting
        if not len(ours) or not len(theirs):
            return no_displacements()
        stamps, mine, other = np.intersect1d(ours.stamps, theirs.stamps, assume_unique=True,
                                             return_indices=True)
        if not len(stamps):
            return no_displacements()
        measured, simulated = pick(ours, mine), pick(theirs, other)
        before = int(stamps[-1]) - KEEP_NS
        self.counters.measured_alone += self._measured.forget(mine, before)
        self.counters.simulated_alone += self._simulated.forget(other, before)
        return self._subtract(measured, simulated)

    def _subtract(self, measured: Displacements, simulated: Displacements) -> Displacements:
        apart = np.abs(measured.zero_stamps - simulated.zero_stamps)
        same = apart <= round(WINDOW_SECONDS * SECOND)
        same &= np.abs(measured.zero_loads - simulated.zero_loads) <= self._load_tolerance
        self.counters.zero_differs += int((~same).sum())
        self.zeros_agree = bool(same[-1])
        rows = np.flatnonzero(same)
        measured, simulated = pick(measured, rows), pick(simulated, rows)
        return Displacements(measured.stamps, measured.channels - simulated.channels,
                             measured.zero_stamps, measured.zero_loads)
