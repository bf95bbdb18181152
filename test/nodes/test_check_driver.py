"""Each fault of a driver is one finding that names the topic and the remedy; a sound one has none.
"""

from collections.abc import Callable
from dataclasses import replace
import subprocess
import sys

import numpy as np
import pytest
from rosnet import ended, wait_until
from test_examples import EXAMPLES, start

from saddlering_ros.doubts import FAULT, NOTE
from saddlering_ros.doubts.driver import check_driver, HeardTopic
from saddlering_ros.record.topics import LOAD, LOAD_TOPIC, PROBE_TOPICS, PROBES
from saddlering_ros.rig import default_rig

RIG = default_rig()
FIRST_PROBE = PROBE_TOPICS[0]
Heard = dict[str, HeardTopic]


@pytest.fixture
def heard_topics(record) -> Heard:
    """What a sound driver publishes while the load goes up and down, 5 ms after measurement."""
    def topic(stamps, values, frame_id, low=np.nan, high=np.nan):
        return HeardTopic(stamps, values, low, high, arrivals=stamps + 5_000_000,
                          frame_id=frame_id)

    found = {LOAD_TOPIC: topic(record.stamps, record.load, LOAD.frame_id)}
    for number, one in enumerate(PROBES):
        found[one.name] = topic(record.probe_stamps[number], record.gaps[number], one.frame_id,
                                RIG.probes.min_range, RIG.probes.max_range)
    return found


def findings(heard: Heard, level: str = FAULT, rate: float | None = None) -> list[str]:
    found = check_driver(RIG, heard, np.radians(50.0), rate)
    return [str(one) for one in found if one.severity == level]


def test_nothing_is_wrong_with_a_sound_driver(heard_topics: Heard) -> None:
    assert findings(heard_topics, rate=500.0) == findings(heard_topics, NOTE) == []


def with_reading(row: int | slice, value: float) -> Callable[[HeardTopic], HeardTopic]:
    def change(one: HeardTopic) -> HeardTopic:
        values = one.values.copy()
        values[row] = value
        return replace(one, values=values)
    return change


def without(start: int, stop: int) -> Callable[[HeardTopic], HeardTopic]:
    def change(one: HeardTopic) -> HeardTopic:
        kept = np.r_[0:start, stop:len(one)]
        return replace(one, stamps=one.stamps[kept], arrivals=one.arrivals[kept],
                       values=one.values[kept])
    return change


