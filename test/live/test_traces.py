"""Claims about streams kept as few points: nothing that stands out is lost, nothing grows."""

import numpy as np
import pytest

from saddlering_ros.live.traces import Traces
from saddlering_ros.live.watcher import doubt_words, missing_words

SECOND = 1_000_000_000
SCALES = {'load': 1.0, 'measured': 1.0}
CHANNELS = {'load': 1, 'measured': 2}


def pushed(traces, start, seconds, rate=1000, spike=None):
    stamps = start + (np.arange(int(seconds * rate)) * (SECOND // rate)).astype(np.int64)
    values = np.stack([np.sin(stamps / SECOND), np.zeros(len(stamps))])
    if spike is not None:
        values[1, spike] = 7.0
    for part in np.array_split(np.arange(len(stamps)), max(1, len(stamps) // 50)):
        traces.push('measured', stamps[part], values[:, part])
    return stamps, values


def test_a_single_sample_that_stands_out_is_still_there_after_minutes():
    traces = Traces(CHANNELS, limit=200)
    pushed(traces, 10 * SECOND, 60.0, spike=1234)
    found = traces.current.since(-1, SCALES)['measured']
    assert max(found['high'][1]) == 7.0
    assert len(found['cell']) <= 200


def test_means_of_cells_are_the_means_of_their_samples():
    traces = Traces(CHANNELS, limit=100)
    stamps, values = pushed(traces, 0, 10.0)
    found = traces.current.since(-1, SCALES)['measured']
    number = stamps // traces.width
    expected = [values[0, number == cell].mean() for cell in found['cell']]
    assert np.allclose(found['mean'][0], expected, atol=1e-4)


def test_what_is_older_than_the_window_is_dropped():
    traces = Traces(CHANNELS, limit=100, window=5.0)
    pushed(traces, 0, 60.0, rate=100)
    found = traces.current.since(-1, SCALES)['measured']
    cells = np.array(found['cell']) * traces.width / SECOND
    assert cells.max() > 59.8
    assert cells.min() >= 54.0
    assert len(cells) <= 120


def test_only_what_changed_is_said_again_and_adds_up_to_everything():
    traces = Traces(CHANNELS, limit=5000)
    kept, turn = {}, -1
    for part in range(5):
        pushed(traces, part * SECOND // 2, 0.5)
        new = traces.current.since(turn, SCALES).get('measured', {'cell': []})
        assert len(new['cell']) <= 52
        kept.update(zip(new['cell'], zip(*new['mean'], strict=True), strict=True))
        turn = traces.turn
    whole = traces.current.since(-1, SCALES)['measured']
    assert kept == dict(zip(whole['cell'], zip(*whole['mean'], strict=True), strict=True))
    assert traces.current.since(turn, SCALES) == {}


def test_a_replay_that_starts_again_is_drawn_anew_and_late_samples_are_not():
    traces = Traces(CHANNELS, limit=500)
    pushed(traces, 100 * SECOND, 3.0)
    version = traces.version
    pushed(traces, 102 * SECOND + SECOND * 9 // 10, 0.05)
    assert traces.version == version
    pushed(traces, 100 * SECOND, 0.5)
    assert traces.version > version
    assert traces.current.since(-1, SCALES)['measured']['cell'][-1] * traces.width < SECOND


def test_streams_drained_one_after_another_are_one_replay():
    traces = Traces(CHANNELS)
    stamps = np.arange(0, 5 * SECOND, SECOND // 100)
    for start in (50 * SECOND, 0):
        traces.push('load', start + stamps[:400], np.ones((1, 400)))
        if start == 0:
            traces.push('measured', 50 * SECOND + stamps[400:], np.ones((2, 100)))
        traces.push('measured', start + stamps[:400], np.ones((2, 400)))
        found = traces.current.since(-1, SCALES)
        assert found['load']['cell'] == found['measured']['cell']
        assert len(found['load']['cell']) == 400


def test_a_test_ten_minutes_after_another_is_drawn_alone_and_as_finely():
    traces = Traces(CHANNELS)
    pushed(traces, 50 * SECOND, 10.0)
    late = 650 * SECOND
    traces.push('load', late + np.arange(1000) * SECOND // 100, np.ones((1, 1000)))
    traces.push('measured', 60 * SECOND + np.arange(50) * SECOND // 100, np.ones((2, 50)))
    pushed(traces, late, 10.0)
    found = traces.current.since(-1, SCALES)
    assert [len(found[name]['cell']) for name in SCALES] == [1000, 1000]
    assert found['measured']['cell'][-1] * traces.width < 10 * SECOND
    assert traces.received == {'load': 1000, 'measured': 10000}
    before, = traces.past
    assert (before.number, traces.current.number) == (1, 2)
    assert len(before.since(-1, SCALES)['measured']['cell']) == 1000
    assert before.peaks['measured'][0] == pytest.approx([-1.0, 1.0], abs=1e-4)
    assert traces.left_out == 50


def test_a_batch_that_holds_the_end_of_one_test_and_the_start_of_the_next_is_parted():
    for later in (-600, 600):
        traces = Traces(CHANNELS)
        stamps = 1000 * SECOND + np.arange(100) * SECOND // 100
        traces.push('load', np.append(stamps, stamps + later * SECOND), np.ones((1, 200)))
        found = traces.current.since(-1, SCALES)['load']
        assert traces.received['load'] == len(found['cell']) == 100


def test_a_test_announced_a_few_seconds_after_another_is_drawn_alone_from_its_first_sample():
    traces = Traces(CHANNELS)
    pushed(traces, 50 * SECOND, 5.0)
    traces.begin(58 * SECOND, 63 * SECOND)
    pushed(traces, 58 * SECOND, 5.0)
    traces.begin(58 * SECOND, 63 * SECOND)
    assert traces.received['measured'] == 5000
    assert len(traces.current.since(-1, SCALES)['measured']['cell']) == 500


def test_samples_that_the_nodes_published_and_the_page_has_not_are_counted():
    assert missing_words({'load': 5, 'measured': 9}, {'load': 5, 'measured': 8}) == ''
    assert missing_words({'load': 5, 'measured': 8400}, {'load': 5, 'measured': 10000}) == (
        '1600 of 10000 samples of measured')


def test_samples_that_are_no_numbers_are_left_out():
    traces = Traces(CHANNELS)
    traces.push('measured', np.array([0, 1]), np.array([[1.0, np.nan], [1.0, 1.0]]))
    assert traces.current.since(-1, SCALES)['measured']['mean'] == [[1.0], [1.0]]


def test_a_channel_that_is_not_known_leaves_the_others_drawn():
    traces = Traces(CHANNELS, limit=5000)
    stamps = np.arange(1000, dtype=np.int64) * SECOND // 1000
    values = np.stack([np.ones(1000), np.ones(1000)])
    values[1, 500:] = np.nan
    traces.push('measured', stamps, values)
    found = traces.current.since(-1, SCALES)['measured']
    assert found['mean'][0] == [1.0] * 100
    assert found['mean'][1] == [1.0] * 50 + [None] * 50
    assert found['low'][1] == found['high'][1] == found['mean'][1]
    assert np.isnan(traces.means('measured')[1, 50:]).all()


def test_what_is_not_known_of_a_residual_is_said_beside_it():
    assert doubt_words(np.array([0, 0], np.uint8)) == ''
    assert doubt_words(np.array([0, 6], np.uint8)) == 'not known: delta_y, gamma'
    assert doubt_words(np.array([16, 0], np.uint8)) == 'interpolated across a refused reading'
