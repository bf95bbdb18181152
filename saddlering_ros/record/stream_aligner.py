"""Alignment of the probes on the load's stamps, sample by sample, for live streams.

The rule is that of `saddlering_ros.record.alignment`, evaluated on the same numbers with the same
floating-point expressions.
"""

from __future__ import annotations

from bisect import bisect_left
from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass, fields
from itertools import pairwise
from math import isfinite, nan
from typing import NamedTuple

from saddlering_ros.record.alignment import (
    GAP_FLOOR_NS,
    GAP_HISTORY,
    gap_limit,
    JITTER_NS,
    seconds,
)

MAX_HOLD_NS = 50_000_000
"""Largest time [ns] that a load sample is held back for an earlier one to overtake it."""

NEVER = 2**63 - 1
"""A silence [ns] that no probe reaches: the rows wait for all probes."""

PROBES = 4
"""Number of channels of the ring's rig; an aligner can have more."""


def longer_hold(hold: int, delay: int) -> int:
    """Time [ns] that samples are held back after one that came `delay` [ns] too late.

    It is twice the delay, so that the next late samples are in time.
    """
    return min(max(hold, 2 * delay), MAX_HOLD_NS)


class AlignedRow(NamedTuple):
    """One load sample and the readings of the four probes at its stamp.

    `stamp` [ns]; `time` [s] since the first load stamp (after the last restart); `load` [N];
    `gaps` (4,) [m], NaN for a probe that does not read; `restart` counts how often the load's
    stamps jumped back before this row.
    """

    stamp: int
    time: float
    load: float
    gaps: tuple[float, ...]
    restart: int


@dataclass
class AlignmentCounters:
    """Counts of unused samples since the start, by reason; all zero on a healthy stream.

    before_probes: load stamps older than a probe's first sample
    in_gap:        load stamps inside a gap of a probe
    timed_out:     load stamps given up since a probe fell silent (or more waited than allowed)
    late_loads:    load samples that came after a row with a later stamp had gone out
    duplicates:    samples with a stamp already taken, load and probes together
    reordered:     samples that came late, and still in time to be put in order
    degraded:      rows that went out without the reading of a probe that does not read
    not_finite:    NaN or infinite samples
    overflow:      probe samples thrown away since no load came for them
    load_jumps:    times the load's stamps jumped back (each one restarts the aligner)
    probe_jumps:   times a probe's stamps jumped back
    """

    before_probes: int = 0
    in_gap: int = 0
    timed_out: int = 0
    late_loads: int = 0
    duplicates: int = 0
    reordered: int = 0
    degraded: int = 0
    not_finite: int = 0
    overflow: int = 0
    load_jumps: int = 0
    probe_jumps: int = 0

    @property
    def dropped(self) -> int:
        """Number of load stamps without a row."""
        return self.before_probes + self.in_gap + self.timed_out + self.late_loads

    def as_dict(self) -> dict[str, int]:
        """Every counter by name, for diagnostics."""
        return {field.name: getattr(self, field.name) for field in fields(self)}


_WAIT = 0
_SERVED = 1
_BEFORE = 2
_GAP = 3
_ABSENT = 4


