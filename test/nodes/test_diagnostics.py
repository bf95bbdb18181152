"""What nodes report of their health counts for the period reported, and names its own things."""

from contextlib import nullcontext
from dataclasses import replace
import re
import time
from types import SimpleNamespace
from typing import Any

from geometry_msgs.msg import WrenchStamped
import numpy as np
import pytest
from rclpy.qos import ReliabilityPolicy
from rclpy.time import Time
from rosnet import Client, Driver, wait_until
from std_srvs.srv import Trigger

from saddlering_interfaces.action import IdentifyRing
from saddlering_interfaces.msg import RingParameters
from saddlering_ros.jobs.action_server import ActionNode
from saddlering_ros.jobs.requests import Answer
from saddlering_ros.jobs.worker import DONE, FAILED, REFUSED
from saddlering_ros.monitoring.monitor import Lapse
from saddlering_ros.nodes.replay_clock import ReplayClockNode
from saddlering_ros.nodes.ring_alarm import RingAlarmNode
from saddlering_ros.nodes.ring_displacement import RingDisplacementNode
from saddlering_ros.record.batches import ANY_TIME, SECOND
from saddlering_ros.record.displacement import DisplacementStream
from saddlering_ros.record.guard import load_limits, SampleGuard, Samples
from saddlering_ros.record.topics import LOAD_TOPIC, PROBE_TOPICS
from saddlering_ros.rig import default_rig, ParameterSet, ParameterSource, TRUE_TO_SCALE
from saddlering_ros.rig.drawing import dotted, entry_values
from saddlering_ros.ros import diagnostics
from saddlering_ros.ros.diagnostics import (
    ERROR,
    Events,
    Namesakes,
    OK,
    SilentStreams,
    StreamTask,
    WARN,
)
from saddlering_ros.ros.launcher import NodeGroup
from saddlering_ros.ros.messages import to_stamp
from saddlering_ros.ros.names import NodeError
from saddlering_ros.ros.parameters import rig_words
from saddlering_ros.ros.raw_topics import RawSubscription
from saddlering_ros.ros.streaming_node import StreamingNode

START, MS = 10**18, 1_000_000
WRENCH = 'geometry_msgs/msg/WrenchStamped'


def test_the_longest_gap_is_that_of_the_period_and_a_stamp_of_0_makes_none() -> None:
    task = StreamTask('/rig/hydraulic_load')
    stamps = START + MS * np.arange(100)
    task.push(np.append(stamps, 0))
    task.push(stamps[-1] + MS * np.array([1, 2, 502, 503]))
    first = task.report(1.0)
    assert (first.level, first.figures['longest gap of this period [s]']) == (WARN, '0.5')
    task.push(stamps[-1] + MS * np.arange(504, 600))
    second = task.report(1.0)
    assert (second.level, second.figures['longest gap of this period [s]']) == (OK, '0')


def test_the_next_test_at_another_rate_has_no_gaps() -> None:
    task = StreamTask('/rig/hydraulic_load')
    task.push(START + MS * np.arange(1000))
    task.report(1.0)
    for stamp in START + 1000 * MS + 40 * MS * np.arange(25):
        task.push(np.array([stamp]))
    found = task.report(1.0)
    assert (found.level, found.figures['period by stamps [ms]']) == (OK, '40')


@pytest.mark.parametrize(('pause', 'words'), [(100, '100.0'), (4, '3.99')])
def test_stamps_in_blocks_are_told_as_such_and_not_as_gaps(pause: int, words: str) -> None:
    """Commands refuse the record; live, pauses of 4 ms were sound and those of 100 ms gaps."""
    task = StreamTask('/rig/hydraulic_load')
    task.push((START + pause * MS * np.arange(20)[:, None] + 1000 * np.arange(10)).ravel())
    found = task.report(1.0)
    assert (found.level, found.words) == (WARN, (
        f'stamps come in blocks, {words} ms apart: stamp each sample when it is taken and not '
        'when its block arrives'))


def test_samples_of_a_block_with_one_stamp_are_told_with_what_to_do() -> None:
    """The stream was sound, and the events were "900 duplicates"."""
    task = StreamTask('/rig/eddy_current_1')
    task.push(np.repeat(START + 20 * MS * np.arange(50), 10))
    found = task.report(1.0)
    assert (found.level, found.words) == (WARN, (
        '450 of 499 samples have the stamp of the one before: stamp each sample of a block with '
        'its own time'))


