"""The alarm: false alarms as rare as promised, changes found as soon as theory allows."""

from dataclasses import replace
import math

import numpy as np
import pytest

from saddlering_ros.estimation.process import ChannelNoise
from saddlering_ros.monitoring import detector as detectors
from saddlering_ros.monitoring import monitor as monitors
from saddlering_ros.monitoring.detector import assumed_noise, BlockNoise, BlockWatch, Detector
from saddlering_ros.monitoring.monitor import ALARM, first_guess, Monitor, Sample, WATCHING
from saddlering_ros.rig import default_rig

SETTINGS = monitors.MonitorSettings()


def test_the_wander_of_all_channels_leaves_its_limits_as_seldom_as_promised():
    noise, block, hours, channels = BlockNoise(1.0, 4.0, 0.98), 0.02, 100.0, 3
    z = detectors.wander_limit(noise, block, hours, channels) / 2.0
    density = math.exp(-0.5 * z * z) / math.sqrt(2.0 * math.pi)
    a_second = channels * 2.0 * z * density / (-block / math.log(0.98))
    assert a_second * 3600.0 * hours == pytest.approx(detectors.WANDER_SHARE, rel=1e-6)


def watch(one, samples):
    """Let a monitor watch samples; the monitor."""
    for sample in samples:
        one.step(sample)
    return one


BAND = 1000.0
WANDERING = BlockNoise(1.0, 4.0, 0.995)


def blocks_until_alarm(shift, *, blocks, seed, hours=1000.0, bound=0.0, channels=3):
    detector = Detector(channels, hours * 3600.0 / 0.02)
    chance = np.random.default_rng(seed)
    for block in range(blocks):
        values = chance.standard_normal(channels)
        values[0] += shift(block)
        if detector.step(values, np.full(channels, bound)) is not None:
            return block
    return None


def test_false_alarms_are_no_more_frequent_than_allowed():
    allowed, blocks, alarms = 400.0, 10_000, 0
    chance = np.random.default_rng(0)
    detector = Detector(3, allowed)
    for _ in range(blocks):
        if detector.step(chance.standard_normal(3), np.zeros(3)) is not None:
            alarms += 1
            detector.reset()
    assert alarms <= blocks / allowed


@pytest.mark.parametrize(('size', 'seconds', 'bound'), [
    (0.5, 8.0, 0.0), (1.0, 2.0, 0.0), (3.0, 0.3, 0.0), (1.5, 40.0, 0.5)])
def test_a_step_is_found_within_seconds_at_one_false_alarm_in_1000_hours(size, seconds, bound):
    found = blocks_until_alarm(lambda block: size, blocks=2000, seed=1, bound=bound)
    assert 0.02 * found < seconds


def test_neither_a_mean_within_its_bound_nor_one_wild_block_is_a_change():
    assert blocks_until_alarm(lambda block: 0.5, blocks=10_000, seed=2, bound=0.5) is None
    assert blocks_until_alarm(lambda block: 1e3 * (block == 50), blocks=200, seed=3) is None


def test_innovations_of_wandering_noise_are_independent():
    chance = np.random.default_rng(4)
    noise, wander, values = BlockNoise(1.0, 4.0, 0.98), 0.0, []
    whitener = detectors.Innovations([noise])
    for _ in range(10_000):
        wander = 0.98 * wander + np.sqrt(4.0 * (1.0 - 0.98**2)) * chance.standard_normal()
        values.append(whitener.step(np.array([wander + chance.standard_normal()]))[0][0])
    seen = np.array(values[500:])
    assert seen.std() == pytest.approx(1.0, abs=0.03)
    assert abs(np.corrcoef(seen[1:], seen[:-1])[0, 1]) < 0.03


def test_noise_of_blocks_follows_from_that_of_samples():
    sampled = ChannelNoise(1e-3, np.array([0.1]), 0.0, 10, np.array([4.0]))
    found = detectors.block_noise(sampled, 0.02)
    assert found.white == pytest.approx(1.0 / 20.0, rel=0.02)
    assert found.wander == pytest.approx(0.1, rel=0.02)
    assert found.memory == pytest.approx(np.exp(-0.02 / 4.0), rel=1e-3)


def wandering(blocks, seed):
    """Means (blocks, 3) of white noise and a wander of one channel each."""
    chance = np.random.default_rng(seed)
    wander = np.zeros((blocks, 3))
    kicks = chance.standard_normal((blocks, 3)) * math.sqrt(4.0 * (1.0 - 0.995**2))
    wander[0] = 2.0 * chance.standard_normal(3)
    for block in range(1, blocks):
        wander[block] = 0.995 * wander[block - 1] + kicks[block]
    return wander + chance.standard_normal((blocks, 3))


