"""Replay by hand: play, pause, step, seek, rate; and what happens when a node falls out."""

from pathlib import Path
import re
import shutil
import socket
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from rosgraph_msgs.msg import Clock
from rosnet import ANEW, Client, lead, set_parameter, wait_until
from std_srvs.srv import Trigger

from saddlering_interfaces.msg import ReplayProgress, ReplayState
from saddlering_interfaces.srv import Seek, SetRate, Step
from saddlering_ros.nodes.replay_clock import shortest_time_of
from saddlering_ros.ros.bag_replay import ReplayNode
from saddlering_ros.ros.launcher import NodeGroup, start_nodes
from saddlering_ros.ros.messages import LockstepGroup, SPECTATOR_LEASE, to_time
from saddlering_ros.ros.names import CLOCK, NodeError, PROGRESS
from saddlering_ros.ros.raw_topics import RawPublisher

pytestmark = pytest.mark.ros


def test_a_replay_can_be_paused_stepped_sought_and_outlives_a_node(
        bag: Path, record, ros_domain: int, heard: Client, tmp_path: Path) -> None:
    states = heard.listen(ReplayState, '/replay/state')
    with start_nodes(bag, domain_id=ros_domain, log_folder=tmp_path / 'log', start_paused=True,
                     exit_at_end=False, nodes=('ring_displacement',),
                     parameters={'replay_clock': {'timeout': 1.0}}) as group:
        topic = '/ring/displacement'
        wait_until(lambda: heard.matched((topic,)) and bool(states)
                   and states[-1].state == ReplayState.PAUSED, 80.0, 'everyone is there')
        assert not heard.heard(topic).stamps.size

        assert not heard.call(Step, '/replay_clock/step', Step.Request(duration=-1.0)).success

        # One second of bag time, no more: the rows up to there, but for the last one or two.
        assert heard.call(Step, '/replay_clock/step', Step.Request(duration=1.0)).success
        wait_until(lambda: len(heard.heard(topic)) >= 498, what='one second of rows')
        assert heard.heard(topic).stamps[-1] <= record.stamps[0] + 10**9
        assert not heard.call(Seek, '/replay_clock/seek', Seek.Request(offset=99.0)).success
        below_zero = SetRate.Request(rate=-1.0)
        assert not heard.call(SetRate, '/replay_clock/set_rate', below_zero).success
        # So slow that the bag does not end before it is paused, however late the pause comes.
        assert heard.call(SetRate, '/replay_clock/set_rate', SetRate.Request(rate=0.01)).success

        # Back to the start: the same rows again, zeroed anew.
        before = heard.heard(topic)
        heard.forget()
        assert heard.call(Seek, '/replay_clock/seek', Seek.Request(offset=0.0)).success
        assert heard.call(Trigger, '/replay_clock/play').success
        assert heard.call(Trigger, '/replay_clock/pause').success
        wait_until(lambda: states[-1].state == ReplayState.PAUSED, what='it pauses')
        assert heard.call(Trigger, '/replay_clock/play').success
        assert not heard.call(Step, '/replay_clock/step').success  # pause first
        assert heard.call(SetRate, '/replay_clock/set_rate', SetRate.Request(rate=0.0)).success
        wait_until(lambda: states[-1].state == ReplayState.FINISHED, 60.0, 'the end')
        wait_until(lambda: len(heard.heard(topic)) >= 1999, what='all rows')
        again = heard.heard(topic)
        assert again.stamps[0] <= before.stamps[0] + 2_000_000
        assert again.stamps[-1] >= record.stamps[-2]

        # A node is killed: the replay says so, and goes on without it.
        assert not heard.call(Trigger, '/replay_clock/play').success
        assert heard.call(Seek, '/replay_clock/seek', Seek.Request(offset=0.0)).success
        group.processes['ring_displacement'].process.kill()
        states.clear()
        assert heard.call(Trigger, '/replay_clock/play').success
        wait_until(lambda: bool(states) and states[-1].state == ReplayState.FINISHED, 60.0, 'end')
        assert 'no longer waits for ring_displacement' in group.processes['replay_clock'].said()


def test_a_step_in_lockstep_holds_no_more_messages_of_a_topic_than_its_readers_do() -> None:
    fast, slow = np.arange(0, 10**9, 20_000), np.arange(0, 10**9, 10**6)
    assert shortest_time_of(1000, [slow, fast]) == 1000 * 20_000
    assert shortest_time_of(5000, [slow]) > 10**9, 'fewer messages than that: no limit'
    assert shortest_time_of(10, [np.zeros(100, np.int64)]) == 10**6, 'a step still advances'


def said(node: str, *, until: int = 0, inputs=(), outputs=()) -> ReplayProgress:
    message = ReplayProgress(node=node, replayed_until=to_time(until))
    for topic, stamp, count in inputs:
        message.inputs.append(topic)
        message.input_stamps.append(to_time(stamp))
        message.publishers.append(count)
        message.received.append(0)
    for topic, stamp, count in outputs:
        message.outputs.append(topic)
        message.output_stamps.append(to_time(stamp))
        message.subscriptions.append(count)
        message.published.append(0)
    return message