@pytest.mark.filterwarnings('error')
@pytest.mark.parametrize(('topic', 'change', 'words'), [
    (LOAD_TOPIC, without(0, 5000), '0 samples came'),
    (LOAD_TOPIC, lambda one: replace(one, publishers=2), '2 publishers'),
    (LOAD_TOPIC, lambda one: replace(one, stamps=0 * one.stamps), 'stamps are not set'),
    (LOAD_TOPIC, lambda one: replace(one, stamps=np.repeat(one.stamps[::10], 10)),
     'each sample of a block with its own time'),
    (LOAD_TOPIC, lambda one: replace(one, stamps=one.stamps[::10].repeat(10) + np.tile(
        1000 * np.arange(10), len(one) // 10)), 'stamps come in blocks, 20.0 ms apart: stamp'),
    (LOAD_TOPIC, lambda one: replace(one, stamps=np.r_[one.stamps[-1:], one.stamps[:-1]]),
     '1 stamp goes back'),
    (FIRST_PROBE, without(500, 600), '1 gap in the stamps, longest 0.202 s'),
    (LOAD_TOPIC, lambda one: replace(one, arrivals=one.arrivals + 90 * 10**9),
     'stamps are 90.0 s behind the clock'),
    (LOAD_TOPIC, lambda one: replace(one, arrivals=one.arrivals[0] + 2 * (
        one.arrivals - one.arrivals[0])), 'the stamps are not times'),
    (FIRST_PROBE, lambda one: replace(one, stamps=one.stamps - 50_000_000), '50 ms older'),
    (FIRST_PROBE, with_reading(700, np.nan), '1 of 2000 readings are not numbers'),
    (LOAD_TOPIC, with_reading(slice(5, None), np.nan), '1995 of 2000 readings are not numbers'),
    (LOAD_TOPIC, with_reading(700, 3e38), 'far beyond the cylinder: publish newtons'),
    (LOAD_TOPIC, with_reading(700, 2.4e5), '1 reading that this rig cannot have'),
    (FIRST_PROBE, lambda one: replace(one, values=np.full(len(one), 1e-3)), 'never changes'),
    (FIRST_PROBE, lambda one: replace(one, values=1e3 * one.values), 'millimetres'),
    (FIRST_PROBE, lambda one: replace(one, high=5e-3), 'its range is 0 to 0.005 m'),
    (FIRST_PROBE, lambda one: replace(one, values=one.values - one.values.min()),
     'at or beyond an end'),
    (LOAD_TOPIC, lambda one: replace(one, values=-one.values), 'publish a pushing load'),
    (LOAD_TOPIC, lambda one: replace(one, values=one.values[::-1] / 1e3), 'kilonewtons')])
def test_a_fault_is_found_in_one_line(heard_topics, topic, change, words) -> None:
    lines = findings({**heard_topics, topic: change(heard_topics[topic])})
    matching = [line for line in lines if words in line]
    assert len(matching) == 1, lines
    assert '\n' not in matching[0]


def test_a_topic_that_nobody_publishes_and_one_of_another_type_are_told_apart(heard_topics):
    nothing = without(0, 5000)(replace(heard_topics[LOAD_TOPIC], publishers=0))
    assert 'it has no publisher' in findings({**heard_topics, LOAD_TOPIC: nothing})[0]
    other = replace(nothing, publishers=1, types=('std_msgs/msg/Float64',))
    assert 'is published as std_msgs/msg/Float64' in findings(
        {**heard_topics, LOAD_TOPIC: other})[0]


def test_a_wrong_polarity_and_swapped_channels_are_found_once_the_load_has_moved(heard_topics):
    first, second, third = (heard_topics[name] for name in PROBE_TOPICS[:3])
    turned = replace(first, values=2e-3 - first.values)
    assert 'polarity' in findings({**heard_topics, FIRST_PROBE: turned})[0]
    swapped = {PROBE_TOPICS[1]: replace(second, values=third.values),
               PROBE_TOPICS[2]: replace(third, values=second.values)}
    assert 'swapped' in findings({**heard_topics, **swapped})[0]


@pytest.mark.parametrize(('factor', 'unit'), [(4.4482216, 'lbf'), (10.0, 'kgf or daN')])
def test_a_load_whose_preload_is_that_of_another_unit_is_noted(heard_topics, factor, unit):
    load = heard_topics[LOAD_TOPIC]
    noted = findings(
        {**heard_topics, LOAD_TOPIC: replace(load, values=load.values / factor)}, NOTE)
    assert f'which is the preload in {unit} (4903 N): publish newtons' in noted[0]


def test_what_cannot_be_checked_at_rest_is_noted(heard_topics: Heard) -> None:
    at_rest = {name: without(350, 5000)(one) for name, one in heard_topics.items()}
    assert findings(at_rest) == []
    assert 'move it by 2.5 t' in findings(at_rest, NOTE)[0]


def test_a_topic_that_comes_in_blocks_beside_others_is_of_the_same_clock(heard_topics) -> None:
    def in_blocks(one: HeardTopic, size: int) -> HeardTopic:
        last = np.minimum(np.arange(len(one)) // size * size + size, len(one)) - 1
        return replace(one, arrivals=one.arrivals[last])

    blocks = {LOAD_TOPIC: in_blocks(heard_topics[LOAD_TOPIC], 50)}
    assert findings({**heard_topics, **blocks}) == []


def test_samples_that_waited_for_the_listener_are_no_fault_of_the_stamps(heard_topics) -> None:
    """On a busy machine: stamps advance by 1.17 s in 1 s."""
    late = {name: replace(one, arrivals=np.maximum(one.arrivals, one.arrivals[400]))
            for name, one in heard_topics.items()}
    assert findings(late) == []


def test_a_rate_other_than_the_one_wanted_is_a_fault(heard_topics: Heard) -> None:
    assert 'comes at 500 Hz, and 1000 Hz is required' in findings(heard_topics, rate=1000.0)[0]


@pytest.mark.ros
def test_the_example_driver_is_sound_and_makes_its_nodes_ready_to_test(
        group, heard, ros_domain, tmp_path):
    slow = tmp_path / 'rig_driver.py'  # its own rate takes more than a busy machine may have
    slow.write_text((EXAMPLES / slow.name).read_text().replace('RATE = 200', 'RATE = 40'))

    def checked() -> subprocess.CompletedProcess[str]:
        return subprocess.run(
            [sys.executable, '-m', 'saddlering_ros.cli.main', 'check-driver', '--seconds', '1',
             '--domain', str(ros_domain), '--rate', '40'],
            env=group.environment, capture_output=True, text=True, timeout=120.0, check=False)

    group.start('ring_displacement')
    group.start('ring_residual', {'needed_nodes': ['ring_displacement']})
    wait_until(lambda: 'nothing received yet' in heard.diagnostics.get(
        'ring_residual: ready to test', (0, ''))[1], 120.0, 'not ready: no samples')
    with start(group, str(slow)) as driver, ended(driver):
        wait_until(lambda: heard.diagnostics.get('ring_residual: ready to test') == (
            0, 'ready to test'), 120.0, 'ready')
        wait_until(lambda: checked().returncode == 0, 120.0, 'nothing is wrong with the driver')
        driver.terminate()
        assert driver.wait(30.0) == 0
