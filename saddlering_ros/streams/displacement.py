"""Measured ring displacement from a stream of raw samples: align, zero, convert; no ROS in it."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import replace
from math import isfinite

import numpy as np
from numpy.typing import NDArray

from saddlering_ros.bags.cdr import SECOND
from saddlering_ros.record import AlignedRow, StreamAligner
from saddlering_ros.record.alignment import DEAD_AFTER_NS
from saddlering_ros.record.guard import (
    GuardCounters,
    load_limits,
    probe_limits,
    SampleGuard,
)
from saddlering_ros.record.validity import unknown
from saddlering_ros.rig import (
    gap_increment,
    measured_displacement,
    mirrored_gap,
    Rig,
    ZeroReading,
    ZeroWindow,
)
from saddlering_ros.streams.batches import (
    ANY_TIME,
    Displacements,
    is_pause,
    join,
    no_displacements,
    Samples,
)


class DisplacementStream:
    """The displacement at each load stamp, from batches of samples in any interleaving.

    The result equals that of `displacement_of_run` for a bag, bit for bit. Rows wait until a zero
    is found; then they come out at once. Load stamps that jump back, or ahead by more than
    `max_gap` [s], restart everything, the zero included: another test has begun. A jump ahead
    inside `recording` (first and last stamp [ns]) is a pause of the same test.
    """

    def __init__(self, rig: Rig, *, max_gap: float = 10.0) -> None:
        self._rig = rig
        self._max_gap = round(max_gap * SECOND)
        self.aligner = StreamAligner(dead_after=DEAD_AFTER_NS)
        self.counters = GuardCounters()
        self._load_guard = SampleGuard(load_limits(rig), self.counters)
        self._gap_guards = [
            SampleGuard(probe_limits(rig), self.counters if number in rig.probes.present
                        else GuardCounters()) for number in (1, 2, 3, 4)]
        self._zero_duration = 0.0
        self.elevation = float('nan')
        self.recording = ANY_TIME
        self._missing = np.zeros(4, np.int64)
        self.jumps_ahead = 0
        self.rows = 0
        self.newest_stamp = 0
        self.load = float('nan')
        self._restart = 0
        self._asked_after: int | None = None
        self._begin(anywhere=False)

    def _begin(self, *, anywhere: bool) -> None:
        self.zero: ZeroReading | None = None
        self.zero_stamp = 0
        self._window = ZeroWindow(self._rig, anywhere=anywhere)
        self._waiting: list[AlignedRow] = []

    def reset(self) -> None:
        """Forget all samples and the zero."""
        self.aligner.reset()
        self.newest_stamp = 0
        self._asked_after = None
        self._begin(anywhere=False)

    def zero_after(self, stamp: int) -> None:
        """Take a new zero from the first steady stretch after `stamp` [ns], at any load."""
        self._asked_after = stamp

    def take_missing(self) -> list[int]:
        """Rows without a reading (or a zero) of each of four probes since the last call."""
        missing, self._missing = self._missing, np.zeros(4, np.int64)
        return [int(count) for count in missing]

    def events(self) -> dict[str, int]:
        """Counts of the guard and of the aligner by name; counts of both are added."""
        counts = Counter(self.counters.as_dict())
        counts.update(self.aligner.counters.as_dict())
        return {**counts, 'jumps_ahead': self.jumps_ahead}

    def push(self, load: Samples, gaps: Sequence[Samples]) -> Displacements:
        """Take a batch of the load and of each probe of the rig; return the complete rows."""
        return self._displacements(self._align(
            self._load_guard.push(load),
            [guard.push(samples) for guard, samples in zip(
                self._gap_guards, self._of_all_probes(gaps), strict=True)]))

    def _of_all_probes(self, gaps: Sequence[Samples]) -> Sequence[Samples]:
        """Samples of four probes: the absent one mirrors the one that faces it."""
        probes = self._rig.probes
        if not probes.absent:
            return gaps
        other = gaps[probes.partner_row]
        mirrored = replace(other, values=mirrored_gap(probes, other.values))
        return [*gaps[:probes.absent - 1], mirrored, *gaps[probes.absent - 1:]]

    @property
    def held(self) -> bool:
        """Whether a sample waits for the next one: it may be an outlier, or be overtaken."""
        return (self.aligner.holds or self._load_guard.holds
                or any(guard.holds for guard in self._gap_guards))

    def awaited(self, rows_before: int) -> int | None:
        """The sample that brings the next row: 0 of the load, n of the n-th probe of the rig.

        rows_before: `rows` before the last batch. None: the same as before the last batch.
        """
        probes = self._rig.probes
        missing = [probe + 1 for probe in self.aligner.missing if probe + 1 != probes.absent]
        if missing:
            return 1 + probes.present.index(missing[-1])
        return 0 if self.aligner.pending or self.rows == rows_before else None

    def flush(self) -> Displacements:
        """Take the held samples after a time without data."""
        rows = self._align(self._load_guard.flush(),
                           [guard.flush() for guard in self._gap_guards])
        return self._displacements(rows + self.aligner.release())

    def _align(self, load: Samples, gaps: Sequence[Samples]) -> list[AlignedRow]:
        rows: list[AlignedRow] = []
        push_gap = self.aligner.push_gap
        for probe, samples in enumerate(gaps):
            for stamp, value in zip(samples.stamps.tolist(), samples.values.tolist(),
                                    strict=True):
                rows += push_gap(probe, stamp, value)
        return rows + self.aligner.push_loads(load.stamps.tolist(), load.values.tolist())

    def _displacements(self, rows: list[AlignedRow]) -> Displacements:
        if not rows:
            return no_displacements()
        self.rows += len(rows)
        batches: list[Displacements] = []
        ready: list[AlignedRow] = []
        for row in rows:
            if not _is_of_use(row):
                continue
            if self._breaks(row):
                batches += self._convert(ready)
                ready = []
            self.newest_stamp = row.stamp
            if self.zero is not None:
                ready.append(row)
            else:
                ready += self._wait(row)
        self.load = rows[-1].load
        return join(batches + self._convert(ready))

    def _breaks(self, row: AlignedRow) -> bool:
        """Whether a new zero is to be found from `row` on; if so, begin to look for it."""
        newest = self.newest_stamp
        ahead = (newest and row.stamp - newest > self._max_gap
                 and not is_pause(self.recording, newest, row.stamp))
        if row.restart != self._restart or ahead:
            self.jumps_ahead += bool(ahead)
            self._restart = row.restart
            self._begin(anywhere=False)
            return True
        if self._asked_after is not None and row.stamp > self._asked_after:
            self._asked_after = None
            self._begin(anywhere=True)
            return True
        return False

    def _wait(self, row: AlignedRow) -> list[AlignedRow]:
        """Offer `row` to the zero window; every row that waited, once a zero is found."""
        self._waiting.append(row)
        reading = self._window.push(row.time, row.load, row.gaps)
        if reading is None:
            keep = self._window.samples
            del self._waiting[:max(0, len(self._waiting) - keep)]
            return []
        due = self._waiting[-(reading.end - reading.start) - 1:]
        self.zero, self.zero_stamp, self._waiting = reading, due[0].stamp, []
        self._zero_duration = (due[-2].stamp - due[0].stamp) / SECOND
        return due

    def _convert(self, rows: list[AlignedRow]) -> list[Displacements]:
        if not rows or self.zero is None:
            return []
        gaps = np.array([row.gaps for row in rows]).T
        increments = gap_increment(self._rig.probes, gaps, np.array(self.zero.gaps))
        found = measured_displacement(self._rig.probes, increments)
        channels = np.stack([found.delta_x, found.delta_y, found.gamma, found.parity])
        if not np.isfinite(channels).all():
            self._missing += np.isnan(gaps).sum(axis=1)
            known = np.isfinite(channels[:3]).any(axis=0)
            rows = [row for row, is_known in zip(rows, known.tolist(), strict=True) if is_known]
            channels = np.ascontiguousarray(channels[:, known])
        stamps = np.array([row.stamp for row in rows], dtype=np.int64)
        return [Displacements(
            stamps, channels,
            np.full(len(rows), self.zero_stamp, dtype=np.int64),
            np.full(len(rows), self.zero.load), np.full(len(rows), self.elevation),
            validity=self._bridged(stamps) | unknown(channels),
            zero_durations=np.full(len(rows), self._zero_duration))]

    def _bridged(self, stamps: NDArray[np.int64]) -> NDArray[np.uint8]:
        """The mark of rows that were interpolated across a reading that was refused."""
        marks = np.zeros(len(stamps), np.uint8)
        for guard in self._gap_guards:
            if guard.bridges:
                marks |= guard.marks(stamps)
        return marks


def _is_of_use(row: AlignedRow) -> bool:
    """Whether both radial or both axial probes read."""
    first, second, third, fourth = row.gaps
    return isfinite(first + third) or isfinite(second + fourth)
