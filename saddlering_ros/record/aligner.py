"""Alignment of the probes on the load's stamps: one class with a carry, for streams and records.

A stream in batches of any size (`Aligner`) and a whole record, which is one batch
(`aligned_record`), give the same bits.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import zip_longest
import math

import numpy as np
from numpy.typing import NDArray

from saddlering_ros.record import batches
from saddlering_ros.record.batches import AlignedRows, Floats, Mask, Samples, Stamps
from saddlering_ros.record.scratch import blocks, scratch_array

NEVER = 2**63 - 1
"""A silence [ns] that no probe reaches: the rows wait for all probes."""

STEPS_MISSED = 2
"""A probe whose samples come by blocks is silent when it has missed so many blocks."""

STEP_MEMORY = 0.95
"""Share of the length of the longest recent block that counts at the next batch."""

KEPT = 256
"""Samples of a probe that are kept before those that no later stamp needs are discarded."""

STRETCH = 1 << 13
"""Load samples of a record that are pushed together: their arrays fit into the processor's cache,
and they are too few for threads of BLAS, which took a third of the time in which a bag is read."""

SERVED, ABSENT, SILENT, WAITS, IN_GAP, BEFORE = range(6)
"""What a probe answers at a load stamp. The largest answer of all probes decides on the row."""


@dataclass
class AlignmentCounters:
    """Counts of unused samples since the start, by reason; all zero on a healthy stream."""

    before_probes: int = 0  # load stamps older than a probe's first sample
    in_gap: int = 0  # load stamps inside a gap of a probe
    timed_out: int = 0  # load stamps given up: a probe fell silent, or more waited than allowed
    late_loads: int = 0  # load samples that came after a row with a later stamp had gone out
    duplicates: int = 0  # samples with a stamp already taken, load and probes together
    reordered: int = 0  # samples that came late, and still in time to be put in order
    degraded: int = 0  # rows that went out without the reading of a probe that does not read
    not_finite: int = 0  # NaN or infinite samples
    overflow: int = 0  # probe samples thrown away since no load came for them
    load_jumps: int = 0  # times the load's stamps jumped back (each one restarts the aligner)
    probe_jumps: int = 0  # times a probe's stamps jumped back

    @property
    def dropped(self) -> int:
        """Number of load stamps without a row."""
        return self.before_probes + self.in_gap + self.timed_out + self.late_loads


class _Waiting:
    """Samples of one topic that a later row may need, in stamp order, each stamp once."""

    def __init__(self, counters: AlignmentCounters) -> None:
        self._counters = counters
        self.clear()

    def __len__(self) -> int:
        return len(self.stamps)

    @property
    def last(self) -> int:
        """The last stamp [ns]; 0 without samples."""
        return int(self.stamps[-1]) if len(self.stamps) else 0

    def clear(self) -> None:
        """Discard all samples and the newest stamp."""
        self.stamps: Stamps = np.empty(0, np.int64)
        self.values: Floats = np.empty(0)
        self.newest: int | None = None
        self.jumped = False

    def forget(self, count: int) -> None:
        """Discard the first `count` samples."""
        self.stamps, self.values = self.stamps[count:], self.values[count:]

    def parts(self, samples: Samples) -> Iterator[tuple[bool, Stamps, Floats]]:
        """The finite samples, cut where the stamps jump back, and whether they lie behind a jump.

        Stamps jump back where one lies more than JITTER_NS behind the newest before it.
        """
        sound = np.isfinite(samples.values)
        stamps, values = samples.stamps[sound], samples.values[sound]
        self._counters.not_finite += len(samples) - len(stamps)
        newest, jumped = self.newest, False
        while len(stamps):
            behind = _newest_before(stamps, newest) - stamps > batches.JITTER_NS
            end = int(behind.argmax()) if behind.any() else len(stamps)
            if end:
                yield jumped, stamps[:end], values[:end]
            stamps, values = stamps[end:], values[end:]
            newest, jumped = None, True

    def rises_with(self, stamps: Stamps) -> bool:
        """Whether all of `stamps` rise and follow the newest stamp."""
        if self.newest is not None and stamps[0] <= self.newest:
            return False
        return len(stamps) == 1 or bool((stamps[1:] > stamps[:-1]).all())

    def append(self, stamps: Stamps, values: Floats) -> None:
        """Add samples whose stamps rise from the newest one on."""
        self.stamps = np.concatenate((self.stamps, stamps))
        self.values = np.concatenate((self.values, values))
        self.newest = int(stamps[-1])

    def take(self, stamps: Stamps, values: Floats) -> None:
        """Put samples among the others by stamp; of two with one stamp the first counts."""
        if self.rises_with(stamps):
            self.append(stamps, values)
            return
        together = np.concatenate((self.stamps, stamps))
        readings = np.concatenate((self.values, values))
        late = int(np.count_nonzero(stamps <= _newest_before(stamps, self.newest)))
        late -= self.newest is None
        self.stamps, first = np.unique(together, return_index=True)
        self.values = readings[first]
        duplicates = len(together) - len(first)
        self._counters.duplicates += duplicates
        self._counters.reordered += late - duplicates
        highest = int(stamps.max())
        self.newest = highest if self.newest is None else max(self.newest, highest)


def _newest_before(stamps: Stamps, newest: int | None) -> Stamps:
    """For each of some stamps the newest that came before it; `newest`: before all of them."""
    before = int(stamps[0]) if newest is None else newest
    return np.asarray(np.maximum.accumulate(np.append(before, stamps[:-1])))


class Aligner:
    """Rows aligned on the load's stamps from batches of samples, in any interleaving.

    A row comes out, in the order of the stamps, as soon as every probe has a reading at its load
    stamp or will have none. Load samples of a batch are put in order. After one came too late,
    load samples are held back for twice its delay (at most MAX_HOLD_NS); `release` gives them out.
    Load stamps that no probe can serve come out as rows that are not `given`, and are counted.
    Load stamps that jump back by more than `JITTER_NS` restart the aligner: waiting samples are
    dropped, time counts from the new first stamp, and the rows carry the number of `restarts`, so
    that a consumer can zero anew. Stamps that jump ahead need no restart, because no reading is
    interpolated across a gap.

    A probe that has been silent for more than `dead_after` [ns] of the load's stamps does not
    read: rows go out without it (NaN). Rows also go out without a probe of `hurries` that has
    been silent for SILENT_AFTER_NS while the load and a pair of other probes went on.

    Memory is bounded: at most `max_pending` load samples spanning at most `max_wait` [ns] wait for
    probes, and at most `max_samples` samples of each probe wait for the load.
    """

    def __init__(
        self, *, channels: int = 4, dead_after: int = NEVER, max_wait: int = 5_000_000_000,
        max_pending: int = 50_000, max_samples: int = 50_000,
    ) -> None:
        self.counters = AlignmentCounters()
        self.restarts = 0
        self._max_wait, self._dead_after = max_wait, dead_after
        self._max_pending, self._max_samples = max_pending, max_samples
        self._loads = _Waiting(self.counters)
        self._probes = [_Waiting(self.counters) for _ in range(channels)]
        self.hurries = [False] * channels
        self._longest_step = 0.0
        self._run_start = self._hold = self._released = 0
        self._epoch: int | None = None
        self._last_out: int | None = None

    @property
    def pending(self) -> int:
        """Load samples that wait for probes."""
        return len(self._loads)

    @property
    def missing(self) -> list[int]:
        """Probes (0 is the first) that the first waiting load sample needs a sample of."""
        if not self.pending:
            return []
        stamp = self._loads.stamps[0]
        return [place for place, probe in enumerate(self._probes)
                if probe.newest is None or probe.newest < stamp]

    def push(self, load: Samples, probes: Sequence[Samples]) -> list[AlignedRows]:
        """Take a batch of the load and of each probe; the rows that are ready."""
        arrived = list(zip((self._loads, *self._probes), (load, *probes), strict=True))
        if all(not len(samples) or (
                topic.rises_with(samples.stamps)
                and math.isfinite(samples.values.dot(samples.values)))
               for topic, samples in arrived):  # the usual case
            self._longest_step *= STEP_MEMORY
            for topic, samples in arrived:
                if len(samples.stamps):
                    last = topic.last
                    topic.append(samples.stamps, samples.values)
                    if last:
                        step = int(samples.stamps[-1]) - last
                        self._longest_step = max(self._longest_step, step)
            if self._epoch is None and self.pending:
                self._epoch = int(self._loads.stamps[0])
            rows = self._drain()
        else:
            rows = self._push_apart(arrived)
        # Discard samples of the probes that neither a later row nor the gap rule can need.
        for probe in self._probes:
            if len(probe) <= min(KEPT, self._max_samples):
                continue
            if self._last_out is not None:
                place = int(probe.stamps.searchsorted(self._last_out, 'right'))
                probe.forget(max(place - 1 - 2 * batches.GAP_HISTORY, 0))
            if len(probe) > self._max_samples:
                surplus = len(probe) // 2
                self.counters.overflow += surplus
                probe.forget(surplus)
        return rows

    def _push_apart(self, arrived: Sequence[tuple[_Waiting, Samples]]) -> list[AlignedRows]:
        """Push a batch in which stamps go back, or with readings that are not finite."""
        rows: list[AlignedRows] = []
        # What lies before a jump of the stamps is aligned before anything behind one.
        for parts in zip_longest(*(topic.parts(samples) for topic, samples in arrived)):
            if any(stretch and stretch[0] for stretch in parts):
                rows += self.release()
            of_load, *of_probes = parts
            for probe, stretch in zip(self._probes, of_probes, strict=True):
                if stretch is None:
                    continue
                jumped, stamps, values = stretch
                if jumped:
                    self.counters.probe_jumps += 1
                    probe.clear()
                    probe.jumped = True
                probe.take(stamps, values)
            if of_load is not None:
                jumped, stamps, values = of_load
                if jumped:  # Begin anew with what the probes sent behind the jump.
                    self.counters.load_jumps += 1
                    self.restarts += 1
                    self.counters.timed_out += self.pending
                    self._loads.clear()
                    for probe in self._probes:
                        if not probe.jumped:
                            probe.forget(len(probe))
                        probe.jumped = False
                    self._epoch = self._last_out = None
                    self._released = 0
                if self._epoch is None:
                    self._epoch = int(stamps[0])
                if self._last_out is not None and stamps.min() <= self._last_out:
                    late = stamps <= self._last_out
                    self.counters.late_loads += int(np.count_nonzero(late))
                    overtaken = np.where(stamps < self._last_out,
                                         _newest_before(stamps, self._loads.newest) - stamps, 0)
                    self._hold = batches.longer_hold(self._hold, int(overtaken.max()))
                    stamps, values = stamps[~late], values[~late]
                if len(stamps):
                    self._loads.take(stamps, values)
            rows += self._drain()
        return rows

    def release(self) -> list[AlignedRows]:
        """Release all load samples that are held back; the rows that are ready."""
        self._released = self._loads.newest or 0
        return self._drain()

    def finish(self) -> list[AlignedRows]:
        """All rows that still wait: the stream has ended."""
        self._released = self._loads.newest or 0
        return self._drain(finish=True)

    def _drain(self, *, finish: bool = False) -> list[AlignedRows]:
        """The rows up to the first that a probe may still answer (`finish`: all)."""
        due_until = max((self._loads.newest or 0) - self._hold, self._released)
        count = int(self._loads.stamps.searchsorted(due_until, 'right'))
        if not finish:
            count = min(count, self._answered())
        if not count:
            return []
        stamps = self._loads.stamps[:count]
        # For each load stamp (N,), that since which the load has gone on without a leap.
        last, dead_after = self._last_out, self._dead_after
        continues = last is not None and stamps[0] - last <= dead_after
        starts = np.full(count, self._run_start if continues else stamps[0])
        for leap in np.flatnonzero(stamps[1:] - stamps[:-1] > dead_after).tolist():
            starts[leap + 1:] = stamps[leap + 1]
        gaps = np.stack([batches.reading_at(stamps, probe.stamps, probe.values)
                         for probe in self._probes])
        missing = np.isnan(gaps)
        given = published = np.ones(count, dtype=bool)
        if np.count_nonzero(missing):
            answers = self._answers(stamps, starts, missing, finish)
            given, published, count = answers <= ABSENT, answers <= SILENT, len(answers)
        if not count:
            return []
        assert self._epoch is not None
        rows = AlignedRows(stamps[:count], (stamps[:count] - self._epoch) / 1e9,
                           self._loads.values[:count], gaps[:, :count], given, published,
                           self.restarts)
        self._loads.forget(count)
        self._last_out, self._run_start = int(stamps[count - 1]), int(starts[count - 1])
        if np.count_nonzero(published):
            for probe in self._probes:
                probe.jumped = False
        return [rows]

    def _answered(self) -> int:
        """How many waiting rows may be ready: all up to the last sample of the last probe."""
        newest = self._loads.newest
        last = [int(probe.stamps[-1]) for probe in self._probes if len(probe.stamps)]
        if newest is None or self.pending > self._max_pending or len(last) < len(self._probes):
            return self.pending
        oldest = min(last)
        patience = min(self._dead_after, self._max_wait)
        if any(self.hurries):
            patience = min(patience, batches.SILENT_AFTER_NS)
        if newest - oldest > patience:
            return self.pending
        return int(self._loads.stamps.searchsorted(oldest, 'right'))

    def _answers(
        self, stamps: Stamps, starts: Stamps, missing: Mask, finish: bool,
    ) -> NDArray[np.int64]:
        """What becomes of rows (N,) that lack readings (C, N); fewer if the rest must wait."""
        answers = np.full(len(stamps), SERVED)
        waits = np.zeros(len(stamps), dtype=bool)
        for probe, lacks, hurries in zip(self._probes, missing, self.hurries, strict=True):
            rows = np.flatnonzero(lacks)
            if len(rows):
                reasons = self._why_missing(probe, stamps[rows], starts[rows])
                answers[rows] = np.maximum(answers[rows], reasons)
                waits[rows] |= reasons == WAITS
                if not hurries:  # A later sample may show a shorter silence.
                    waits[rows] |= (reasons == SILENT) & (stamps[rows] > probe.last)
        if not finish and waits.any():
            assert self._loads.newest is not None
            is_due = self._loads.newest - stamps > self._max_wait
            is_due |= self.pending - np.arange(len(stamps)) > self._max_pending
            stops = waits & ~is_due
            if stops.any():
                answers = answers[:int(stops.argmax())]
        counts = np.bincount(answers, minlength=BEFORE + 1).tolist()
        self.counters.degraded += counts[ABSENT] + counts[SILENT]
        self.counters.timed_out += counts[WAITS]
        self.counters.in_gap += counts[IN_GAP]
        self.counters.before_probes += counts[BEFORE]
        return answers

    def _why_missing(self, probe: _Waiting, stamps: Stamps, starts: Stamps) -> NDArray[np.int64]:
        """Answers of a probe at stamps (N,) at which it has no reading."""
        assert self._loads.newest is not None
        newest, dead_after, last = self._loads.newest, self._dead_after, len(probe) - 1
        if last < 0:
            return np.where(newest - starts > dead_after, ABSENT, WAITS)
        place = probe.stamps.searchsorted(stamps, 'right') - 1
        silent_since = np.maximum(probe.stamps[np.maximum(place, 0)], starts)
        next_sample = probe.stamps[np.minimum(place + 1, last)]
        silence = next_sample - silent_since
        answers = np.where(silence > batches.SILENT_AFTER_NS, SILENT, IN_GAP)
        answers[silence > dead_after] = ABSENT
        head, tail = place < 0, place == last
        answers[head] = np.where(probe.stamps[0] - starts[head] > dead_after, ABSENT, BEFORE)
        # The stamp up to which the load and a pair of facing probes have gone on.
        pair_until = 0
        if len(self._probes) == 4:
            ends = [one.last for one in self._probes]
            pair_until = min(newest, max(min(ends[::2]), min(ends[1::2])))
        limit = batches.gap_limit(np.diff(probe.stamps[-batches.GAP_HISTORY - 1:]).tolist())
        silence = silent_since[tail]
        hurried = pair_until - silence > max(
            batches.SILENT_AFTER_NS, limit, STEPS_MISSED * self._longest_step)
        answers[tail] = np.where(hurried, SILENT, WAITS)
        answers[tail] = np.where(newest - silence > max(dead_after, limit), ABSENT, answers[tail])
        return answers


def aligned_record(load: Samples, probes: Sequence[Samples]) -> tuple[Floats, Mask, Mask]:
    """Gaps (C, N) of probes at the load's rising stamps (N,); masks: given, published."""
    aligner = Aligner(channels=len(probes), dead_after=batches.DEAD_AFTER_NS, max_wait=NEVER,
                      max_pending=NEVER, max_samples=NEVER)
    gaps: Floats = scratch_array((len(probes), len(load)), np.float64)
    given, published = (scratch_array((len(load),), np.bool_) for _ in range(2))
    taken, row = [0] * len(probes), 0
    arrays = [array for one in (load, *probes) for array in (one.stamps, one.values)]
    for block in blocks(len(load), *arrays, gaps, given, published, size=STRETCH):
        ends = [len(probe) if block.stop == len(load) else
                int(probe.stamps.searchsorted(load.stamps[block.stop], 'right'))
                for probe in probes]
        ready = aligner.push(load.pick(block), [
            probe.pick(slice(*span)) for probe, span in zip(
                probes, zip(taken, ends, strict=True), strict=True)])
        taken = ends
        for rows in ready if block.stop < len(load) else [*ready, *aligner.finish()]:
            end = row + len(rows)
            gaps[:, row:end], given[row:end] = rows.gaps, rows.given
            published[row:end] = rows.published
            row = end
    return gaps, given, published