def test_a_reading_that_is_no_number_is_not_at_an_end_of_the_range() -> None:
    task = diagnostics.SaturationTask('/rig/eddy_current_1', 0.0, 2e-3)
    task.push(np.array([1e-3, np.nan, np.inf]))
    assert task.report(1.0).level == OK


@pytest.mark.parametrize(('factor', 'words'), [
    (1e3, ' and look like millimetres'), (1.0, ''), (float(np.float32(2e-3)) / 1.1e-3, '')])
def test_readings_at_the_end_of_the_range_are_told_with_the_unit_that_they_look_like(
        factor: float, words: str) -> None:
    task = diagnostics.SaturationTask('/rig/eddy_current_1', 0.0, 2e-3)
    task.push(factor * np.array([1e-3, 1.1e-3, 2e-3]))
    found = task.report(1.0)
    assert found.level == ERROR
    assert f"an end of the probe's range{words}: check position and unit" in found.words


def test_a_refused_reading_is_a_warning_of_the_same_period_and_of_no_later_one() -> None:
    guard = SampleGuard(load_limits(default_rig()))
    events = Events(lambda: vars(guard.counters))
    assert events.report(1.0).level == OK
    guard.push(Samples(START + MS * np.arange(3), np.array([1e5, 3e38, 1e5])))
    found = events.report(1.0)
    assert (found.level, found.words) == (WARN, '1 impossible')
    later = events.report(1.0)
    assert (later.level, later.figures['impossible']) == (OK, '1')
    assert later.words == ('nothing lost, late or dropped since the last report; before, '
                           '1 impossible')


def test_a_refused_reading_is_told_with_its_topic_and_the_limit_that_it_passed(record) -> None:
    """'1 impossible' told neither which of five topics it was nor what is possible."""
    stream = DisplacementStream(default_rig())
    gaps = [record.gaps[0], np.where(np.arange(len(record.stamps)) == 9, 1.0, record.gaps[1]),
            *record.gaps[2:]]
    flows = [SimpleNamespace(topic=f'/rig1{topic}', malformed=0)
             for topic in (LOAD_TOPIC, *PROBE_TOPICS)]
    node: Any = SimpleNamespace(inputs=flows)
    events = StreamingNode.events(node, stream.events, guards=stream.guards)
    events.report(1.0)
    stream.push(Samples(record.stamps, np.where(record.stamps == record.stamps[7], np.nan,
                                                record.load)),
                [Samples(*pair) for pair in zip(record.probe_stamps, gaps, strict=True)])
    flows[3].malformed = 2
    found = events.report(1.0)
    assert found.words == ('1 not finite (/rig1/rig/hydraulic_load), 1 impossible '
                           '(/rig1/rig/eddy_current_2: limits -2.00 mm and 4.00 mm), '
                           '1 before probes, 2 malformed (/rig1/rig/eddy_current_3)')
    assert (found.figures['impossible'], found.figures['impossible on '
            '/rig1/rig/eddy_current_2: limits -2.00 mm and 4.00 mm']) == ('1', '1')
    assert 'impossible' in events.report(1.0).words


def test_every_parameter_of_the_rig_has_a_text_of_its_own() -> None:
    texts = [rig_words(name) for name in dotted(default_rig(), entry_values(default_rig()))]
    assert len(set(texts)) == len(texts)


def test_what_may_be_set_while_active_takes_effect_and_the_clock_does_not_hear_itself() -> None:
    changeable = {parameter.name for node in (ReplayClockNode, RingDisplacementNode)
                  for parameter in node.PARAMETERS if parameter.changeable}
    assert {'window', 'parity_noise'} <= changeable
    assert not ReplayClockNode.TELLS_PROGRESS


def test_a_probe_that_does_not_read_is_told_with_the_channels_that_it_costs() -> None:
    """A probe that began after the zero was among "all four read", and the rig was ready."""
    zero = SimpleNamespace(reading=SimpleNamespace(gaps=(1e-3, np.nan, 1e-3, 1e-3)))
    for missing, words in (([2, 0, 0, 0], 'probe 1 does not read, delta_x unknown'),
                           ([0, 3, 0, 1], 'probes 2 and 4 do not read, delta_y and gamma unknown'),
                           ([5] * 4, 'no probe reads at the stamps of the load, and nothing is '
                                     'published'),
                           ([0] * 4, 'probe 2 did not read at the zero, delta_y and gamma unknown')
                           ):
        node: Any = SimpleNamespace(
            _rig=default_rig(), _since_zero=diagnostics.Kept(), _told_rows=0,
            _stream=SimpleNamespace(take_missing=lambda missing=missing: missing, zero=zero,
                                    rows=9))
        found = RingDisplacementNode._probes_status(node)
        assert (found.level, found.words.partition(':')[0]) == (ERROR, words)


