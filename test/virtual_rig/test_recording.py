"""The virtual rig's recorder: noise as asked, stamps that never coincide, same bits per seed."""

from dataclasses import replace
import math

import numpy as np
import pytest

from saddlering_ros.bags.reader import read_raw, read_run
from saddlering_ros.errors import VirtualRigError
from saddlering_ros.record.plateaus import plateaus
from saddlering_ros.rig import default_rig, FULL_SCALE_LOAD, TONNE, TRUE_TO_SCALE
from saddlering_ros.virtual_rig import experiment
from saddlering_ros.virtual_rig.experiment import dynamic_schedule, record_test, static_schedule

RIG = default_rig()
PHYSICAL = experiment.PhysicalRig(RIG, TRUE_TO_SCALE, math.radians(50.0))
SHORT = experiment.TestPlan(
    PHYSICAL, dynamic_schedule(RIG, duration=3.0), seed=8, rate=200.0, step=4e-3)


@pytest.fixture(name='short', scope='module')
def short_fixture():
    return record_test(SHORT)


def residual_noise(record):
    """What a probe reads beyond the motion that it saw, (N,) [m], per probe."""
    for probe, (stamps, gaps) in enumerate(zip(record.probe_stamps, record.gaps, strict=True)):
        begin = round(record.probe_stamps[0][0] * 1e-9)
        seconds = (stamps - begin * 10**9) * 1e-9
        truth = np.interp(seconds, record.truth.time, record.truth.increments[probe])
        yield gaps - truth - np.mean(gaps - truth)


@pytest.mark.parametrize('noise', [0.1e-6, 0.3e-6, 1e-6])
def test_noise_is_as_strong_as_asked(noise):
    instruments = experiment.Instruments(noise=noise, slow_time=0.2)
    record = record_test(replace(SHORT, instruments=instruments, rate=1000.0))
    for left in residual_noise(record):
        assert np.std(left) == pytest.approx(noise, rel=0.15)


def test_a_part_of_the_noise_is_slow():
    instruments = experiment.Instruments(slow_share=0.9, slow_time=0.3)
    record = record_test(replace(SHORT, instruments=instruments))
    for left in residual_noise(record):
        assert np.mean(left[1:] * left[:-1]) > 0.5 * np.var(left)


def test_no_two_channels_share_their_stamps(short):
    channels = [short.load_stamps, *short.probe_stamps]
    for number, one in enumerate(channels):
        for other in channels[number + 1:]:
            assert len(np.intersect1d(one, other)) < 0.01 * len(one)


def test_stamps_go_forward_with_jitter(short):
    for stamps in (short.load_stamps, *short.probe_stamps):
        steps = np.diff(stamps)
        assert steps.min() > 0
        assert steps.std() > 1e4


def test_the_probes_are_recorded_around_the_whole_load_record(short):
    for stamps in short.probe_stamps:
        assert stamps[0] < short.load_stamps[0]
        assert stamps[-1] > short.load_stamps[-1]


def test_readings_are_steps_of_a_16_bit_converter(short):
    level = RIG.probes.max_range / 2**16
    for gaps in short.gaps:
        assert np.allclose(gaps / level, np.rint(gaps / level), atol=1e-6)
        assert gaps[0] == pytest.approx(1e-3, abs=2e-4)


def test_the_same_seed_gives_the_same_bits_and_another_seed_others(short):
    again, other = record_test(SHORT), record_test(replace(SHORT, seed=9))
    assert np.array_equal(again.load, short.load)
    assert all(np.array_equal(a, b) for a, b in zip(again.gaps, short.gaps, strict=True))
    assert all(np.array_equal(a, b)
               for a, b in zip(again.probe_stamps, short.probe_stamps, strict=True))
    assert not np.array_equal(other.gaps[0][:100], short.gaps[0][:100])


def test_probes_may_run_at_a_rate_of_their_own():
    record = record_test(replace(SHORT, probe_rate=333.0))
    assert len(record.gaps[0]) > 1.5 * len(record.load)


def test_a_bag_holds_what_was_recorded_and_its_log_times_differ_from_its_stamps(short, tmp_path):
    path = experiment.write_record(tmp_path / 'run', short, RIG)
    run = read_run(path)
    assert (run.test, run.elevation) == ('dynamic', pytest.approx(math.radians(50.0)))
    assert np.array_equal(run.load, short.load)
    assert np.array_equal(run.stamps, short.load_stamps)
    assert np.all(np.isfinite(run.gaps))
    raw = read_raw(path)
    assert raw.facts.details['rig_hash'] == RIG.digest
    topic = raw.topics['/rig/eddy_current_1']
    assert np.allclose(topic.values, short.gaps[0], atol=1e-9)
    assert short.log_delay > 1_000_000


def test_a_static_run_has_fifty_one_plateaus(tmp_path):
    schedule = static_schedule(RIG, hold=2.0)
    record = record_test(experiment.TestPlan(PHYSICAL, schedule, seed=1, rate=25.0, step=0.02))
    found = plateaus(read_run(experiment.write_record(tmp_path / 'static', record, RIG)))
    assert len(found) == 51
    assert found.load.max() == pytest.approx(FULL_SCALE_LOAD, abs=500.0)
    assert np.median(np.diff(found.load[1:25])) == pytest.approx(TONNE, rel=0.02)


def test_a_faster_ramp_reaches_the_same_peak():
    slow = dynamic_schedule(RIG, duration=10.0)
    fast = dynamic_schedule(RIG, duration=10.0, speed=4.0)
    assert fast.ramp == pytest.approx(slow.ramp / 4.0)
    assert fast.peak == slow.peak


@pytest.mark.parametrize('make', [
    lambda: static_schedule(RIG, hold=0.0), lambda: static_schedule(RIG, step=-1.0),
    lambda: static_schedule(RIG, hold=1e4), lambda: static_schedule(RIG, peak=1.0),
    lambda: static_schedule(RIG, cycles=0), lambda: dynamic_schedule(RIG, speed=0.0),
    lambda: dynamic_schedule(RIG, duration=float('nan')),
    lambda: replace(SHORT, rate=0.0), lambda: replace(SHORT, seed=-1),
    lambda: replace(SHORT, rate=99e3, schedule=static_schedule(RIG))])
def test_a_test_that_cannot_be_carried_out_is_refused_in_one_line(make):
    with pytest.raises(VirtualRigError) as caught:
        make()
    assert '\n' not in str(caught.value)
