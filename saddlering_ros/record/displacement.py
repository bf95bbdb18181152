"""The measured displacement of the ring: guard, align, zero, convert; of streams and of records.

`DisplacementStream` takes batches of samples. A record is guarded and aligned when it is read; its
zero and its displacement come from the same `ZeroWindow` and `displacements`.
"""

from collections import Counter, deque
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np

from saddlering_ros.errors import BagError
from saddlering_ros.record import batches
from saddlering_ros.record.aligner import Aligner
from saddlering_ros.record.batches import AlignedRows, Bits, Displacements, Floats, Mask, Samples
from saddlering_ros.record.guard import load_limits, probe_limits, SampleGuard
from saddlering_ros.record.record import Record
from saddlering_ros.record.scratch import blocks
from saddlering_ros.rig import geometry, Rig

UNHEARD_AFTER = 0.15
"""Time [s] for which a node must have received no sound reading of a probe before the stamps of
the others count as its silence. A publisher that had no processor sends what was due in one burst,
and may be interrupted between two probes: the stamps of one are then far ahead of the other's."""

LONGEST_LOOK = 0.05
"""Longest time [s] between two batches that counts: the node itself may have had no processor."""

MIN_ROWS = 32  # variance to 25 %
MAX_ROWS = 256
"""Rows after a zero from which its noise is read."""


@dataclass(frozen=True)
class Zero:
    """What displacements count from."""

    reading: geometry.ZeroReading
    stamp: int  # the first of its samples [ns]
    last_stamp: int  # the last of them [ns]
    closed: int  # [ns] closed its window: earlier rows are not published in a short silence


def a_pair_reads(gaps: Floats) -> Mask:
    """Mask (N,) of rows of gaps (4, N) at which both radial or both axial probes read."""
    reads = np.isfinite(gaps)
    return np.asarray((reads[0] & reads[2]) | (reads[1] & reads[3]))


def displacements(
    rig: Rig, zero: Zero, stamps: batches.Stamps, gaps: Floats, marks: Bits | None = None,
    elevation: float = float('nan'),
) -> Displacements:
    """The displacement at stamps (N,) from gaps (4, N); rows without any motion are left out.

    marks (N,): bits of validity beside those of channels that are not known.
    """
    increments = geometry.gap_increment(rig.probes, gaps, np.array(zero.reading.gaps))
    channels = geometry.measured_displacement(rig.probes, increments).channels
    validity = batches.unknown(channels)
    if marks is not None:
        validity |= marks
    batch = Displacements.from_zero(stamps, channels, (zero.stamp, zero.last_stamp),
                                    zero.reading.load, elevation, validity)
    return batch.pick(batches.is_published(validity)) if validity.any() else batch


@dataclass(frozen=True)
class MeasuredRun:
    """Displacement by the probes of a run, at each of its N load stamps."""

    time: Floats  # (N,) [s], the run's own
    load: Floats  # (N,) [N], the run's own
    d: Floats  # (4, N) [m]: increments of the probes since zero
    displacement: geometry.Displacement  # arrays (N,), NaN where not known
    zero: geometry.ZeroReading  # its start and end count load samples
    complete: Mask  # (N,): all four probes have a reading and a zero


def displacement_of_run(rig: Rig, run: Record) -> MeasuredRun:
    """Zero the probes of `run` and compute the ring's displacement from them."""
    zero = zero_of_run(rig, run).reading
    rows = np.flatnonzero(run.given)
    zero = replace(zero, start=int(rows[zero.start]), end=int(rows[zero.end - 1]) + 1)
    increments = geometry.gap_increment(rig.probes, run.gaps, np.array(zero.gaps))
    return MeasuredRun(
        time=run.time, load=run.load, d=increments, zero=zero,
        displacement=geometry.measured_displacement(rig.probes, increments),
        complete=np.asarray(np.isfinite(increments).all(axis=0)))


def zero_of_run(rig: Rig, run: Record) -> Zero:
    """The zero of a run; its start and end count the rows that the live node gives."""
    given = run.given
    if not given.any():
        raise BagError(f'{run.path}: the four probes never read together: record them together')

    def given_blocks() -> Iterator[geometry.Samples]:
        for block in blocks(len(given), run.time, run.load, run.gaps, size=geometry.BLOCK):
            rows = given[block]
            yield run.time[block][rows], run.load[block][rows], run.gaps[:, block][:, rows]

    reading = geometry.zero_of_blocks(rig, given_blocks)
    return Zero(reading, *(int(run.stamps[_given_row(given, number)])
                           for number in (reading.start, reading.end - 1, reading.end)))


def _given_row(given: Mask, number: int) -> int:
    """Index of the row that `number` others of a mask (N,) precede; the last one, if too few."""
    for block in blocks(len(given), given):
        count = int(np.count_nonzero(given[block]))
        if number < count:
            return block.start + int(np.flatnonzero(given[block])[number])
        number -= count
    return len(given) - 1


