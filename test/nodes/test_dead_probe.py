"""A probe that does not read costs the channels that need it, and no other."""

from dataclasses import replace

import numpy as np
import pytest

from saddlering_ros.record.batches import Displacements, join, no_samples, Samples
from saddlering_ros.record.displacement import DisplacementStream
from saddlering_ros.rig import default_rig

RIG = default_rig()
NO_DELTA_X, NO_DELTA_Y, NO_GAMMA, NO_PARITY = 1, 2, 4, 8


def measured(record, dead: int | None = None, since: int = 0, until: int = 10**9,
             pace: int = 50) -> tuple[DisplacementStream, Displacements]:
    """The record twice as slow (8 s), with probe `dead` silent for the rows since to until."""
    start = int(record.stamps[0])
    stream, parts = DisplacementStream(RIG), []
    for first in range(0, len(record.stamps), pace):
        rows = np.arange(first, min(first + pace, len(record.stamps)))
        gaps = []
        for probe in range(4):
            kept = rows if probe != dead else rows[(rows < since) | (rows >= until)]
            stamps = start + 2 * (record.probe_stamps[probe][kept] - start)
            gaps.append(Samples(stamps, record.gaps[probe][kept]))
        load = Samples(start + 2 * (record.stamps[rows] - start), record.load[rows])
        parts.append(stream.push(load, gaps))
    return stream, join([part for part in parts if len(part)])


@pytest.mark.parametrize('pace', [20, 200])
@pytest.mark.parametrize(('probe', 'missing'), [
    (0, NO_DELTA_X | NO_PARITY), (1, NO_DELTA_Y | NO_GAMMA), (2, NO_DELTA_X | NO_PARITY),
    (3, NO_DELTA_Y | NO_GAMMA)])
def test_a_probe_that_dies_leaves_the_channels_that_do_not_need_it(record, probe, missing, pace):
    _, whole = measured(record)
    stream, found = measured(record, dead=probe, since=900, pace=pace)
    assert len(found) > len(whole) - 5
    _, ours, theirs = np.intersect1d(found.stamps, whole.stamps, return_indices=True)
    found_, whole_ = found.channels[:, ours], whole.channels[:, theirs]
    for index, bit in enumerate((NO_DELTA_X, NO_DELTA_Y, NO_GAMMA, NO_PARITY)):
        if missing & bit:
            assert np.isnan(found_[index, 910:]).all()
        else:
            assert np.array_equal(found_[index], whole_[index])
    assert set(found.validity[:890].tolist()) == {0}
    assert set(found.validity[910:].tolist()) == {missing}
    assert [index for index, count in enumerate(stream.take_missing()) if count] == [probe]
    assert stream.take_missing() == [0, 0, 0, 0]


@pytest.mark.parametrize(('probe', 'rows', 'validity'), [
    (1, (0, 10**9), {NO_DELTA_Y | NO_GAMMA}), (0, (600, 650), {0}),  # 0.2 s
    (0, (600, 1500), {0, NO_DELTA_X | NO_PARITY})], ids=['never reads', 'short gap', 'comes back'])
def test_a_probe_is_missing_as_long_as_it_does_not_read(record, probe, rows, validity) -> None:
    _, found = measured(record, probe, *rows)
    assert set(found.validity.tolist()) == validity
    assert np.isfinite(found.channels[0 if probe else 1]).all()
    assert found.validity[-1] == min(validity)


@pytest.mark.parametrize('refused', ['', 'in millimetres', 'not a number'])
@pytest.mark.parametrize(('probe', 'missing'), [
    (0, NO_DELTA_X | NO_PARITY), (3, NO_DELTA_Y | NO_GAMMA)])
def test_a_probe_that_falls_silent_holds_the_known_channels_back_for_no_longer_than_an_interlock(
        record, probe: int, missing: int, refused: str) -> None:
    """0.3 s without a residual opens the interlock. Readings that are refused are none."""
    start = int(record.stamps[0])
    stream, behind, now = DisplacementStream(RIG), [], 50.0
    for row in range(len(record.stamps)):
        stamp = start + 2 * (int(record.stamps[row]) - start)
        gaps = [Samples(np.array([start + 2 * (int(record.probe_stamps[place][row]) - start)]),
                        record.gaps[place][row:row + 1]) if place != probe or row < 900 else
                no_samples() for place in range(4)]
        if refused and row >= 900:
            gaps[probe] = Samples(gaps[probe - 1].stamps, np.array(
                [1.05 if refused == 'in millimetres' else np.nan]))
        now += 0.004
        found = stream.push(Samples(np.array([stamp]), record.load[row:row + 1]), gaps, now)
        if len(found):
            newest, validity = int(found.stamps[-1]), int(found.validity[-1])
        if row > 600:
            behind.append((stamp - newest) / 1e9)
    assert max(behind) < 0.3
    assert max(behind[-100:]) < 0.02, 'and then goes on at once'
    assert validity == missing


