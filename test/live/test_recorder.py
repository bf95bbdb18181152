"""A recording is whole: what has come is in the bag, and the bag is closed before the network."""

from collections.abc import Callable
import math
from pathlib import Path
import re
import signal
import threading
from typing import Any

from geometry_msgs.msg import WrenchStamped
import numpy as np
import pytest
from rclpy.duration import Duration
from rosbags.highlevel import AnyReader
from rosnet import wait_until
from sensor_msgs.msg import Range

from benchmarks.served_node import ServedNode
from saddlering_interfaces.msg import RingParameters
from saddlering_ros.bags.reader import bag_info
from saddlering_ros.bags.wire import encode_samples
from saddlering_ros.bags.write import write_bag
from saddlering_ros.cli import record
from saddlering_ros.cli.main import main
from saddlering_ros.cli.record import Silence
from saddlering_ros.live import recorder
from saddlering_ros.record.batches import Samples
from saddlering_ros.record.record import TestMetadata
from saddlering_ros.record.topics import LOAD, LOAD_TOPIC, PROBES
from saddlering_ros.rig import default_rig
from saddlering_ros.ros.names import PARAMETERS_IN_FORCE
from saddlering_ros.ros.raw_topics import RawPublisher

pytestmark = pytest.mark.ros
SOUND = encode_samples(Samples(np.arange(1, 6) * 1_000_000, np.ones(5)), LOAD)


def recorded(bag: Path) -> list[bytes]:
    """Messages of the load in a bag."""
    with AnyReader([bag]) as reader:
        return [data for item, _, data in reader.messages() if item.topic == LOAD_TOPIC]


class Publisher(ServedNode):
    """Publishes the load as bytes."""

    def __init__(self, domain: int) -> None:
        super().__init__(domain, 'publisher')
        self.load = RawPublisher(self.node, LOAD_TOPIC, WrenchStamped)
        self.serve()

    def send(self, messages: list[bytes]) -> None:
        """Send messages; all have arrived at the recorder then."""
        wait_until(lambda: self.load.subscriptions() > 0, what='the recorder')
        self.load.send(messages, 0)
        assert self.load.publisher.wait_for_all_acked(Duration(seconds=60))


@pytest.fixture
def publisher(ros_domain: int):
    one = Publisher(ros_domain)
    yield one
    one.close()


def test_what_has_arrived_when_a_recording_ends_is_in_its_bag(
        publisher: Publisher, ros_domain: int, tmp_path: Path, monkeypatch: Any) -> None:
    monkeypatch.setattr(recorder.raw_topics, 'spin_streaming',
                        lambda node: wait_until(lambda: node.done))
    with recorder.recording(tmp_path / 'bag', ros_domain) as node:
        publisher.send(SOUND)
    assert recorded(tmp_path / 'bag') == SOUND
    assert node.counts()[LOAD_TOPIC] == len(SOUND)


def test_a_bag_is_in_its_place_before_its_recorder_leaves_the_network(
        ros_domain: int, tmp_path: Path, monkeypatch: Any) -> None:
    was_there: list[bool] = []
    leave = recorder.Recorder.destroy_node
    monkeypatch.setattr(recorder.Recorder, 'destroy_node', lambda node: (
        was_there.append((tmp_path / 'bag').is_dir()), leave(node)))
    with recorder.recording(tmp_path / 'bag', ros_domain):
        pass
    assert was_there == [True]


def test_another_elevation_of_nodes_is_told_by_a_recording_and_by_its_bag(
        publisher: Publisher, ros_domain: int, tmp_path: Path,
        capsys: pytest.CaptureFixture[str]) -> None:
    said = 'the bag states 30 deg, and nodes meanwhile had another: /ring_simulator (50.00 deg)'
    with publisher.lock:
        teller = publisher.node.create_publisher(
            RingParameters, PARAMETERS_IN_FORCE, recorder.raw_topics.LATCHED)
        for name in ('', '/ring_simulator'):  # the first is an offer
            teller.publish(RingParameters(applied_by=name, elevation=math.radians(50.0)))
    with recorder.recording(tmp_path / 'bag', ros_domain,
                            facts=TestMetadata('dynamic', 30.0).as_text()) as node:
        wait_until(lambda: node.settle_rig() == said, 20.0, said)
    stamps = 1_700_000_000_000_000_000 + np.arange(400) * 10_000_000
    load = 5000.0 + np.linspace(0.0, 50e3, 400)
    bag = write_bag(tmp_path / 'whole', bag_info(tmp_path / 'bag').facts, stamps, load, [
        stamps] * 4, [1e-3 + sign * 1e-10 * load for sign in (1, 1, -1, -1)], default_rig().probes)
    assert main(['info', str(bag)]) == 0
    assert said in ' '.join(capsys.readouterr().out.split())


