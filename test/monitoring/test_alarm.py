"""The alarm: false alarms as rare as promised, changes found as soon as theory allows."""

from __future__ import annotations

import numpy as np
import pytest

from saddlering_ros.estimation.noise import ChannelNoise
from saddlering_ros.monitoring import (
    block_noise,
    BlockNoise,
    Detector,
    Monitor,
    MonitoringError,
    MonitorSettings,
    watch,
    Whitener,
)

WHITE = BlockNoise(1.0, 0.0, 0.0)
SETTINGS = MonitorSettings((0.0, 0.0, 0.0), block=0.02, false_alarm_hours=1000.0)


def blocks_until_alarm(shift, *, blocks, seed, hours=1000.0, materiality=0.0, channels=3):
    detector = Detector(channels, hours * 3600.0 / 0.02)
    chance = np.random.default_rng(seed)
    for block in range(blocks):
        innovations = chance.standard_normal(channels)
        innovations[0] += shift(block)
        if detector.step(innovations, np.full(channels, materiality)) is not None:
            return block
    return None


def test_false_alarms_are_no_more_frequent_than_allowed():
    detector_blocks, allowed, alarms = 0, 400.0, 0
    chance = np.random.default_rng(0)
    detector = Detector(3, allowed)
    for _ in range(20_000):
        detector_blocks += 1
        if detector.step(chance.standard_normal(3), np.zeros(3)) is not None:
            alarms += 1
            detector.reset()
    assert alarms <= detector_blocks / allowed


@pytest.mark.parametrize(('size', 'seconds'), [(0.5, 8.0), (1.0, 2.0), (3.0, 0.3)])
def test_a_step_is_found_within_seconds_at_one_false_alarm_in_1000_hours(size, seconds):
    found = blocks_until_alarm(lambda block: size, blocks=2000, seed=1)
    assert found is not None
    assert 0.02 * found < seconds


def test_what_lies_within_materiality_never_alarms():
    assert blocks_until_alarm(lambda block: 0.5, blocks=20_000, seed=2, materiality=0.5) is None
    assert blocks_until_alarm(lambda block: 1.5, blocks=2000, seed=2, materiality=0.5) is not None


def test_a_change_far_beyond_a_large_materiality_is_found():
    found = blocks_until_alarm(lambda block: 30.0, blocks=100, seed=2, materiality=20.0)
    assert found is not None
    assert found < 10


def test_one_wild_block_is_no_change():
    found = blocks_until_alarm(lambda block: 1e3 * (block == 50), blocks=200, seed=3)
    assert found is None


def test_innovations_of_wandering_noise_are_independent():
    chance = np.random.default_rng(4)
    noise, wander, values = BlockNoise(1.0, 4.0, 0.98), 0.0, []
    whitener = Whitener(noise)
    for _ in range(20_000):
        wander = 0.98 * wander + np.sqrt(4.0 * (1.0 - 0.98**2)) * chance.standard_normal()
        values.append(whitener.step(wander + chance.standard_normal())[0])
    seen = np.array(values[500:])
    assert seen.std() == pytest.approx(1.0, abs=0.02)
    assert abs(np.corrcoef(seen[1:], seen[:-1])[0, 1]) < 0.02


def test_noise_of_blocks_follows_from_that_of_samples():
    sampled = ChannelNoise(1e-3, 1.0, np.array([4.0]), np.array([0.1]))
    found = block_noise(sampled, 20)
    assert found.white == pytest.approx(1.0 / 20.0, rel=0.02)
    assert found.wander == pytest.approx(0.1, rel=0.02)
    assert found.memory == pytest.approx(np.exp(-0.02 / 4.0), rel=1e-3)


def record(seconds=20.0, step_at=10.0, size=2.0):
    chance = np.random.default_rng(5)
    time = np.arange(0.0, seconds, 1e-3)
    residual = np.sqrt(20.0) * chance.standard_normal((3, time.size))
    residual[1, time >= step_at] += size
    return time, residual, 1e5 * np.sin(time)


def test_the_alarm_names_channel_onset_and_size():
    alarm = watch(*record(), [WHITE] * 3, SETTINGS).alarm
    assert alarm.channel == 'delta_y'
    assert alarm.since == pytest.approx(10.0, abs=0.3)
    assert alarm.time - alarm.since < 2.0
    assert alarm.size == pytest.approx(2.0, abs=0.5)


def test_samples_in_any_batches_give_the_same_alarm():
    time, residual, load = record()
    monitor = Monitor([WHITE] * 3, SETTINGS)
    raised = [monitor.step(float(now), residual[:, index], float(load[index]))
              for index, now in enumerate(time)]
    assert [item for item in raised if item] == [watch(time, residual, load, [WHITE] * 3,
                                                       SETTINGS).alarm]


def test_a_renewed_zero_and_missing_samples_are_said_and_begin_anew():
    time, residual, load = record(size=0.0)
    keep = (time < 5.0) | (time > 6.0)
    report = watch(time[keep], residual[:, keep], load[keep], [WHITE] * 3, SETTINGS)
    assert report.alarm is None
    assert len(report.lapses) == 1
    assert 'no samples for 1' in report.lapses[0]


def test_settings_that_cannot_be_used_are_refused():
    with pytest.raises(MonitoringError, match='above 0'):
        MonitorSettings((0.0, 0.0, 0.0), block=0.0)