def first_alarm(means, materiality):
    watching = BlockWatch([WANDERING] * 3, 0.02, 1000.0)
    for block, mean in enumerate(means):
        if watching.step(mean, np.full(3, materiality)) is not None:
            return block
    return None


# A residual that a model within materiality leaves: it may jump from one end to the other at once,
# as with friction, or follow the load.
@pytest.mark.parametrize('path', ['constant', 'jumps', 'swings'])
def test_a_model_within_materiality_does_not_alarm_however_its_residual_moves(path):
    blocks, m = 5000, 30.0
    time = 0.02 * np.arange(blocks)
    within = {'constant': np.full(blocks, m), 'jumps': m * np.sign(np.sin(time)),
              'swings': m * np.sin(3.0 * time)}[path]
    means = wandering(blocks, 6) + within[:, None]
    assert first_alarm(means, m) is None
    beyond = means.copy()
    beyond[2500:] *= 1.7
    assert 2500 <= first_alarm(beyond, m) < 2900


def record(seconds=14.0, step_at=9.0, size=2.0, stamp=0, load=None):
    """Samples at 500 Hz: 3 s of rest, then a load that goes up and down; unit noise."""
    chance = np.random.default_rng(5)
    time = np.arange(0.0, seconds, 2e-3)
    residual = chance.standard_normal((time.size, 3))
    residual[time >= step_at, 1] += size
    force = 1e5 * np.sin(np.maximum(time - 3.0, 0.0)) if load is None else load(time)
    return [Sample(stamp + round(1e9 * now), tuple(values), float(one), zero=1, elevation=0.5)
            for now, values, one in zip(time.tolist(), residual.tolist(), force, strict=True)]


def monitor(materiality=0.0, **settings):
    return Monitor(monitors.MonitorSettings(**settings), BAND,
                   lambda elevation: np.full(3, materiality))


def test_the_alarm_has_channel_onset_size_and_a_first_guess():
    watched = watch(monitor(), record())
    alarm = watched.alarm
    assert watched.state == ALARM
    assert alarm.channel == 'delta_y'
    assert 1e-9 * alarm.since == pytest.approx(9.0, abs=0.2)
    assert 1e-9 * (alarm.stamp - alarm.since) < 1.0
    assert alarm.size == pytest.approx(2.0, abs=0.1)
    assert alarm.follows == 'offset'
    assert 'probe' in alarm.first_guess
    assert watched.lapses == []


def test_the_noise_is_learnt_until_the_load_moves_and_watched_from_there_on():
    watched, states = monitor(), []
    assert watched.state == monitors.WAITING
    for sample in record(size=0.0, seconds=6.0):
        watched.step(sample)
        states.append((1e-9 * sample.stamp, watched.state))
    began = next(time for time, state in states if state == WATCHING)
    assert states[0][1] == monitors.LEARNING
    assert 3.0 < began < 3.2
    assert watched.rest.samples == 10
    assert watched.rest.seconds == pytest.approx(2.9, abs=0.1)
    noise = watched.rest.noise[0]
    assert noise.white + noise.wander == pytest.approx(0.1, rel=0.2)


def test_a_residual_that_moves_while_the_load_rests_is_no_noise_and_ends_the_sight():
    """A load cell that stands still, or sends kN: nothing was wrong for 20 s, then all noise."""
    watched, unwatched = monitor(materiality=10.0), {}
    samples = record(seconds=40.0, size=0.0, load=lambda time: np.full(time.size, 5e3))
    for number, sample in enumerate(samples):
        moved = 60.0 * float(np.clip(number / 500 - 2.0, 0.0, 5.0))
        watched.step(replace(sample, residual=(*sample.residual[:2], moved + sample.residual[2])))
        unwatched[number / 500] = watched.unwatched
    assert not unwatched[1.9]
    assert 'while the load rested: see to the load cell' in unwatched[4.0]
    assert unwatched[6.0] == unwatched[4.0]
    assert watched.alarm.channel == 'gamma'


def test_a_zero_that_is_renewed_before_the_noise_is_known_is_no_movement():
    samples = record(seconds=6.0, size=0.0)
    watched = watch(monitor(), [
        replace(one, zero=1 if number < 400 else 2, residual=tuple(
            value + (500.0 if number < 400 else 0.0) for value in one.residual))
        for number, one in enumerate(samples)])
    assert watched.state == WATCHING
    assert watched.rest.first
    assert watched.rest.noise[0].white < 1.0


def test_an_alarm_stays_until_it_is_reset_and_comes_again_if_its_cause_is_there():
    samples = record(size=5.0)
    watched = watch(monitor(), samples[:-1000])
    first = watched.alarm
    assert first is not None
    watched.reset()
    assert watched.state == WATCHING
    assert watched.alarm is None
    watch(watched, samples[-1000:])
    assert watched.alarm.since > first.stamp