class _ProbeBuffer:
    """The recent samples of one probe, in stamp order, and the place the load has reached."""

    __slots__ = ('counters', 'cursor', 'dead_after', 'jumped', 'limit', 'newest', 'stamps',
                 'value', 'values')

    def __init__(self, counters: AlignmentCounters, limit: int, dead_after: int) -> None:
        self.counters = counters
        self.limit = limit
        self.dead_after = dead_after
        self.stamps: list[int] = []
        self.values: list[float] = []
        self.cursor = 0
        self.newest: int | None = None
        self.jumped = False
        self.value = nan

    def clear(self) -> None:
        self.stamps.clear()
        self.values.clear()
        self.cursor = 0

    def push(self, stamp: int, value: float) -> None:
        newest = self.newest
        if newest is None or stamp > newest:
            self.newest = stamp
            self.stamps.append(stamp)
            self.values.append(value)
            if len(self.stamps) > self.limit:
                self._overflow()
        elif newest - stamp > JITTER_NS:
            self.counters.probe_jumps += 1
            self.jumped = True
            self.clear()
            self.newest = stamp
            self.stamps.append(stamp)
            self.values.append(value)
        else:
            self._insert(stamp, value)

    def _insert(self, stamp: int, value: float) -> None:
        place = bisect_left(self.stamps, stamp)
        if place < len(self.stamps) and self.stamps[place] == stamp:
            self.counters.duplicates += 1
            return
        self.counters.reordered += 1
        self.stamps.insert(place, stamp)
        self.values.insert(place, value)
        if place <= self.cursor and len(self.stamps) > 1:
            self.cursor += 1

    def _overflow(self) -> None:
        surplus = len(self.stamps) // 2
        self.counters.overflow += max(0, surplus - self.cursor)
        self._forget(surplus)

    def _forget(self, count: int) -> None:
        del self.stamps[:count]
        del self.values[:count]
        self.cursor = max(0, self.cursor - count)

    def serve(self, stamp: int, run_start: int, newest: int) -> int:
        """Put the reading at `stamp` into `value`, or return the reason why there is none (yet).

        run_start, newest: stamps of the load [ns] between which it has gone on without a leap; a
        probe that has been silent for more than `dead_after` of them is absent.
        """
        stamps, index = self.stamps, self.cursor
        last = len(stamps) - 1
        if last < 0:
            return _ABSENT if newest - run_start > self.dead_after else _WAIT
        while index < last and stamps[index + 1] <= stamp:
            index += 1
        while index > 0 and stamps[index] > stamp:
            index -= 1
        self.cursor = index
        before = stamps[index]
        if before == stamp:
            self.value = self.values[index]
            return _SERVED
        if before > stamp:
            return _ABSENT if before - run_start > self.dead_after else _BEFORE
        if index == last:
            silent = newest - max(before, run_start)
            is_dead = silent > self.dead_after and silent > gap_limit(self._history())
            return _ABSENT if is_dead else _WAIT
        interval = stamps[index + 1] - before
        if interval > GAP_FLOOR_NS and interval > gap_limit(self._history()):
            went_on = stamps[index + 1] - max(before, run_start)
            return _ABSENT if went_on > self.dead_after else _GAP
        low = self.values[index]
        weight = float(stamp - before) / float(interval)
        self.value = low + (self.values[index + 1] - low) * weight
        return _SERVED

    def _history(self) -> list[int]:
        recent = self.stamps[max(0, self.cursor - GAP_HISTORY):self.cursor + 1]
        return [later - earlier for earlier, later in pairwise(recent)]

    def trim(self) -> None:
        """Discard samples that neither a later load stamp nor the gap rule can need."""
        if self.cursor > 256:
            self._forget(self.cursor - 2 * GAP_HISTORY)