def measured_rows(rig: Rig, run: Record, zero: Zero, stretch: slice) -> Displacements:
    """Displacements at the rows of a stretch of a run that the live node gives."""
    rows = run.given[stretch]
    if run.published is not None:  # During a short silence of a probe, but not in the zero.
        rows = rows | (run.published[stretch] & (run.stamps[stretch] >= zero.closed))
    marks = None if run.probe_marks is None else run.probe_marks[stretch][rows]
    return displacements(rig, zero, run.stamps[stretch][rows], run.gaps[:, stretch][:, rows],
                         marks, run.elevation)


def measured_stretches(
    rig: Rig, run: Record, notes: list[str],
    on_progress: Callable[[float], None] = lambda share: None,
) -> tuple[Iterator[Displacements], geometry.ZeroReading]:
    """The same stretch by stretch, so that a long run is never in memory as a whole; its zero.

    A note on a zero that is not at the preload is appended to `notes`.
    """
    zero = zero_of_run(rig, run)
    if not zero.reading.near_preload:
        notes.append(batches.ZERO_ELSEWHERE)

    def stretches() -> Iterator[Displacements]:
        for block in blocks(len(run.time), run.stamps, run.time, run.load, run.gaps):
            yield measured_rows(rig, run, zero, block)
            on_progress(block.stop / len(run.time))

    return stretches(), zero.reading


