"""The displacement a run measured: known motion comes back, zeroed near the preload."""

import numpy as np
import pytest

from saddlering_ros.bags.reader import bag_info, read_run
from saddlering_ros.record.displacement import displacement_of_run
from saddlering_ros.record.topics import PROBE_TOPICS
from saddlering_ros.rig import default_rig

RIG = default_rig()


def test_a_known_motion_is_measured(tmp_path, moved):
    recording, motion = moved
    run = read_run(recording.write(tmp_path / 'bag'))
    measured = displacement_of_run(RIG, run)
    at_zero = slice(measured.zero.start, measured.zero.end)
    for name in ('delta_x', 'delta_y', 'gamma', 'parity'):
        true = getattr(motion, name)
        np.testing.assert_allclose(
            getattr(measured.displacement, name), true - true[at_zero].mean(), atol=1e-9)
    assert measured.complete.all()


def test_zero_is_taken_near_the_preload_and_counted_in_load_samples(tmp_path, moved):
    recording, _ = moved
    late = PROBE_TOPICS[3]
    recording = recording.changed(late, recording.stamps[late][20:], recording.values[late][20:])
    run = read_run(recording.write(tmp_path / 'bag'))
    measured = displacement_of_run(RIG, run)
    assert measured.zero.near_preload
    assert measured.zero.start == 20
    window = slice(measured.zero.start, measured.zero.end)
    np.testing.assert_allclose(measured.zero.gaps, run.gaps[:, window].mean(axis=1), rtol=1e-12)
    assert measured.zero.load == pytest.approx(run.load[window].mean())


def test_where_a_probe_is_silent_nothing_is_measured(tmp_path, moved):
    recording, _ = moved
    kept = np.delete(np.arange(1000), np.arange(500, 600))
    silent = PROBE_TOPICS[0]
    recording = recording.changed(
        silent, recording.stamps[silent][kept], recording.values[silent][kept])
    bag = recording.write(tmp_path / 'bag')
    run, info = read_run(bag), bag_info(bag)
    measured = displacement_of_run(RIG, run)
    (topic,) = [one for one in info.topics if one.gaps]
    assert (topic.topic, topic.gaps) == (silent, 1)
    assert topic.longest_gap == pytest.approx(101 * 0.002, rel=1e-3)
    assert np.flatnonzero(~measured.complete).tolist() == list(range(500, 600))
    assert np.isnan(measured.displacement.delta_x[500:600]).all()
    assert np.isfinite(measured.displacement.delta_y).all()
    assert any('1 gap in' in note for note in run.notes)