def test_no_probe_is_said_to_read_before_the_first_reading_or_after_the_last() -> None:
    node: Any = SimpleNamespace(
        _rig=default_rig(), _since_zero=diagnostics.Kept(), _told_rows=0,
        _stream=SimpleNamespace(take_missing=lambda: [0] * 4, zero=None, rows=0))
    words = []
    for node._stream.rows in (0, 9, 18, 18):
        words.append(RingDisplacementNode._probes_status(node).words)
    assert words == ['no readings in this period', *['all four read'] * 2,
                     'no readings in this period']


@pytest.mark.ros
def test_a_reversed_probe_is_told_while_the_load_moves_and_forgotten_with_the_zero(
        group: NodeGroup, heard: Client, record) -> None:
    """Its displacement is wrong, and the commands tell it of the bag afterwards only."""
    group.start('ring_displacement', {'elevation_deg': 50.0})
    driver = Driver(heard)
    wait_until(lambda: driver.matched(1), 80.0, 'all are matched')
    first, reversed_, third, fourth = record.gaps
    reversed_ = 2.0 * reversed_[0] - reversed_
    driver.send(replace(record, gaps=[first, reversed_, third, fourth]), slice(0, 1000))

    def told() -> tuple[int, str]:
        return heard.diagnostics.get('ring_displacement: probes', (0, ''))

    wait_until(lambda: told()[0] == WARN, what='it is told')
    assert told()[1].startswith('wrong polarity of probe 2 (rig.probes.polarity): µm per')
    driver.send(record.later(100.0), slice(0, 1000))
    wait_until(lambda: told()[0] == OK, what='another zero')


@pytest.mark.parametrize(('silent', 'is_paused', 'words'), [
    ((), False, ''), (('load',), True, ''),
    (('load', 'probe'), False, 'no samples come on /load, /probe: start the driver or the replay, '
                               'then call ~/zero again'),
    (('probe',), False, 'no samples come on /probe: start'),
    (None, False, 'load and probes come without a common stamp: correct their clocks (status '
                  'clocks), then call ~/zero again')])
def test_a_zero_is_refused_while_nothing_comes_of_which_it_could_be_taken(
        silent: tuple[str, ...] | None, is_paused: bool, words: str) -> None:
    """It was promised 'from the first steady stretch', of a driver that had ended."""
    now = time.monotonic()
    node: Any = SimpleNamespace(
        inputs=[SimpleNamespace(topic=f'/{name}', heard=now - 9.0 * (name in (silent or ())))
                for name in ('load', 'probe')])
    given_at = now - 9.0 * (silent is None or bool(silent))

    def asked() -> None:
        StreamingNode.refuse_silence(node, given_at, is_paused)

    with (pytest.raises(NodeError, match='^' + re.escape(words)) if words else nullcontext()):
        asked()


@pytest.mark.ros
@pytest.mark.parametrize('name', ['ring_displacement', 'ring_simulator'])
def test_a_zero_is_refused_before_anything_has_come(name, group, heard) -> None:
    group.start(name, {'elevation_deg': 50.0})
    wait_until(lambda: heard.diagnostics.get(f'{name}: state') == (OK, 'active'), 80.0, 'active')
    answer = heard.call(Trigger, f'/{name}/zero')
    assert not answer.success
    assert answer.message.startswith('no samples come on /rig/hydraulic_load')


def test_a_lapse_of_the_promise_is_a_warning_for_some_seconds_or_for_good() -> None:
    def level(age: int, is_lasting: bool) -> int:
        monitor = SimpleNamespace(stamp=START, lapses=[Lapse(START - age, 'a pause', is_lasting)])
        node: Any = SimpleNamespace(_stream=SimpleNamespace(monitor=monitor),
                                    settings={'false_alarm_hours': 1000.0})
        return RingAlarmNode._promise_status(node).level

    assert [level(9 * SECOND, False), level(11 * SECOND, False), level(11 * SECOND, True)] == [
        WARN, OK, WARN]


