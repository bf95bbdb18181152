"""Residuals and loads joined and watched: whatever the batches, the same alarm."""

from dataclasses import replace

import numpy as np
import pytest

from saddlering_ros.monitoring.detector import materiality
from saddlering_ros.monitoring.monitor import LEARNING, MonitorSettings, Sample, WAITING
from saddlering_ros.monitoring.stream import AlarmStream
from saddlering_ros.record.batches import Displacements, no_displacements, no_samples, Samples
from saddlering_ros.rig import default_rig, TRUE_TO_SCALE

RIG = default_rig()
ELEVATION = np.radians(50.0)


@pytest.fixture(name='record', scope='module')
def record_fixture():
    """3 s of rest, then a load that goes up and down; delta_x leaves its model at 5 s."""
    chance = np.random.default_rng(1)
    time = np.arange(0.0, 8.0, 2e-3)
    channels = 3e-7 * chance.standard_normal((4, time.size))
    channels[0, time >= 5.0] += 10e-6
    stamps = 1_700_000_000_000_000_000 + np.round(1e9 * time).astype(np.int64)
    load = RIG.preload + 1e5 * np.sin(np.maximum(time - 3.0, 0.0))**2
    return Displacements.from_zero(stamps, channels, (int(stamps[0]),) * 2, RIG.preload,
                                   ELEVATION), Samples(stamps, load)


def pushed(record, *, pace, behind=0, parameters_at=0):
    """The stream after the record in batches; the residual `behind` batches after its load."""
    residual, load = record
    stream = AlarmStream(RIG, MonitorSettings(), 2.0)
    starts = range(0, len(load.stamps), pace)
    for turn in range(len(starts) + behind):
        if turn == parameters_at:
            stream.use(TRUE_TO_SCALE)
        here = slice(turn * pace, (turn + 1) * pace)
        late = slice(max(0, turn - behind) * pace, max(0, turn - behind + 1) * pace)
        stream.push(residual.pick(late) if turn >= behind else no_displacements(),
                    load.pick(here))
    return stream


def outcome(stream):
    monitor = stream.monitor
    return monitor.alarm, monitor.rest, monitor.seconds, monitor.log_evidence, monitor.lapses


def test_the_size_and_order_of_batches_change_nothing_bit_for_bit(record):
    whole = pushed(record, pace=100_000)
    alarm = whole.monitor.alarm
    assert alarm.channel == 'delta_x'
    assert alarm.size == pytest.approx(10e-6, rel=0.1)
    assert (alarm.since - record[0].stamps[0]) / 1e9 == pytest.approx(5.0, abs=0.05)
    for stream in (pushed(record, pace=7), pushed(record, pace=97, behind=3),
                   pushed(record, pace=333, parameters_at=9)):
        assert outcome(stream) == outcome(whole)
    direct = AlarmStream(RIG, MonitorSettings(), 2.0)
    direct.use(TRUE_TO_SCALE)
    residual, load = record
    for stamp, row, force in zip(residual.stamps.tolist(), residual.channels[:3].T.tolist(),
                                 load.values.tolist(), strict=True):
        direct.monitor.step(
            Sample(stamp, tuple(row), force, int(residual.zero_stamps[0]), ELEVATION))
    assert outcome(direct) == outcome(whole)


def test_a_residual_within_materiality_does_not_alarm_and_one_beyond_does(record):
    residual, load = record
    percent = 2.0
    stream = pushed(record, pace=500)
    allowed = stream.monitor.materiality[0] / percent  # a percent of the motion
    quiet = residual.channels.copy()
    quiet[0, residual.stamps >= residual.stamps[0] + 5_000_000_000] -= 10e-6
    for share, alarms in ((1.9, False), (4.0, True)):
        channels = quiet.copy()
        channels[0] += share * allowed * np.sign(np.gradient(load.values))  # as friction would
        other = replace(residual, channels=channels)
        assert (pushed((other, load), pace=500).monitor.alarm is not None) == alarms


def test_nothing_is_watched_before_the_parameters_are_known_and_nothing_is_lost(record):
    residual, load = record
    stream = AlarmStream(RIG, MonitorSettings(), 2.0)
    stream.push(residual, load)
    assert stream.monitor.state == WAITING
    assert stream.waiting == len(residual)
    stream.use(TRUE_TO_SCALE)
    stream.push(no_displacements(), no_samples())
    assert stream.monitor.alarm == pushed(record, pace=500).monitor.alarm


def test_a_load_that_is_lost_costs_its_residual_and_a_replay_from_the_start_begins_anew(record):
    residual, load = record
    rows = np.delete(np.arange(1000), [5, 600])
    stream = AlarmStream(RIG, MonitorSettings(), 2.0)
    stream.use(TRUE_TO_SCALE)
    stream.push(residual.pick(slice(0, 1000)), load.pick(rows))
    assert stream.counters['without_load'] == 2
    assert stream.monitor.stamp == int(residual.stamps[999])
    stream.push(residual.pick(slice(0, 100)), load.pick(slice(0, 100)))
    assert stream.monitor.state == LEARNING
    assert 'jumped back' in stream.monitor.lapses[-1].reason


def test_materiality_does_not_vanish_where_a_channel_turns_back_on_the_way():
    """At 22 degrees delta_y ends where it began, at full scale, and moves by 15 um between."""
    found = materiality(RIG, TRUE_TO_SCALE, np.radians(22.0), 2.0)
    assert found[1] == pytest.approx(0.02 * 15e-6, rel=0.1)
    assert np.array_equal(materiality(RIG, TRUE_TO_SCALE, np.radians(22.0), 4.0), 2.0 * found)