@pytest.mark.parametrize(('change', 'words'), [
    ({'zero': 2}, 'the zero was renewed'), ({'elevation': 0.9}, 'the elevation changed to 51.56'),
    ({'stamp': 2_000_000_000}, 'no samples for 2 s'), ({'stamp': -60_000_000_000}, 'jumped back')])
def test_a_lapse_of_the_assumptions_is_reported_and_the_evidence_begins_anew(change, words):
    samples = record(size=0.35)
    middle = len(samples) - 1800
    after = [replace(one, **{**change, 'stamp': one.stamp + change.get('stamp', 0)})
             for one in samples[middle:]]
    watched = watch(monitor(), samples[:middle])
    before = watched.log_evidence
    assert before > 0.0
    watched.step(after[0])
    assert [words in lapse.reason for lapse in watched.lapses] == [True]
    assert watched.log_evidence < 0.0
    watch(watched, after[1:])
    assert len(watched.lapses) <= 2


def test_a_short_rest_and_a_rest_after_a_movement_are_reported():
    short = watch(monitor(), record(size=0.0)[1000:])
    assert ['1.0 s of rest' in lapse.reason or '0.9 s of rest' in lapse.reason
            for lapse in short.lapses] == [True]
    short.reset()  # which leaves what is true of the whole record
    assert len(short.lapses) == 1
    assert not watch(monitor(), record(size=0.0)[500:]).lapses  # the 2 s that the note asks for
    moving = record(size=0.0, load=lambda time: 1e5 * np.clip(np.abs(time - 6.0) - 2.0, 0.0, 1.0))
    late = watch(monitor(), moving[1600:])
    assert 'after a movement' in late.lapses[0].reason


def test_a_channel_that_is_not_known_is_reported_and_the_others_are_watched():
    samples = record()
    watched = watch(monitor(), [*samples[:2001], *(
        replace(one, residual=(math.nan, *one.residual[1:])) for one in samples[2001:])])
    assert [lapse.reason for lapse in watched.lapses] == ['delta_x not known, and not watched']
    assert watched.alarm.channel == 'delta_y'


def test_noise_that_grows_far_beyond_that_of_the_rest_is_reported():
    samples = record(size=0.0)
    watched = watch(monitor(materiality=3.0), [*samples[:2001], *(
        replace(one, residual=tuple(2.0 * value for value in one.residual))
        for one in samples[2001:])])
    assert watched.alarm is None
    assert ['larger than it was at rest' in lapse.reason for lapse in watched.lapses] == [True]


@pytest.mark.parametrize(('follows', 'make'), [
    ('load', lambda load, time: 1e-5 * load), ('direction', lambda load, time:
                                               np.sign(np.gradient(load))),
    ('rate', np.gradient), ('time', lambda load, time: 0.3 * time),
    ('offset', lambda load, time: np.full(time.size, 9.0)), ('unclear', lambda load, time:
                                                             np.sin(40.0 * time))])
def test_the_first_guess_is_what_the_residual_follows(follows, make):
    time = np.arange(0.0, 12.0, 0.02)
    load = 1e5 * np.abs((time % 4.0) - 2.0)**1.5
    residual = make(load, time)
    residual = residual / max(np.std(residual), 1e-12) if follows != 'offset' else residual
    noisy = residual + 0.2 * np.random.default_rng(7).standard_normal(time.size)
    assert first_guess(noisy, load, time, BAND) == follows
    assert first_guess(noisy[:5], load[:5], time[:5], BAND) == ''


def test_load_and_time_are_told_apart_only_when_the_load_has_turned():
    time = np.arange(0.0, 4.0, 0.02)
    noise = 0.2 * np.random.default_rng(7).standard_normal(time.size)
    rising, turning = 5e4 * time, 5e4 * np.minimum(time, 4.0 - time)
    for residual in (1e-4 * rising, 2.0 * time):
        assert first_guess(residual + noise, rising, time, BAND) == ''
    assert first_guess(1e-4 * turning + noise, turning, time, BAND) == 'load'
    assert first_guess(2.0 * time + noise, turning, time, BAND) == 'time'