def test_a_goal_that_cannot_be_used_is_no_fault_of_the_server() -> None:
    quiet = SimpleNamespace(info=lambda words: None)
    for kind, level in ((REFUSED, OK), (FAILED, ERROR)):
        server: Any = SimpleNamespace(get_logger=lambda: quiet)
        goal: Any = SimpleNamespace(abort=lambda: None)
        result = IdentifyRing.Result()
        ActionNode._end(server, goal, (kind, 'why'), result)
        assert (server._level, result.message) == (level, 'why')
        assert result.status == getattr(result, kind.upper())


def test_found_parameters_have_the_time_of_the_machine_beside_a_replay_too() -> None:
    """Simulators take the newest offer, and the clock of a replay begins again with its bag."""
    offered: list[RingParameters] = []
    server: Any = SimpleNamespace(
        get_logger=lambda: SimpleNamespace(info=lambda words: None),
        get_clock=lambda: SimpleNamespace(now=lambda: Time(seconds=1)),
        fill=lambda result, answer: None, _found=SimpleNamespace(publish=offered.append))
    goal: Any = SimpleNamespace(succeed=lambda: None)
    law = ParameterSet(TRUE_TO_SCALE, source=ParameterSource(method='default'))
    ActionNode._end(server, goal, (DONE, Answer('found', law, {})), IdentifyRing.Result())
    assert abs(to_stamp(offered[0].header.stamp) - time.time_ns()) < 60 * SECOND


@pytest.mark.parametrize(('wanted', 'reliability', 'kind', 'words'), [
    ('auto', ReliabilityPolicy.BEST_EFFORT, WRENCH, ''),
    ('reliable', ReliabilityPolicy.RELIABLE, WRENCH, ''),
    ('reliable', ReliabilityPolicy.BEST_EFFORT, WRENCH,
     'rig/hydraulic_load: a publisher offers best effort only, of which a subscription with '
     'input_reliability reliable gets nothing: set input_reliability to auto'),
    ('auto', ReliabilityPolicy.BEST_EFFORT, 'std_msgs/msg/Float64',
     f'rig/hydraulic_load: is published as std_msgs/msg/Float64: publish {WRENCH}')])
def test_a_publisher_that_a_node_cannot_hear_is_told_once_in_its_log_and_on_diagnostics(
        wanted: str, reliability: ReliabilityPolicy, kind: str, words: str) -> None:
    logged: list[str] = []
    info = SimpleNamespace(topic_type=kind, qos_profile=SimpleNamespace(reliability=reliability))
    subscription = SimpleNamespace(handle=None, get_publisher_count=lambda: 0)
    node: Any = SimpleNamespace(
        resolve_topic_name=lambda name: name, destroy_subscription=lambda _: None,
        create_subscription=lambda *_, **options: subscription,
        get_publishers_info_by_topic=lambda topic: [info],
        get_logger=lambda: SimpleNamespace(warning=logged.append, info=lambda words: None))
    node.inputs = [RawSubscription(node, 'rig/hydraulic_load', WrenchStamped, reliability=wanted)]
    for _ in range(3):
        node.inputs[0].review()
    found = StreamingNode.sources(node).report(1.0)
    assert (found.level, found.words) == ((WARN, words) if words else (OK, 'one at most'))
    assert logged == ([words] if words else [])


def test_a_topic_of_another_name_that_is_not_heard_is_told_with_that_name() -> None:
    """A node told '/rig/hydraulic_load: nothing received yet' where it read /daq/load."""
    node: Any = SimpleNamespace(
        resolve_topic_name=lambda name: '/daq/load', create_subscription=lambda *_, **options:
        SimpleNamespace(handle=None))
    task = StreamTask('/rig/hydraulic_load')
    assert task.report(1.0).words == 'nothing received yet'
    RawSubscription(node, 'rig/hydraulic_load', WrenchStamped, task=task)
    assert task.report(1.0).words == 'nothing received yet on /daq/load'


@pytest.mark.parametrize(('load', 'probe', 'told'), [
    # The probe is silent for one period, then for three; at last the test is over.
    ('yyyyyyyyn', 'yynynnnyn', {5: '/rig/probe_1: no messages, while those of other topics come',
                                7: '/rig/probe_1: messages come again'}),
    # Two tests with a pause; the load goes on for a period longer, and begins one earlier.
    ('yyynnyyy', 'yynnnnyy', {})])
