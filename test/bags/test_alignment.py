"""What alignment on the load's stamps promises, for records and for streams."""

from itertools import pairwise

from hypothesis import given, settings
from hypothesis import strategies as st
import numpy as np
import pytest

from saddlering_ros.record import batches as record_batches
from saddlering_ros.record.aligner import aligned_record, Aligner
from saddlering_ros.record.batches import align, AlignedRows, gap_limit, gap_mask, LEAP_NS, Samples

EPOCH = 1_700_000_000_000_000_000
MILLISECOND = 1_000_000
NOTHING = Samples(np.empty(0, np.int64), np.empty(0))


def stamps_of(intervals: list[int], start: int = EPOCH) -> np.ndarray:
    return start + np.cumsum(np.array(intervals, dtype=np.int64))


def regular(count: int, period: int = MILLISECOND, start: int = EPOCH) -> np.ndarray:
    return start + period * np.arange(count, dtype=np.int64)


def push(aligner: Aligner, channel: int, stamps, values) -> list[AlignedRows]:
    """Push samples of one topic: -1 is the load, 0 the first probe. The rows that are used."""
    batches = [NOTHING] * 5
    batches[channel + 1] = Samples(np.asarray(stamps, np.int64), np.asarray(values, float))
    return used(aligner.push(batches[0], batches[1:]))


def used(rows: list[AlignedRows]) -> list[AlignedRows]:
    return [one for batch in rows for one in one_by_one(batch.pick(batch.given))]


def one_by_one(batch: AlignedRows) -> list[AlignedRows]:
    return [batch.pick(slice(row, row + 1)) for row in range(len(batch))]


def rows_of_stream(load_stamps, load, probe_stamps, gaps, order=None) -> list[AlignedRows]:
    """Push everything in stamp order (or in the order given) and collect the rows."""
    aligner = Aligner(max_wait=10**15)
    samples = [
        (int(stamp), -1, float(value))
        for stamp, value in zip(load_stamps, load, strict=True)]
    for probe in range(4):
        samples += [
            (int(stamp), probe, float(value))
            for stamp, value in zip(probe_stamps[probe], gaps[probe], strict=True)]
    samples.sort()
    rows = []
    for place in range(len(samples)) if order is None else order(samples):
        stamp, channel, value = samples[place]
        rows += push(aligner, channel, [stamp], [value])
    return rows


def numbers(rows: list[AlignedRows]) -> list[tuple[float, ...]]:
    """Stamp, time, load and gaps of each row."""
    return [(int(row.stamps[0]), float(row.time[0]), float(row.loads[0]), *row.gaps[:, 0].tolist())
            for row in rows]


intervals = st.lists(
    st.one_of(st.integers(1, 3_000_000), st.integers(1, 300_000_000),
              st.just(LEAP_NS), st.just(LEAP_NS + 1)), min_size=1, max_size=60)
interval_lists = st.tuples(intervals, intervals, intervals, intervals, intervals)


@settings(max_examples=150, deadline=None)
@given(interval_lists, st.integers(0, 2 ** 32 - 1), st.integers(1, 60))
def test_a_record_in_batches_of_any_size_gives_the_rows_of_the_whole(lists, seed, size):
    random = np.random.default_rng(seed)
    load, *probes = (Samples(stamps_of(of_channel), random.normal(size=len(of_channel)))
                     for of_channel in lists)
    gaps, is_given, is_published = aligned_record(load, probes)
    aligned = np.array([align(load.stamps, one.stamps, one.values) for one in probes])
    assert np.array_equal(gaps, aligned, equal_nan=True)

    aligner, rows = Aligner(dead_after=record_batches.DEAD_AFTER_NS, max_wait=10**15), []
    ends = np.sort(np.concatenate([load.stamps, *(one.stamps for one in probes)]))[::size]
    for first, last in pairwise([0, *ends.tolist(), 2**62]):
        load_part, *parts = (one.pick((one.stamps > first) & (one.stamps <= last))
                             for one in (load, *probes))
        rows += aligner.push(load_part, parts)
    rows += aligner.finish()
    assert np.array_equal(np.concatenate([one.stamps for one in rows]), load.stamps)
    assert np.array_equal(np.concatenate([one.loads for one in rows]), load.values)
    assert np.array_equal(np.concatenate([one.time for one in rows]),
                          record_batches.seconds_array(load.stamps, int(load.stamps[0])))
    assert np.array_equal(np.concatenate([one.given for one in rows]), is_given)
    assert np.array_equal(np.concatenate([one.published for one in rows]), is_published)
    assert np.array_equal(np.concatenate([one.gaps for one in rows], axis=1), gaps,
                          equal_nan=True)


anything = st.lists(st.tuples(
    st.integers(0, 4), st.integers(-10 ** 9, 10 ** 9) | st.integers(0, 40),
    st.floats(allow_nan=True, allow_infinity=True)), max_size=200)


