"""Measured minus simulated displacement, joined by exact stamp; of streams and of records."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np

from saddlering_ros.record import batches
from saddlering_ros.record.batches import Displacements, JITTER_NS, SECOND
from saddlering_ros.record.displacement import measured_rows, zero_of_run
from saddlering_ros.record.record import Record
from saddlering_ros.record.simulation import simulated_stretches
from saddlering_ros.rig import ParameterSet, Rig, ZeroReading
from saddlering_ros.rig.zeroing import MIN_SAMPLES, STEADY_SHARE, WINDOW_SECONDS

KEEP_NS = 2 * SECOND
"""A sample this far behind the newest match will find no partner any more."""

MAX_WAITING = 20_000
"""Samples of one side kept while its partner is silent: 20 s at 1 kHz."""


ELEVATION_TOLERANCE = np.radians(0.5)
"""Elevations that differ by more [rad] are of two tests."""


@dataclass
class JoinCounters:
    """Counts of samples that were not subtracted, by reason.

    measured_alone, simulated_alone: samples without a partner of their stamp; zero_differs:
    pairs that count from different zeros; elevation_differs: pairs at different elevations;
    jumps: stamps that jumped back.
    """

    measured_alone: int = 0
    simulated_alone: int = 0
    zero_differs: int = 0
    elevation_differs: int = 0
    jumps: int = 0


class _Side:
    """Samples of one stream that wait for their partners, each stamp once."""

    def __init__(self) -> None:
        self.waiting = batches.no_displacements()
        self.newest = 0
        self.given_up = 0

    def push(self, batch: Displacements) -> bool:
        """Take a batch; whether its stamps jumped back."""
        if not len(batch):
            return False
        jumped = self.newest - int(batch.stamps[0]) > JITTER_NS
        if jumped:
            self.waiting = batches.no_displacements()
        newest = int(batch.stamps.max())
        self.newest = newest if jumped else max(self.newest, newest)
        together = batches.join([self.waiting, batch]) if len(self.waiting) else batch
        if len(together) > 1 and (np.diff(together.stamps) <= 0).any():
            _, first = np.unique(together.stamps, return_index=True)
            together = together.pick(first)
        self.waiting = together
        return jumped

    def bound(self) -> None:
        """Give up the oldest of more samples than may wait."""
        surplus = len(self.waiting) - MAX_WAITING
        if surplus > 0:
            self.waiting = self.waiting.pick(slice(surplus, None))
            self.given_up += surplus

    def forget(self, used: np.ndarray, before: int) -> int:
        """Drop rows `used` and rows stamped before `before`; how many of the latter."""
        if len(used) == len(self.waiting) and not self.given_up:
            self.waiting = batches.no_displacements()
            return 0
        keep = np.ones(len(self.waiting), dtype=bool)
        keep[used] = False
        old = keep & (self.waiting.stamps < before)
        keep &= ~old
        self.waiting = self.waiting.pick(np.flatnonzero(keep))
        given_up, self.given_up = self.given_up, 0
        return int(old.sum()) + given_up


class ResidualStream:
    """Residuals from batches of measured and simulated displacements.

    Only samples of equal stamp are subtracted, and only when both count from the same zero: the
    zeros' stamps within the zero window's length, their loads within its steadiness. Where one
    side has zeroed anew alone, the other is brought to that zero if it was heard meanwhile.
    """

    def __init__(self, full_scale_load: float) -> None:
        self._load_tolerance = STEADY_SHARE * full_scale_load
        self._measured, self._simulated = _Side(), _Side()
        self.counters = JoinCounters()
        self.zeros_agree = True
        self.elevations_agree = True
        self._bridges: dict[tuple[int, ...], _Bridge] = {}

    def reset(self) -> None:
        """Discard waiting samples."""
        self._measured, self._simulated = _Side(), _Side()
        self._bridges.clear()

    @property
    def waiting(self) -> tuple[int, int]:
        """Measured and simulated samples that wait for a partner."""
        return len(self._measured.waiting), len(self._simulated.waiting)

    def push(self, measured: Displacements, simulated: Displacements) -> Displacements:
        """Take a batch of either stream; return measured minus simulated where both are there."""
        self.counters.jumps += self._measured.push(measured) + self._simulated.push(simulated)
        residual = self._joined()
        self._measured.bound()
        self._simulated.bound()
        return residual

    def _joined(self) -> Displacements:
        """The residuals at the stamps that wait on both sides."""
        ours, theirs = self._measured.waiting, self._simulated.waiting
        if not len(ours) or not len(theirs):
            return batches.no_displacements()
        if np.array_equal(ours.stamps, theirs.stamps):  # the usual case
            stamps, measured, simulated = ours.stamps, ours, theirs
            mine = other = np.arange(len(stamps))
        else:
            stamps, mine, other = np.intersect1d(ours.stamps, theirs.stamps, assume_unique=True,
                                                 return_indices=True)
            if not len(stamps):
                return batches.no_displacements()
            measured, simulated = ours.pick(mine), theirs.pick(other)
        before = int(stamps[-1]) - KEEP_NS
        self.counters.measured_alone += self._measured.forget(mine, before)
        self.counters.simulated_alone += self._simulated.forget(other, before)
        return self._subtract(*self._of_one_elevation(measured, simulated))

    def _of_one_elevation(self, measured: Displacements, simulated: Displacements,
                          ) -> tuple[Displacements, Displacements]:
        """The pairs whose elevations, where both are known, are the same."""
        differs = np.abs(measured.elevations - simulated.elevations) > ELEVATION_TOLERANCE
        self.elevations_agree = not differs[-1]
        if not np.count_nonzero(differs):
            return measured, simulated
        self.counters.elevation_differs += int(differs.sum())
        rows = np.flatnonzero(~differs)
        return measured.pick(rows), simulated.pick(rows)

    def _subtract(self, measured: Displacements, simulated: Displacements) -> Displacements:
        if not len(measured):
            return batches.no_displacements()
        apart = np.abs(measured.zero_stamps - simulated.zero_stamps)
        same = apart <= round(WINDOW_SECONDS * SECOND)
        same &= np.abs(measured.zero_loads - simulated.zero_loads) <= self._load_tolerance
        if np.count_nonzero(same) == len(same):
            self._bridges.clear()
            self.zeros_agree = True
            return _difference(measured, simulated)
        bridged = self._bridged(measured, simulated, np.flatnonzero(~same))
        rows = np.flatnonzero(same)
        direct = _difference(measured.pick(rows), simulated.pick(rows))
        self.counters.zero_differs += len(same) - len(rows) - len(bridged)
        self.zeros_agree = bool(same[-1]) or bool(
            len(bridged) and bridged.stamps[-1] == measured.stamps[-1])
        both = batches.join([batch for batch in (direct, bridged) if len(batch)])
        return both.pick(np.argsort(both.stamps, kind='stable'))

    def _bridged(self, measured: Displacements, simulated: Displacements, rows: np.ndarray,
                 ) -> Displacements:
        """Residuals of those `rows` whose two zeros could be brought together."""
        zeros = np.stack([measured.zero_stamps[rows], simulated.zero_stamps[rows]])
        found = []
        for pair in np.unique(zeros, axis=1).T.tolist():
            mine = rows[(zeros == np.array(pair)[:, None]).all(axis=0)]
            self._bridges = {key: value for key, value in self._bridges.items()
                             if key == tuple(pair)}
            newer = measured if pair[0] > pair[1] else simulated
            bridge = self._bridges.setdefault(
                tuple(pair), _Bridge(max(pair), float(newer.zero_durations[mine[0]])))
            found.append(bridge.across(measured.pick(mine), simulated.pick(mine)))
        return batches.join([batch for batch in found if len(batch)])


class _Bridge:
    """From the older of two zeros to the newer one, by what the older side did meanwhile.

    A node that was started again has zeroed anew; its partner has not, but has gone on. The mean
    of the partner's displacement over the samples of the new zero is what it would have zeroed by;
    displacements add up, so subtracting it puts both on the new zero.
    """

    def __init__(self, newer: int, duration: float) -> None:
        self._newer = newer
        self._until = newer + (round(duration * SECOND) or round(WINDOW_SECONDS * SECOND) - 1)
        self._total = np.zeros(4)
        self._count = 0

    def across(self, measured: Displacements, simulated: Displacements) -> Displacements:
        """Measured minus simulated, both from the newer zero; empty until its window is over."""
        measured_is_older = int(measured.zero_stamps[0]) < self._newer
        older, newer = (measured, simulated) if measured_is_older else (simulated, measured)
        inside = (older.stamps >= self._newer) & (older.stamps <= self._until)
        self._total += older.channels[:, inside].sum(axis=1)
        self._count += int(inside.sum())
        after = np.flatnonzero(older.stamps > self._until)
        if self._count < MIN_SAMPLES or not len(after):
            return batches.no_displacements()
        result = _difference(measured.pick(after), simulated.pick(after))
        offset = (self._total / self._count)[:, None]
        channels = result.channels - offset if measured_is_older else result.channels + offset
        zero = newer.pick(after)
        return Displacements(result.stamps, channels, zero.zero_stamps, zero.zero_loads,
                             result.elevations, result.validity, zero.zero_durations)


def _difference(measured: Displacements, simulated: Displacements) -> Displacements:
    return Displacements(measured.stamps, measured.channels - simulated.channels,
                         measured.zero_stamps, measured.zero_loads, simulated.elevations,
                         measured.validity | simulated.validity, measured.zero_durations)


def residual_stretches(
    rig: Rig, run: Record, parameters: ParameterSet, notes: list[str],
    on_progress: Callable[[float], None],
) -> tuple[Iterator[Displacements], ZeroReading]:
    """The residuals of a run in stretches, as the node gives them, and the zero of the probes.

    Notes on the simulation are appended to `notes`, the last of them after the last sample.
    """
    zero = zero_of_run(rig, run)
    stretches, _ = simulated_stretches(rig, run, parameters, notes, on_progress)
    stream = ResidualStream(rig.full_scale_load)

    def residuals() -> Iterator[Displacements]:
        row = 0
        for simulated in stretches:
            if not len(simulated):
                continue
            end = int(np.searchsorted(run.stamps, simulated.stamps[-1], 'right'))
            yield stream.push(measured_rows(rig, run, zero, slice(row, end)), simulated)
            row = end

    return residuals(), zero.reading