def test_a_stream_that_falls_silent_beside_others_is_told_once_and_so_is_its_return(
        load, probe, told) -> None:
    logged: list[str] = []
    node: Any = SimpleNamespace(get_logger=lambda: SimpleNamespace(
        warning=logged.append, info=logged.append))
    silent, streams = SilentStreams(node), [StreamTask('/rig/load'), StreamTask('/rig/probe_1')]
    for second, both in enumerate(zip(load, probe, strict=True)):
        for task, comes in zip(streams, both, strict=True):
            if comes == 'y':
                task.push(START + second * SECOND + MS * np.arange(100))
        silent.review([(task, task.report(1.0)) for task in streams])
        assert len(logged) == sum(second >= since for since in told)
    assert all(map(str.startswith, logged, told.values()))


@pytest.mark.parametrize('running', [1, 2])
def test_a_node_that_has_left_is_no_namesake_though_the_middleware_still_names_it(running):
    logged: list[str] = []
    node: Any = SimpleNamespace(
        get_name=lambda: 'a_node', get_namespace=lambda: '/rig',
        get_fully_qualified_name=lambda: '/rig/a_node',
        get_node_names_and_namespaces=lambda: [('a_node', '/rig')] * 2,
        count_services=lambda name: running * (name == '/rig/a_node/get_parameters'),
        get_logger=lambda: SimpleNamespace(warning=logged.append))
    namesakes = Namesakes(node)
    words = [namesakes.words() for _ in range(2)]
    assert [bool(said) for said in words] == [running == 2] * 2
    assert len(logged) == running - 1


ONE_CLOCK = 'no difference between load and probes is seen'


@pytest.mark.parametrize(('behind', 'apart', 'words'), [
    (0.005, 0.0, ONE_CLOCK),
    (0.005, 0.2, '/rig/eddy_current_1: stamps are 200 ms older than those of the load that arrive '
                 'with them: use one clock for both, and stamp with the time of measurement; 3 '
                 'more topics likewise'),
    (0.005, -0.2, '/rig/eddy_current_1: stamps are 200 ms younger'),
    (5.0, 5.0, '/rig/hydraulic_load: stamps are 5.00 s behind the clock of this machine: '
               'synchronise the clocks (chrony, PTP), or stamp in UTC; 4 more topics likewise '
               '(if ros2 bag play sends them: start it with --clock, and the nodes with -p '
               'use_sim_time:=true)'),
    (-7200.0, 0.0, '/rig/hydraulic_load: stamps are 2.00 h ahead of the clock of this machine'),
    (1e8, 0.2, '/rig/hydraulic_load: stamps are 1157 d behind')])
@pytest.mark.parametrize('replayed', ['', 'by the suite', 'by another player', 'before'])
def test_a_clock_of_the_probes_apart_from_that_of_the_load_is_told(
        behind: float, apart: float, words: str, replayed: str, monkeypatch: pytest.MonkeyPatch,
        ) -> None:
    topics = (LOAD_TOPIC, *PROBE_TOPICS)
    node: Any = SimpleNamespace(
        _streams=[StreamTask(topic) for topic in topics],
        _watch=SimpleNamespace(recording={
            'by the suite': (START, START + SECOND), 'before': (START - SECOND, START - MS),
        }.get(replayed, ANY_TIME)),
        get_parameter=lambda _: SimpleNamespace(value=replayed == 'by another player'))
    if replayed.startswith('by') and abs(behind) > 1.0:
        words = ONE_CLOCK  # the time of arrival tells nothing
    stamps = START + MS * np.arange(100)
    now = iter(np.repeat(stamps + round(behind * SECOND), len(topics)).tolist())
    monkeypatch.setattr(time, 'time_ns', lambda: next(now))
    for stamp in stamps:
        for topic, task in zip(topics, node._streams, strict=True):
            task.push(np.array([stamp - (topic in PROBE_TOPICS) * round(apart * SECOND)]))
    for task in node._streams:
        task.report(1.0)
    found = RingDisplacementNode._clocks_status(node)
    assert found.words.startswith(words)
    assert found.level == (OK if words == ONE_CLOCK else WARN)