def test_a_misspelt_participant_is_waited_for_but_told_and_one_that_never_reports_is_refused():
    """Nodes of one's own may take part, so the clock cannot know all names."""
    assert LockstepGroup(['ring_simulater', 'ring_residual', 'mine']).absent() == [
        'ring_simulater: nothing received: did you mean ring_simulator?',
        'ring_residual: nothing received', 'mine: nothing received']
    for name in ('replay_clock', 'ring_diagnosis', '/rig1/ring_residual'):
        with pytest.raises(NodeError, match=f"participants has '{name}', which never reports"):
            LockstepGroup([name])


def test_a_replay_starts_when_all_are_heard_of_and_matched_both_ways() -> None:
    group = LockstepGroup(['source', 'reader'])
    assert len(group.absent()) == 2
    group.hear(said('source', until=1, outputs=[('/t', 0, 0)]), 0.0)
    group.hear(said('reader', inputs=[('/t', 0, 1)]), 0.0)
    assert group.absent() == ['source: /t is connected to 0 of 1 readers']
    group.hear(said('source', until=1, outputs=[('/t', 0, 1)]), 0.0)
    group.hear(said('reader', inputs=[('/t', 0, 0)]), 0.0)
    assert group.absent() == ['reader: is not connected to the publisher of /t']
    group.hear(said('reader', inputs=[('/t', 0, 1)]), 0.0)
    assert group.absent() == []


def test_a_replay_starts_without_a_live_page_and_knows_how_far_the_page_is_behind() -> None:
    group = LockstepGroup(['source'])
    group.hear(said('source', until=100, outputs=[('/t', 99, 1), ('/u', 99, 1)]), 0.0)
    group.hear(said('saddlering_live_7', inputs=[('/t', 77, 1), ('/u', 5, 0), ('/v', 5, 1)]), 0.0)
    assert group.absent() == group.behind(100) == []
    assert group.spectators_lag(1.0) == 22
    assert group.spectators_lag(SPECTATOR_LEASE + 1.0) == 0
    group.hear(said('saddlering_live_7'), 0.0)  # the page leaves
    assert group.spectators_lag(1.0) == 0


def test_a_replaying_node_knows_the_bag_of_the_clock_before_it_heeds_its_time() -> None:
    """On a busy machine 100 samples of another bag were published before the announcement came."""
    followed: list[tuple[int, str]] = []
    announced = [(ReplayState(bag='other'), None)]
    own: Any = SimpleNamespace(
        _state=ReplayState(), _clock_flow=SimpleNamespace(take_each=lambda _: [1, 2]),
        _states=SimpleNamespace(handle=SimpleNamespace(
            take_message=lambda *_: announced.pop() if announced else None)),
        _follow=lambda now: followed.append((now, own._state.bag)))
    ReplayNode.process_batch(own)
    assert followed == [(1, 'other'), (2, 'other')]


def test_load_and_probes_of_two_bags_are_not_mixed(bag, bag_root, group, heard) -> None:
    """Each node is set by itself, and both recordings may have the same stamps."""
    other = shutil.copytree(bag, bag_root / 'other', dirs_exist_ok=True)
    group.start('eddy_current', {'bag': str(other)})
    group.start('hydraulic_load', {'bag': str(bag)})
    group.start('replay_clock', {'bag': str(bag), 'participants': [
        'eddy_current', 'hydraulic_load'], 'clock_rate': 20.0})

    def told(node: str, words: str) -> bool:
        return words in heard.diagnostics.get(f'{node}: replay', (0, ''))[1]

    wait_until(lambda: told('hydraulic_load', 'all messages are published'), what='the end')
    wait_until(lambda: told('replay_clock', 'at its end'), what='the end')
    assert heard.diagnostics['eddy_current: replay'] == (2, (
        f'nothing is published: this node replays {other}, and replay_clock {bag}: '
        'give both the same bag'))
    assert not sum(heard.progress['eddy_current'].published)

    assert set_parameter(heard, 'eddy_current', 'bag', str(bag)).successful
    lead(heard, 'eddy_current', *ANEW)
    assert heard.call(Seek, '/replay_clock/seek', Seek.Request(offset=0.0)).success
    assert set_parameter(heard, 'eddy_current', 'bag', str(other)).successful
    assert heard.call(Trigger, '/replay_clock/play').success
    wait_until(lambda: sum(heard.progress['eddy_current'].published) > 0, what='it publishes')
    wait_until(lambda: told('eddy_current', 'all messages are published'), what='the end')
    assert heard.figures['eddy_current: replay']['bag'] == bag.name, 'the one it was made with'


@pytest.mark.parametrize(('other', 'is_same'), [
    ('bag', True), ('link', True), ('bag/bag_0.mcap', True), ('/elsewhere/bag', True),
    ('/elsewhere/bag/bag_0.mcap', True), ('/elsewhere/two', False), ('two', False),
    ('two/bag', False)])
