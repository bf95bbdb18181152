"""Claims about the bag of a test that is saved from the page: its messages, each once."""

import numpy as np
import pytest

from saddlering_ros.bags.wire import decode_time, encode_displacements, encode_samples
from saddlering_ros.live.session import messages_of, Session
from saddlering_ros.live.traces import CurvesOfTest
from saddlering_ros.live.watcher import Watcher
from saddlering_ros.record.batches import Displacements, Samples
from saddlering_ros.record.topics import LOAD, PROBES

STAMPS = 10**18 + 10_000_000 * np.arange(100)
CURVES = {number: CurvesOfTest(number, int(STAMPS[0]), int(STAMPS[-1]), 10**7, {}, {})
          for number in (1, 2)}


def messages(topic, rows=slice(None), value=1e-3):
    """Messages of a topic as they come from the network."""
    stamps = STAMPS[rows]
    return encode_samples(Samples(stamps, np.full(len(stamps), value), 0.0, 2e-3), topic)


def test_a_bag_that_is_replayed_twice_is_saved_with_each_message_once():
    session = Session()
    for number, value in ((1, 1e-3), (2, 1.5e-3)):
        session.follow(number, '')
        session.keep(PROBES[0].name, messages(PROBES[0], value=value))
    for number, value in ((1, 1e-3), (2, 1.5e-3)):
        flows = messages_of(session.beside(number), CURVES[number])
        assert [message for _, message in flows[PROBES[0].name]] == messages(
            PROBES[0], value=value)


def test_messages_that_came_before_the_load_of_their_test_are_saved_with_it():
    session = Session()
    session.keep(PROBES[0].name, messages(PROBES[0], slice(0, 20)))
    session.follow(2, '')
    session.keep(PROBES[0].name, messages(PROBES[0], slice(20, 100)))
    assert len(messages_of(session.beside(2), CURVES[2])[PROBES[0].name]) == 100


@pytest.mark.ros
def test_messages_of_a_probe_that_a_replay_sent_and_that_did_not_come_are_counted(ros_domain):
    with Watcher(ros_domain) as watcher:
        watcher.traces.push('load', STAMPS, np.ones((1, 100)))
        for topic, rows in ((LOAD, slice(None)), *((probe, slice(None)) for probe in PROBES[1:]),
                            (PROBES[0], slice(20, 100))):
            watcher.session.keep(topic.name, messages(topic, rows))
        watcher._replay = {'state': 'finished'}
        watcher._published = {topic.name: 100 for topic in (LOAD, *PROBES)}
        assert watcher.state()['missing'] == '20 of 100 samples of probe_1'
        watcher.session.keep(PROBES[0].name, messages(PROBES[0], slice(0, 20)))
        watcher._flows['probe_1'].received += 20
        assert watcher.state()['missing'] == ''


@pytest.mark.ros
def test_a_displacement_may_come_before_the_load_of_its_test(ros_domain):
    rows = Displacements.from_zero(STAMPS, np.ones((4, 100)), (int(STAMPS[0]),) * 2, 1.0)
    with Watcher(ros_domain) as watcher:
        watcher.traces.push('load', STAMPS, np.ones((1, 100)))
        watcher.clear()
        watcher._take('measured', encode_displacements(rows, 'ring'))
        assert watcher.now()['test']['number'] == 2


@pytest.mark.ros
@pytest.mark.parametrize('ask', [lambda watcher: watcher.bag(1), lambda watcher: watcher.state()])
def test_messages_are_received_while_those_of_a_test_are_sorted_out(ros_domain, monkeypatch, ask):
    """A bag of fifteen minutes takes seconds to make: a queue would overflow meanwhile."""
    with Watcher(ros_domain) as watcher:
        watcher.traces.push('load', STAMPS, np.ones((1, 100)))
        for topic in (LOAD, *PROBES):
            watcher.session.keep(topic.name, messages(topic))
        watcher._replay = {'state': 'finished'}
        held = []

        def decode(message):
            held.append(watcher.lock.locked())
            return decode_time(message)

        monkeypatch.setattr('saddlering_ros.live.session.decode_time', decode)
        ask(watcher)
        assert len(held) == 500
        assert not all(held)