class StreamAligner:
    """Rows aligned on the load's stamps from samples pushed one by one, in any interleaving.

    A row comes out as soon as all four probes can say what they read at its load stamp, in the
    order of the stamps. Load samples that overtake each other inside a batch are put in order.
    Once one has come too late, load samples are held back for twice its delay (at most
    MAX_HOLD_NS), so that the next late ones are in time; `release` gives out those held. Load
    stamps that can never be served are dropped and counted (`counters`). Load
    stamps that jump back (by more than `JITTER_NS`) restart the aligner: what waits is
    dropped, time counts from the new first stamp, and `restarts` goes up, which the
    rows carry, so that a consumer can zero anew. Stamps that jump ahead need no restart: the gap
    rule keeps anything from being interpolated across.

    A probe that has been silent for more than `dead_after` [ns] of the load's stamps does not
    read: rows go out without it (NaN). In a batch, push the probes before the load.

    Memory is bounded: at most `max_pending` load samples spanning at most `max_wait` [s] wait for
    probes, and at most `max_samples` samples of each probe wait for the load.
    """

    def __init__(
        self, *, channels: int = PROBES, dead_after: int = NEVER, max_wait: float = 5.0,
        max_pending: int = 50_000, max_samples: int = 50_000,
    ) -> None:
        self.counters = AlignmentCounters()
        self.restarts = 0
        self._max_wait = round(max_wait * 1e9)
        self._dead_after = dead_after
        self._run_start = 0
        self._max_pending = max_pending
        self._probes = [_ProbeBuffer(self.counters, max_samples, dead_after)
                        for _ in range(channels)]
        self._pending: deque[tuple[int, float]] = deque()
        self._epoch: int | None = None
        self._newest: int | None = None
        self._last_out: int | None = None
        self._hold = 0
        self._released = 0

    @property
    def epoch(self) -> int | None:
        """The load stamp [ns] from which the rows' time counts; None before the first one."""
        return self._epoch

    @property
    def pending(self) -> int:
        """Load samples that wait for probes."""
        return len(self._pending)

    @property
    def missing(self) -> list[int]:
        """Probes (0 is the first) that the first waiting load sample needs a sample of."""
        if not self._pending:
            return []
        stamp = self._pending[0][0]
        return [place for place, probe in enumerate(self._probes)
                if probe.newest is None or probe.newest < stamp]

    @property
    def holds(self) -> bool:
        """Whether a load sample is held back in case an earlier one still comes."""
        return bool(self._pending) and self._pending[-1][0] > self._due_until()

    def push_loads(self, stamps: Sequence[int], loads: Sequence[float]) -> list[AlignedRow]:
        """Take a batch of load samples (ns, N); return the rows that became complete."""
        rows: list[AlignedRow] = []
        for stamp, load in zip(stamps, loads, strict=True):
            if not isfinite(load):
                self.counters.not_finite += 1
            elif self._newest is not None and self._newest - stamp > JITTER_NS:
                rows += self.release()
                self._restart(stamp)
                self._pending.append((stamp, load))
            else:
                self._take_load(stamp, load)
        return rows + self._drain()

    def _take_load(self, stamp: int, load: float) -> None:
        if self._newest is None:
            self._epoch = self._newest = stamp
        elif stamp <= self._newest:
            self._insert_load(stamp, load)
            return
        self._newest = stamp
        self._pending.append((stamp, load))

    def release(self) -> list[AlignedRow]:
        """Release all load samples that are held back; return the rows that became complete."""
        self._released = self._newest or 0
        return self._drain()

    def _due_until(self) -> int:
        """Largest load stamp [ns] that is not held back."""
        return max((self._newest or 0) - self._hold, self._released)

    def push_gap(self, probe: int, stamp: int, gap: float) -> list[AlignedRow]:
        """Take a sample (ns, m) of a probe (0 is the first); return the rows now complete."""
        if not isfinite(gap):
            self.counters.not_finite += 1
            return []
        self._probes[probe].push(stamp, gap)
        return self._drain()

    def flush(self) -> int:
        """Give up the load samples that still wait (the stream has ended); return how many."""
        waiting = len(self._pending)
        self.counters.timed_out += waiting
        self._pending.clear()
        return waiting

    def reset(self) -> None:
        """Drop all samples and begin anew, as after a jump; the counters continue."""
        self.restarts += 1
        self._pending.clear()
        for probe in self._probes:
            probe.clear()
            probe.newest = None
            probe.jumped = False
        self._epoch = self._newest = self._last_out = None
        self._released = 0

    def _restart(self, stamp: int) -> None:
        self.counters.load_jumps += 1
        self.restarts += 1
        self.counters.timed_out += len(self._pending)
        self._pending.clear()
        for probe in self._probes:
            if not probe.jumped:
                probe.clear()  # Its samples are from the time before the jump.
            probe.jumped = False
        self._epoch = self._newest = stamp
        self._last_out = None
        self._released = 0

    def _insert_load(self, stamp: int, load: float) -> None:
        if self._last_out is not None and stamp <= self._last_out:
            self.counters.late_loads += 1
            if stamp < self._last_out:
                assert self._newest is not None
                self._hold = longer_hold(self._hold, self._newest - stamp)
            return
        place = bisect_left(self._pending, (stamp,))
        if place < len(self._pending) and self._pending[place][0] == stamp:
            self.counters.duplicates += 1
            return
        self.counters.reordered += 1
        self._pending.insert(place, (stamp, load))

    def _drain(self) -> list[AlignedRow]:
        rows: list[AlignedRow] = []
        pending = self._pending
        due_until = self._due_until()
        while pending and pending[0][0] <= due_until:
            stamp, load = pending[0]
            if self._last_out is None or stamp - self._last_out > self._dead_after:
                self._run_start = stamp
            outcome = self._serve(stamp)
            if outcome == _WAIT:
                if not self._overdue(stamp):
                    break
                self.counters.timed_out += 1
            elif outcome == _BEFORE:
                self.counters.before_probes += 1
            elif outcome == _GAP:
                self.counters.in_gap += 1
            else:
                self.counters.degraded += outcome == _ABSENT
                rows.append(self._row(stamp, load))
            pending.popleft()
            self._last_out = stamp
        return rows

    def _serve(self, stamp: int) -> int:
        assert self._newest is not None
        outcomes = set()
        for probe in self._probes:
            outcome = probe.serve(stamp, self._run_start, self._newest)
            if outcome == _ABSENT:
                probe.value = nan
            outcomes.add(outcome)
        for outcome in (_BEFORE, _GAP, _WAIT, _ABSENT):
            if outcome in outcomes:
                return outcome
        return _SERVED

    def _overdue(self, stamp: int) -> bool:
        newest = self._newest
        assert newest is not None
        return newest - stamp > self._max_wait or len(self._pending) > self._max_pending

    def _row(self, stamp: int, load: float) -> AlignedRow:
        assert self._epoch is not None
        gaps = tuple(probe.value for probe in self._probes)
        for probe in self._probes:
            probe.trim()
            probe.jumped = False
        return AlignedRow(stamp, seconds(stamp, self._epoch), load, gaps, self.restarts)