@settings(max_examples=150, deadline=None)
@given(anything, st.integers(1, 10 ** 9))
def test_whatever_arrives_rows_stay_in_order_finite_and_counted(samples, unit):
    aligner = Aligner(max_wait=2 * 10**9, max_pending=50, max_samples=40)
    rows, loads, stamp = [], 0, EPOCH
    for channel, step, value in samples:
        stamp += step * (unit if abs(step) <= 40 else 1)
        loads += channel == 0
        rows += push(aligner, channel - 1, [stamp], [value])
        assert aligner.pending <= 51
    aligner.finish()
    for before, after in pairwise(rows):
        assert (before.restart, before.stamps[0]) < (after.restart, after.stamps[0])
        if before.restart == after.restart:
            passed = 1e-9 * float(after.stamps[0] - before.stamps[0])
            assert after.time[0] - before.time[0] == pytest.approx(passed, abs=1e-9)
    assert np.isfinite(numbers(rows)).all()
    assert len(rows) + aligner.counters.dropped <= loads


def test_interleaving_of_channels_does_not_matter():
    random = np.random.default_rng(5)
    load_stamps = regular(300)
    probe_stamps = [regular(290, start=EPOCH + offset) for offset in (-37, 11, 400_000, 999_999)]
    load, gaps = random.normal(size=300), random.normal(size=(4, 290))
    in_order = rows_of_stream(load_stamps, load, probe_stamps, gaps)

    def channel_blocks(samples):
        """Each channel in its own order, in bursts of 20."""
        bursts = {}
        for place, (_, channel, _) in enumerate(samples):
            bursts.setdefault(channel, []).append(place)
        for start in range(0, 300, 20):
            for channel in (2, -1, 0, 3, 1):
                yield from bursts[channel][start:start + 20]

    rows = rows_of_stream(load_stamps, load, probe_stamps, gaps, channel_blocks)
    assert numbers(rows) == numbers(in_order)
    assert len(in_order) > 280


def test_a_straight_line_is_reproduced_between_samples():
    probe = regular(50, 3 * MILLISECOND)
    load = regular(120, MILLISECOND, EPOCH + 137)
    expected = (load - EPOCH) * 1e-12
    aligned = align(load, probe, (probe - EPOCH) * 1e-12)
    inside = load <= probe[-1]
    np.testing.assert_allclose(aligned[inside], expected[inside], rtol=1e-12)
    assert np.isnan(aligned[~inside]).all()


def test_nothing_is_read_outside_a_probes_span():
    aligned = align(regular(10), regular(4, start=EPOCH + 3 * MILLISECOND), np.ones(4))
    assert np.isfinite(aligned).tolist() == [False] * 3 + [True] * 4 + [False] * 3


def test_a_stamp_met_exactly_gives_the_sample_itself():
    values = np.array([0.1, 1e300, -1e300, 0.3])
    assert align(regular(4), regular(4), values).tolist() == values.tolist()


@pytest.mark.parametrize(('lost', 'unread'), [(slice(40, 60), range(40, 60)), (slice(40, 44), [])])
def test_gaps_are_not_bridged_unlike_a_few_lost_samples(lost, unread):
    probe = np.delete(regular(100), lost)
    aligned = align(regular(100), probe, np.ones(len(probe)))
    assert np.flatnonzero(np.isnan(aligned)).tolist() == list(unread)


def test_a_probe_that_slows_down_has_gaps_until_the_median_follows():
    stamps = np.concatenate([regular(50), regular(50, 100 * MILLISECOND, EPOCH + 10 ** 9)])
    mask = gap_mask(stamps)
    assert mask[49:57].all()
    assert not mask[58:].any()
    assert not gap_mask(stamps[50:]).any(), 'slow from the beginning'