def in_bursts(record, late: int, size: int, until: int = 2000, pace: float = 1.0,
              ) -> tuple[DisplacementStream, Displacements]:
    """Rows in bursts of `size`, taken by portions topic by topic, at `pace` of real time.

    A publisher on a busy machine has no processor for a while, sends all that was due meanwhile,
    and is interrupted for 0.1 s before the last topic, that of probe `late`. The probe sends
    nothing from row `until` on.
    """
    stream, parts, now = DisplacementStream(RIG), [], 100.0
    topics = [0, *(probe for probe in (1, 2, 3, 4) if probe != late + 1), late + 1]
    stamps, values = [record.stamps, *record.probe_stamps], [record.load, *record.gaps]
    for first in range(0, len(record.stamps), size):
        for topic in topics if first < until else topics[:-1]:
            now += 0.1 * pace * (topic == topics[-1])
            for portion in range(first, first + size, 50):
                rows, batches = slice(portion, min(portion + 50, first + size)), [no_samples()] * 5
                batches[topic] = Samples(stamps[topic][rows], values[topic][rows])
                parts.append(stream.push(batches[0], batches[1:], now))
                now += 0.001 * pace
        now += pace * size / 500.0
    parts.append(stream.flush())
    return stream, join([part for part in parts if len(part)])


@pytest.mark.parametrize('late', range(4))
def test_a_probe_whose_burst_comes_later_than_those_of_the_others_is_not_silent(record, late):
    stream, found = in_bursts(record, late, 250)
    assert len(found) == len(record.stamps) - 1
    assert set(found.validity.tolist()) == {0}
    assert not any(stream.take_missing())


def test_each_of_two_probes_whose_death_leaves_no_channel_is_missing(record) -> None:
    stream, _ = measured(record)
    stream.take_missing()
    newest = int(record.stamps[-1])
    after = Samples(2 * newest - int(record.stamps[0]) + 2_000_000 * np.arange(1, 3000),
                    np.full(2999, RIG.preload))
    stream.push(after, [replace(after, values=np.full(2999, 1e-3)) if probe in (2, 3) else
                        no_samples() for probe in range(4)])
    assert [count > 0 for count in stream.take_missing()] == [True, True, False, False]


def test_no_probe_is_missing_at_the_one_load_between_two_stretches(record) -> None:
    """As where a node that was inactive for more than a second hears the load first again."""
    stream, found = measured(record)
    stamps = int(found.stamps[-1]) + 1_500_000_000 + 2_000_000 * np.arange(200)
    again = [Samples(stamps + 1_000_000, gap[:200]) for gap in record.gaps]
    stream.push(Samples(stamps, record.load[:200]), [no_samples()] * 4)
    stream.push(no_samples(), again)
    assert not any(stream.take_missing())


def test_rows_of_a_probe_that_died_before_the_end_come_when_nothing_more_does(record) -> None:
    _, found = in_bursts(record, 3, 100, until=1600, pace=0.01)
    assert found.stamps[-1] == record.stamps[-1]
    assert set(found.validity[-390:].tolist()) == {NO_DELTA_Y | NO_GAMMA}


def test_a_topic_that_comes_by_blocks_is_not_silent_between_them(record) -> None:
    """Blocks of 0.5 s, topic by topic, as a logger sends them; no row lacks a channel."""
    stream, parts, size = DisplacementStream(RIG), [], 250
    for first in range(0, len(record.stamps), size):
        rows = slice(first, first + size)
        for topic in range(5):
            batches = [no_samples()] * 5
            batches[topic] = (Samples(record.stamps[rows], record.load[rows]) if not topic else
                              Samples(record.probe_stamps[topic - 1][rows],
                                      record.gaps[topic - 1][rows]))
            parts.append(stream.push(batches[0], batches[1:]))
    found = join([part for part in parts if len(part)])
    assert len(found) > len(record.stamps) - 10
    assert set(found.validity.tolist()) == {0}