def test_held_loads_keep_the_direction_in_which_they_came():
    """Friction of a static test was guessed to be a drift: at rest its load had no direction."""
    time = np.arange(0.0, 200.0, 0.2)
    rise = np.minimum(time, 200.0 - time)
    load = 5e3 * (rise // 5.0 + np.minimum(rise % 5.0, 1.0))  # a second each, held for four
    noise = 0.2 * np.random.default_rng(7).standard_normal(time.size)
    friction = np.sign(100.0 - time)
    assert first_guess(friction + noise, load, time, BAND) == 'direction'
    for residual in (1e-5 * load, 0.02 * time):
        rising = slice(0, time.size // 2)
        assert first_guess((residual + noise)[rising], load[rising], time[rising], BAND) == ''


def test_a_first_guess_is_judged_again_as_long_as_the_test_goes_on():
    def rise_and_fall(time):
        return 1e5 * np.clip(np.minimum(time - 5.0, 19.0 - time), 0.0, None)

    follows = []
    watched = monitor()
    for one in record(seconds=17.0, load=rise_and_fall):
        x, y, gamma = one.residual
        friction = 4.0 * (one.stamp > 12 * 10**9)  # +2 before the load turns, -2 after it
        watched.step(replace(one, residual=(x, y - friction, gamma)))
        if watched.alarm is not None and watched.alarm.follows not in follows:
            follows.append(watched.alarm.follows)
    assert follows == ['', 'one direction', 'direction']


def test_an_offset_under_a_load_that_moves_one_way_may_be_friction_or_a_probe():
    time = np.arange(0.0, 4.0, 0.02)
    noisy = 9.0 + 0.2 * np.random.default_rng(7).standard_normal(time.size)
    assert first_guess(noisy, 2e5 - 4e4 * time, time, BAND) == 'one direction'
    assert first_guess(noisy, np.maximum(2e5 - 8e4 * time, 0.0), time, BAND) == 'one direction'
    assert first_guess(noisy, np.full(time.size, 2e5), time, BAND) == 'offset'


def test_a_rest_longer_than_it_is_read_ends_the_learning():
    learner, found = detectors.RestLearner(BAND, 0.02), None
    values = np.random.default_rng(8).standard_normal((4000, 3)).tolist()
    for index, row in enumerate(values):
        found = learner.step(round(1e7 * index), tuple(row), 5.0)
        if found is not None:
            break
    assert found.seconds == pytest.approx(20.0, abs=0.1)


@pytest.mark.parametrize('settings', [{'block': 0.0}, {'false_alarm_hours': math.inf}])
def test_settings_that_cannot_be_used_are_refused(settings):
    with pytest.raises(detectors.MonitoringError, match='above 0'):
        monitors.MonitorSettings(**settings)


@pytest.mark.parametrize('size', [0.0, 0.3])
def test_a_wander_that_the_rest_was_too_short_for_is_no_alarm(size):
    """Noise of eddy-current probes [um], learnt from 2 s: the wander of 4 s hardly shows there."""
    chance = np.random.default_rng(3)
    time = np.arange(0.0, 40.0, 4e-3)
    memory = math.exp(-1e-3)
    residual = np.zeros((time.size, 3))
    wander = 0.064 * chance.standard_normal(3)
    for row in residual:
        wander = memory * wander + 0.064 * math.sqrt(1.0 - memory**2) * chance.standard_normal(3)
        row += wander
    residual += 0.1 * chance.standard_normal(residual.shape)
    residual -= residual[:125].mean(axis=0)  # the zero
    residual[time > 2.0] += size * np.sign(np.sin(1.3 * time[time > 2.0]))[:, None]
    load = 1e5 * np.sin(np.maximum(time - 2.0, 0.0))
    samples = [Sample(1 + round(1e9 * now), tuple(row), force) for now, row, force in
               zip(time.tolist(), residual.tolist(), load.tolist(), strict=True)]

    def watched(wander):
        return watch(Monitor(SETTINGS, BAND, lambda elevation: np.full(3, size), wander), samples)

    assert watched((0.0, 0.0, 0.0)).alarm is not None  # by what the rest shows alone
    assert watched((0.07, 0.07, 0.07)).alarm is None


def test_noise_between_white_and_slow_is_counted_to_both():
    assert assumed_noise(BlockNoise(1.0, 0.5, 0.1), 0.0, 0.02) == BlockNoise(1.5, 0.0, 0.0)
    between = assumed_noise(BlockNoise(1.0, 0.5, 0.8), 0.1, 0.02)
    assert (between.white, between.wander) == (1.5, 0.5)
    slow = assumed_noise(BlockNoise(1.0, 0.5, 0.999), 1.0, 0.02)
    assert (slow.white, slow.wander) == (1.0, 1.0)


def test_the_wander_assumed_follows_the_range_of_the_probes():
    probes, found = default_rig().probes, detectors.least_wander(default_rig())
    assert found[0] == pytest.approx(5e-5 * (probes.max_range - probes.min_range) / math.sqrt(2.0))
    assert found[2] == pytest.approx(2.0 * found[1] / probes.axial_span)