def test_a_slow_test_after_a_fast_one_loses_none_of_its_first_samples():
    later = EPOCH + 3_600 * 10 ** 9
    slow = regular(50, 40 * MILLISECOND, later)
    both = np.concatenate([regular(500), slow])
    assert np.flatnonzero(gap_mask(both)).tolist() == [499]
    rows = rows_of_stream(both, np.ones(550), [both + MILLISECOND // 4] * 4, np.ones((4, 550)))
    assert [stamp for stamp in stamps_out(rows) if stamp >= later] == slow[1:].tolist()


@pytest.fixture
def aligner() -> Aligner:
    return Aligner()


def push_all(aligner: Aligner, stamp: int, value: float = 1.0) -> list[AlignedRows]:
    return [row for channel in range(-1, 4) for row in push(aligner, channel, [stamp], [value])]


def stamps_out(rows: list[AlignedRows]) -> list[int]:
    return [int(row.stamps[0]) for row in rows]


def test_a_jump_back_restarts_the_time_and_says_so(aligner):
    earlier = regular(10, start=EPOCH - 10 ** 10)
    before = [row for stamp in regular(10) for row in push_all(aligner, int(stamp))]
    after = [row for stamp in earlier for row in push_all(aligner, int(stamp))]
    assert {row.restart for row in before} == {0}
    assert {row.restart for row in after} == {1}
    assert after[0].time[0] == 0.0
    assert len(after) == 10
    assert aligner.counters.load_jumps == 1


@pytest.mark.parametrize('load_first', [True, False])
def test_no_row_mixes_samples_from_both_sides_of_a_jump(aligner, load_first):
    for stamp in regular(1000):
        push_all(aligner, int(stamp), 1.0)
    rows = []
    back = EPOCH + 500 * MILLISECOND
    for stamp in regular(400, start=back):
        for channel in range(-1, 4) if load_first else range(3, -2, -1):
            rows += push(aligner, channel, [stamp], [2.0])
    assert stamps_out(rows) == regular(400, start=back).tolist()
    assert {row[2:] for row in numbers(rows)} == {(2.0,) * 5}


def test_a_batch_with_a_jump_in_it_mixes_nothing_from_both_sides_of_it(aligner):
    stamps = np.concatenate([regular(300), regular(200, start=EPOCH - 20 * MILLISECOND)])
    batch = Samples(stamps, np.repeat([1.0, 2.0], [300, 200]))
    rows = used(aligner.push(batch, [batch] * 4))
    assert stamps_out(rows) == stamps.tolist()
    assert numbers(rows)[300][1:] == (0.0, 2.0, 2.0, 2.0, 2.0, 2.0)
    assert {row[2:] for row in numbers(rows)} == {(1.0,) * 5, (2.0,) * 5}
    assert (aligner.counters.probe_jumps, aligner.counters.load_jumps) == (4, 1)


def test_late_samples_within_jitter_are_put_in_order(aligner):
    for stamp in (EPOCH, EPOCH + 2 * MILLISECOND, EPOCH + MILLISECOND, EPOCH + 3 * MILLISECOND):
        push(aligner, -1, [stamp], [stamp - EPOCH])
    rows = []
    for probe in range(4):
        for stamp in (EPOCH, EPOCH + 3 * MILLISECOND):
            rows += push(aligner, probe, [stamp], [0.0])
    assert [row.loads[0] for row in rows] == [0.0, 1e6, 2e6, 3e6]
    assert aligner.counters.reordered == 1


def test_joining_late_drops_and_counts_what_no_probe_saw(aligner):
    for stamp in regular(5):
        push(aligner, -1, [stamp], [1.0])
    rows = []
    for probe in range(4):
        rows += push(aligner, probe, [EPOCH + 3 * MILLISECOND], [0.5])
    assert stamps_out(rows) == [EPOCH + 3 * MILLISECOND]
    assert aligner.counters.before_probes == 3
    assert [one.given.tolist() for one in aligner.finish()] == [[False]]


@pytest.mark.parametrize('is_silent', ['a probe', 'the load'])
def test_a_silent_topic_costs_bounded_memory_and_is_counted(is_silent):
    aligner = Aligner(max_wait=500 * MILLISECOND, max_samples=1000)
    for stamp in regular(4_000):
        sample = Samples(np.array([stamp]), np.ones(1))
        if is_silent == 'a probe':
            aligner.push(sample, [*[sample] * 3, NOTHING])
        else:
            aligner.push(NOTHING, [sample, *[NOTHING] * 3])
    assert aligner.pending <= 502
    assert all(len(probe) <= 1000 for probe in aligner._probes)
    lost = aligner.counters.timed_out if is_silent == 'a probe' else aligner.counters.overflow
    assert lost >= 3_000


def test_memory_stays_bounded_on_a_long_healthy_stream(aligner):
    rows = [row for stamp in regular(5000) for row in push_all(aligner, int(stamp))]
    assert len(rows) == 5000
    assert all(len(probe) < 400 for probe in aligner._probes)
    assert aligner.counters.dropped == 0


def test_only_intervals_behind_the_last_leap_set_the_limit_of_a_gap():
    history = [MILLISECOND] * 5 + [LEAP_NS + 1]
    assert gap_limit([*history, *history, *[50 * MILLISECOND] * 3]) == 250 * MILLISECOND


def test_nan_and_duplicates_are_dropped_and_counted(aligner):
    push_all(aligner, EPOCH)
    push_all(aligner, EPOCH)
    push(aligner, -1, [EPOCH + 1], [np.nan])
    push(aligner, 0, [EPOCH + 1], [np.inf])
    assert aligner.counters.duplicates + aligner.counters.late_loads == 5
    assert aligner.counters.not_finite == 2


def test_a_load_that_came_late_holds_the_next_ones_back_for_twice_its_delay() -> None:
    aligner, stamps, zeros = Aligner(max_wait=10**15), regular(40), np.zeros(40)
    for probe in range(4):
        push(aligner, probe, stamps, zeros)
    assert push(aligner, -1, stamps[:10], zeros[:10])[-1].stamps == stamps[9]
    push(aligner, -1, stamps[5:6] + 1, zeros[:1])  # 4 ms behind the newest
    assert push(aligner, -1, stamps[10:30], zeros[10:30])[-1].stamps == stamps[29 - 8]