class DisplacementStream:
    """The displacement at each load stamp, from batches of samples in any interleaving.

    The result equals that of `measured_rows` for a bag, bit for bit. Rows wait for the zero and
    then come out together. Load stamps that jump back, or ahead by more than `max_gap` [s], begin
    another test with a zero of its own. A jump ahead inside `recording` (first and last stamp
    [ns]) is a pause of the same test.
    """

    def __init__(self, rig: Rig, *, max_gap: float = 10.0) -> None:
        self._rig = rig
        self._max_gap = round(max_gap * batches.SECOND)
        self.aligner = Aligner(dead_after=batches.DEAD_AFTER_NS)
        self._load_guard = SampleGuard(load_limits(rig))
        self._gap_guards = [SampleGuard(probe_limits(rig)) for _ in range(4)]
        self.elevation = float('nan')
        self.recording = batches.ANY_TIME
        self._missing, self._has_read = np.zeros((2, 4), np.int64), False  # without, with a pair
        self.jumps_ahead = 0
        self.rows = 0
        self.newest_stamp = 0
        self.load, self.aligned = float('nan'), list[AlignedRows]()
        self._restart = 0
        self._heard = 0.0
        self._unheard = np.zeros(4)
        self._asked_after: int | None = None
        self._begin(anywhere=False)

    def _begin(self, *, anywhere: bool) -> None:
        self.zero: Zero | None = None
        self._window = geometry.ZeroWindow(self._rig, anywhere=anywhere)
        self._waiting: deque[AlignedRows] = deque()
        self._offered = self._kept = 0

    def zero_after(self, stamp: int) -> None:
        """Take a new zero from the first steady stretch after `stamp` [ns], at any load."""
        self._asked_after = stamp

    def take_missing(self) -> list[int]:
        """Rows without each probe since the last call, of those with a pair if there were any."""
        missing = self._missing[int(self._has_read)].tolist()
        self._missing, self._has_read = np.zeros((2, 4), np.int64), False
        return missing

    def guards(self) -> list[SampleGuard]:
        """Those of the load and of the probes of the rig."""
        return [self._load_guard, *(self._gap_guards[number - 1]
                                    for number in self._rig.probes.present)]

    def events(self) -> dict[str, int]:
        """Counts of the guards and of the aligner by name; counts of all are added."""
        counts = Counter[str]()
        for counters in (*(guard.counters for guard in self.guards()), self.aligner.counters):
            counts.update(vars(counters))
        return {**counts, 'jumps_ahead': self.jumps_ahead}

    def push(
        self, load: Samples, gaps: Sequence[Samples], now: float | None = None,
    ) -> Displacements:
        """Take a batch of the load and of each probe of the rig; return the complete rows.

        now: when it came, by a clock that no one sets [s]; None if the stamps alone tell.
        """
        probes = self._rig.probes
        if probes.absent:  # It mirrors the one that faces it.
            other = gaps[probes.partner_row]
            mirrored = replace(other, values=geometry.mirrored_gap(probes, other.values))
            gaps = [*gaps[:probes.absent - 1], mirrored, *gaps[probes.absent - 1:]]
        gaps = [guard.push(samples) for guard, samples in zip(self._gap_guards, gaps, strict=True)]
        if now is not None:
            waited = self._unheard + min(now - self._heard, LONGEST_LOOK)
            self._unheard, self._heard = np.where([len(one) for one in gaps], 0.0, waited), now
        is_silent = self._unheard >= UNHEARD_AFTER if now is not None else np.full(4, True)
        self.aligner.hurries = (is_silent & (self.zero is not None)).tolist()
        return self._displacements(self.aligner.push(self._load_guard.push(load), gaps))

    def flush(self) -> Displacements:
        """Take the held samples after a time without data, and rows without a silent probe."""
        self.aligner.hurries = [self.zero is not None] * 4
        rows = self.aligner.push(self._load_guard.flush(),
                                 [guard.flush() for guard in self._gap_guards])
        return self._displacements(rows + self.aligner.release())

    @property
    def held(self) -> bool:
        """Whether a sample waits for another: an outlier, one overtaken, one without a probe."""
        return (self.aligner.pending > 0 or self._load_guard.holds
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

    def _displacements(self, aligned: list[AlignedRows]) -> Displacements:
        measured, self.aligned = [], aligned
        for batch in aligned:
            rows = batch if batch.given.all() else batch.pick(batch.published)
            if not len(rows):
                continue
            self.rows += len(rows)
            self.load = float(rows.loads[-1])
            is_missing = np.isnan(rows.gaps)
            if np.count_nonzero(is_missing):
                reads = a_pair_reads(rows.gaps)
                self._missing += [is_missing[:, some].sum(axis=1) for some in (~reads, reads)]
                rows = rows.pick(reads)
            self._has_read |= len(rows) > 0
            for stretch in self._of_one_zero(rows) if len(rows) else ():
                measured.append(self._measured(stretch))
        return batches.join(measured)

    def _of_one_zero(self, rows: AlignedRows) -> Iterator[AlignedRows]:
        """The rows in parts, before each of which the search for a new zero begins if it must."""
        before = np.append(self.newest_stamp or rows.stamps[0], rows.stamps[:-1])
        leaps = np.flatnonzero(rows.stamps - before > self._max_gap).tolist()
        begins = {row: False for row in leaps if not batches.is_pause(
            self.recording, int(before[row]), int(rows.stamps[row]))}
        self.jumps_ahead += len(begins)
        if rows.restart != self._restart:
            self._restart = rows.restart
            begins[0] = False
        if begins:
            self._asked_after = None  # It was asked of the test before.
        elif self._asked_after is not None and rows.stamps[-1] > self._asked_after:
            begins[int(rows.stamps.searchsorted(self._asked_after, 'right'))] = True
            self._asked_after = None
        for start, stop in pairwise([*sorted({0, *begins}), len(rows)]):
            if start in begins:
                self._begin(anywhere=begins[start])
            self.newest_stamp = int(rows.stamps[stop - 1])
            yield rows.pick(slice(start, stop))

    def _measured(self, rows: AlignedRows) -> Displacements:
        if self.zero is None:
            rows = self._after_zero(rows)
        if self.zero is None:
            return batches.no_displacements()
        marks = None
        for guard in self._gap_guards:
            if guard.bridges:
                bridged = guard.marks(rows.stamps)
                marks = bridged if marks is None else marks | bridged
        return displacements(self._rig, self.zero, rows.stamps, rows.gaps, marks, self.elevation)

    def _after_zero(self, rows: AlignedRows) -> AlignedRows:
        """Offer rows to the zero window; return all rows from the zero on once there is one."""
        offered = rows if rows.given.all() else rows.pick(rows.given)
        reading = self._window.push_batch(offered.time, offered.loads, offered.gaps)
        self._waiting.append(offered)
        if reading is None:
            self._offered += len(offered)
            self._kept += len(offered)
            while self._waiting and self._kept - len(self._waiting[0]) >= self._window.samples:
                self._kept -= len(self._waiting.popleft())
            return rows
        waiting = AlignedRows.join(self._waiting)
        self._waiting.clear()
        # The window counts every row that it was offered.
        first = len(waiting) - len(offered) + reading.start - self._offered
        stop = first + reading.end - reading.start
        self.zero = Zero(reading, *waiting.stamps[[first, stop - 1, stop]].tolist())
        return AlignedRows.join([waiting.pick(slice(first, stop)),
                                 rows.pick(rows.stamps >= self.zero.closed)])


class ZeroNoise:
    """Covariance (4, 4) of the noise of delta_x, delta_y, gamma, parity, read after each zero.

    Second differences of white noise have six times its variance; a moving load hardly adds to
    them. 0 where a channel is not known.
    """

    def __init__(self) -> None:
        self.covariance = np.zeros((4, 4))
        self._zero = 0
        self._rows: list[Floats] = []
        self._count = 0

    def push(self, zero_stamps: batches.Stamps, channels: Floats) -> None:
        """Take displacements: stamps of their zeros (N,) [ns], channels (4, N)."""
        if not len(zero_stamps):
            return
        if int(zero_stamps[-1]) != self._zero:
            self._zero, self._rows, self._count = int(zero_stamps[-1]), [], 0
        if self._count >= MAX_ROWS:
            return
        self._rows.append(channels[:, zero_stamps == self._zero])
        self._count += self._rows[-1].shape[1]
        if self._count < MIN_ROWS:
            return
        rows = np.concatenate(self._rows, axis=1)
        is_known = np.isfinite(rows).all(axis=1, keepdims=True)
        curves = np.diff(np.where(is_known, rows, 0.0), n=2, axis=1)
        self.covariance = curves @ curves.T / (6.0 * curves.shape[1])