def test_a_damaged_message_does_not_end_a_recording(publisher, ros_domain, tmp_path) -> None:
    messages = [SOUND[0], SOUND[0][:8], *SOUND[1:]]
    with recorder.recording(tmp_path / 'bag', ros_domain) as node:
        for count, message in enumerate(messages, 1):
            publisher.send([message])
            wait_until(lambda: node.counts()[LOAD_TOPIC] == count)  # noqa: B023
    assert recorded(tmp_path / 'bag') == messages


def test_a_fault_of_the_recorder_is_told(ros_domain, tmp_path, monkeypatch) -> None:
    def fail(node: Any) -> None:
        raise RuntimeError('of the middleware')

    monkeypatch.setattr(recorder.raw_topics, 'spin_streaming', fail)
    with pytest.raises(RuntimeError, match='of the middleware'), \
            recorder.recording(tmp_path / 'bag', ros_domain) as node:
        wait_until(lambda: node.done)
    assert recorded(tmp_path / 'bag') == []


@pytest.fixture
def end(monkeypatch: pytest.MonkeyPatch) -> Callable[[], None]:
    """Ends `saddlering record`, as Ctrl-C does; the handlers of the test run stay."""
    handlers: dict[int, Any] = {}
    monkeypatch.setattr(signal, 'signal', handlers.__setitem__)
    return lambda: handlers[signal.SIGINT](signal.SIGINT, None)


def test_a_topic_of_the_rig_that_never_came_is_noted_at_the_end_of_a_recording(
        publisher: Publisher, ros_domain: int, tmp_path: Path, end: Callable[[], None],
        capsys: pytest.CaptureFixture[str]) -> None:
    def send() -> None:
        publisher.send(SOUND)
        end()

    sending = threading.Thread(target=send)
    sending.start()
    assert main(['record', str(tmp_path / 'bag'), '--domain', str(ros_domain)]) == 0
    sending.join()
    told = capsys.readouterr()
    assert told.err.startswith('note: nothing was received on /rig/eddy_current_1,')
    assert 'arrive' not in told.out


def test_a_topic_that_stops_while_others_go_on_is_noted_during_the_recording() -> None:
    silence = Silence(['/load', '/probe'], 0.0)
    told = {second: silence.told({'/load': second, '/probe': min(second, 3)}, float(second))
            for second in range(20)}
    assert {second: topics for second, topics in told.items() if topics} == {8: ['/probe']}
    nothing = Silence(['/load', '/probe'], 0.0)
    assert not any(nothing.told({'/load': 0, '/probe': 0}, float(second)) for second in range(20))


def test_a_recording_tells_when_load_and_probes_arrive(
        publisher: Publisher, ros_domain: int, tmp_path: Path, monkeypatch: Any,
        end: Callable[[], None]) -> None:
    """It said "recording", and drivers were found 2.4 s later: the begin of a test was lost."""
    probes = [RawPublisher(publisher.node, probe.name, Range) for probe in PROBES]
    told: list[str] = []

    def say(words: str, **_: Any) -> None:
        told.append(words)
        if len(told) == 2:
            end()

    def send() -> None:
        for out, topic in zip((*probes, publisher.load), (*PROBES, LOAD), strict=True):
            wait_until(lambda out=out: out.subscriptions() > 0, what='the recorder')
            samples = Samples(np.arange(1, 6) * 1_000_000, np.ones(5), 0.0, 2.0)
            out.send(encode_samples(samples, topic), 0)

    monkeypatch.setattr(record, 'print', say, raising=False)
    sending = threading.Thread(target=send)
    sending.start()
    assert main(['record', str(tmp_path / 'bag'), '--domain', str(ros_domain)]) == 0
    sending.join()
    first, second, _ = told
    assert first.startswith('recording ROS domain')
    assert re.fullmatch(r'load and probes arrive, [0-9.]+ s after the start', second)