def test_a_bag_is_known_by_its_place_or_by_its_name_on_another_machine(other, is_same, tmp_path):
    (tmp_path / 'two' / 'bag').mkdir(parents=True)
    (tmp_path / 'bag').mkdir()
    (tmp_path / 'bag' / 'bag_0.mcap').touch()
    (tmp_path / 'link').symlink_to(tmp_path / 'bag')
    node: Any = SimpleNamespace(_path=tmp_path / 'bag', count_publishers=lambda topic: 1,
                                _state=ReplayState(bag=str(tmp_path / other)))
    assert bool(ReplayNode._mixed(node)) != is_same


PAGE = 'saddlering_live_7'


def test_a_replay_waits_for_readers_that_its_nodes_have_not_heard_of_yet() -> None:
    group = LockstepGroup(['source'])
    group.hear(said('source', until=1, outputs=[('/t', 0, 1)]), 0.0)
    readers = {'/t': 2}.__getitem__
    assert group.unmatched_readers(readers, 1, 0.0) == [
        'the live page: nothing received', 'source: /t is connected to 1 of 2 readers']
    group.hear(said('source', until=1, outputs=[('/t', 0, 2)]), 0.0)
    group.hear(said(PAGE, inputs=[('/t', 0, 0)]), 0.0)
    assert group.unmatched_readers(readers, 1, 0.0) == [
        'the live page: is not connected to the publisher of /t']
    group.hear(said(PAGE, inputs=[('/t', 0, 1)]), 0.0)
    assert group.unmatched_readers(readers, 1, 0.0) == []
    group.hear(said('source', until=1, outputs=[('/t', 0, 0)]), 0.0)
    assert group.unmatched_readers({'/t': 0}.__getitem__, 1, 0.0) == [
        'source: /t is connected to 0 of 1 readers'], 'the page tells what it reads'


def test_a_replay_waits_until_it_has_found_every_program_of_its_domain(bag, group, ros_domain):
    """A page that the clock has not found yet would miss the first messages."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as program:
        program.bind(('127.0.0.1', 7400 + 250 * ros_domain + 10 + 2 * 100))
        clock = group.start('replay_clock', {'bag': str(bag), 'participants': [''],
                                             'timeout': 1.0})
        wait_until(lambda: 'replay is playing' in clock.said(), 80.0, 'it plays')
    assert re.search(r'starts without other programs of its domain: \d not found', clock.said())


def test_who_was_there_at_the_start_owes_the_first_messages_too() -> None:
    group = LockstepGroup(['source', 'reader'])
    for name in ('reader', PAGE):
        group.hear(said(name, inputs=[('/t', 0, 1)]), 0.0)
    group.hear(said('source', until=100, outputs=[('/t', 99, 1)]), 0.0)
    assert (group.behind(100), group.spectators_lag(1.0)) == ([], 0), 'who joins late owes nothing'
    group.begin(9)
    assert [reason.partition(':')[0] for reason in group.behind(100)] == ['reader']
    assert group.spectators_lag(1.0) == 90
    for count in (5, 0):  # started anew
        again = said('reader', inputs=[('/t', 0, 1)])
        again.received = [count]
        group.hear(again, 2.0)
    assert group.behind(100) == []


def test_time_goes_on_only_when_all_that_was_published_is_dealt_with() -> None:
    group = LockstepGroup(['source', 'reader'])
    group.hear(said('source', until=90, outputs=[('/t', 88, 1)]), 0.0)
    group.hear(said('reader', inputs=[('/t', 77, 1)]), 0.0)
    assert [reason.partition(':')[0] for reason in group.behind(100)] == ['source', 'reader']
    group.hear(said('source', until=100, outputs=[('/t', 99, 1)]), 0.0)
    group.hear(said('reader', inputs=[('/t', 88, 1)]), 0.0)
    assert [reason.partition(':')[0] for reason in group.behind(100)] == ['reader']
    group.hear(said('reader', inputs=[('/t', 99, 1)]), 0.0)
    assert group.behind(100) == []


@pytest.mark.parametrize(('name', 'topic', 'kind', 'figure'), [
    ('replay_clock', PROGRESS, ReplayProgress, 'malformed progress'),
    ('hydraulic_load', CLOCK, Clock, 'malformed clock')])
def test_a_damaged_message_is_counted_and_ends_no_node(
        name: str, topic: str, kind: Any, figure: str, bag: Path, group: NodeGroup,
        heard: Client) -> None:
    node = group.start(name, {'bag': str(bag)})
    with heard.lock:
        publisher = RawPublisher(heard.node, topic, kind)

    def is_counted() -> bool:
        publisher.send([b'\0\1\0\0'], 0)
        return not node.running or int(
            heard.figures.get(f'{name}: replay', {}).get(figure, 0)) > 0

    wait_until(is_counted, what='it is counted')
    assert node.running, node.said()
