"""The alarm that sees nothing: never within limits, and it names the stream that is missing."""

from collections.abc import Iterator
import contextlib
import threading
import time

import numpy as np
import pytest
import rclpy
from rclpy.duration import Duration
from rclpy.qos import QoSProfile
from rclpy.serialization import deserialize_message
from rosnet import ACTIVATE, Client, client, DEACTIVATE, Driver, lead, wait_until
from std_msgs.msg import Bool

from saddlering_interfaces.msg import RingAlarm, RingDisplacement, RingExpected
from saddlering_ros.monitoring.stream import SEEN
from saddlering_ros.nodes.ring_alarm import RingAlarmNode
from saddlering_ros.record.batches import Displacements, Samples
from saddlering_ros.rig import default_rig, TRUE_TO_SCALE
from saddlering_ros.ros.launcher import ALARM_NODES, NodeGroup, RING_NODES

pytestmark = pytest.mark.ros
PERIOD = 0.005


class RestingRig:
    """A driver in real time: preload, probes that do not move; `shift` [s] is added to stamps."""

    def __init__(self, heard: Client) -> None:
        self.driver = Driver(heard)
        self.shift, self.is_silent = 0.0, False
        self._ended = threading.Event()
        self._thread = threading.Thread(target=self._drive, daemon=True)
        self._thread.start()

    def _drive(self) -> None:
        chance, preload = np.random.default_rng(1), default_rig().preload
        while not self._ended.wait(4 * PERIOD):
            if self.is_silent:
                continue
            now = time.time_ns() + round(1e9 * self.shift)
            stamps = now - np.arange(3, -1, -1) * round(1e9 * PERIOD)
            self.driver.send_load(stamps, preload + chance.normal(0.0, 20.0, 4))
            for probe in range(4):
                self.driver.send_gap(probe, stamps, 1e-3 + chance.normal(0.0, 3e-7, 4))

    def close(self) -> None:
        self._ended.set()
        self._thread.join()


@pytest.fixture(name='rig')
def rig_fixture(heard: Client) -> Iterator[RestingRig]:
    with contextlib.closing(RestingRig(heard)) as one:
        yield one


@pytest.mark.usefixtures('ros_domain')
def test_a_node_made_anew_in_the_stream_is_within_limits_from_its_first_sample_on() -> None:
    rclpy.init(args=[''])
    node = RingAlarmNode()
    try:
        now, stamps = time.monotonic(), np.array([1])
        node._sight.hear_load(stamps, now)
        node._sight.hear_residual(stamps, np.zeros((3, 1)), now)
        node.configure()  # again, as quickly as ros2 lifecycle can
        node._stream.use(TRUE_TO_SCALE)
        node.active = True
        node._tell_state()
        assert (node._state(), node._within_limits()) == (RingAlarm.WAITING, False)
    finally:
        node.destroy_node()
        rclpy.try_shutdown()


class Arrived:
    """An input of a node: the batches that its subscription would take, one a call."""

    def __init__(self, batches: list[Samples] | list[Displacements]) -> None:
        self.take_samples = self.take_as = lambda _: batches.pop(0)


@pytest.mark.usefixtures('ros_domain')
def test_one_load_with_a_stamp_ahead_does_not_blind_the_alarm() -> None:
    rclpy.init(args=[''])
    node = RingAlarmNode()
    try:
        node.configure()
        stamps = 1_700_000_000_000_000_000 + np.arange(40) * 5_000_000
        sent = stamps.copy()
        sent[20] += 5_000_000_000
        node.inputs = [Arrived([Displacements.from_zero(now, np.zeros((4, 1)), (0, 0), 4903.0)
                                for now in np.split(stamps, 40)]),
                       Arrived([Samples(now, np.full(1, 4903.0)) for now in np.split(sent, 40)])]
        node.active = True
        lacks = []
        for _ in stamps:
            node.process_batch()
            lacks.append(node._lacks)
        assert set(lacks[1:]) == {SEEN}
    finally:
        node.destroy_node()
        rclpy.try_shutdown()


def test_the_alarm_is_blind_without_its_streams_and_nothing_is_then_within_limits(
        group: NodeGroup, heard: Client, rig: RestingRig, ros_domain: int) -> None:
    told: list[RingAlarm] = heard.listen(RingAlarm, 'ring/alarm')
    limits: list[Bool] = heard.listen(Bool, 'ring/within_limits')
    demanding = QoSProfile(depth=5, deadline=Duration(seconds=0.2))
    expected: list[RingExpected] = heard.listen(RingExpected, 'ring/expected', 5)
    by_deadline = heard.listen(Bool, 'ring/within_limits', demanding)
    for name in (*RING_NODES, *ALARM_NODES):
        group.start(name, {'elevation_deg': 50.0} if name == 'ring_simulator' else {})

    def sees() -> None:
        wait_until(lambda: bool(limits) and limits[-1].data, what='it sees')
        wait_until(lambda: told[-1].state in (RingAlarm.LEARNING, RingAlarm.WATCHING)
                   and not told[-1].missing, what='a state without a missing stream')

    def is_blind(*missing: str) -> None:
        def names_all(alarm: RingAlarm) -> bool:
            return (alarm.state == RingAlarm.BLIND and alarm.missing == list(missing)
                    and all(topic in alarm.message for topic in missing))

        wait_until(lambda: names_all(told[-1]), what=f'it misses {missing}')
        wait_until(lambda: not limits[-1].data, what='a limit of false')
        wait_until(lambda: heard.diagnostics.get('ring_alarm: alarm', (0, ''))[0] == 2
                   and all(topic in heard.diagnostics['ring_alarm: alarm'][1]
                           for topic in missing), what='an error that names it')

    wait_until(lambda: bool(limits), what='the first word')
    assert not limits[0].data, 'nothing is watched yet'
    sees()
    wait_until(lambda: by_deadline[-1].data, what='a reader that asks for a deadline is served')

    wait_until(lambda: bool(expected) and len(heard.raw['/ring/residual']) > 200, what='motion')
    assert (expected[-1].validity, abs(expected[-1].delta_x) < 1e-6) == (
        RingExpected.NO_COVARIANCE, True)
    assert expected[-1].parameters.applied_by == '/ring_simulator'
    assert expected[-1].delta_x_by_load != 0.0
    residual = deserialize_message(heard.raw['/ring/residual'][-1], RingDisplacement)
    deviation = np.sqrt(residual.covariance.reshape(4, 4).diagonal())
    assert deviation[0] == pytest.approx(3e-7 / np.sqrt(2.0), rel=0.5), 'of two probes'

    lead(heard, 'ring_simulator', DEACTIVATE)
    is_blind('/ring/simulated_displacement')
    lead(heard, 'ring_simulator', ACTIVATE)
    sees()

    rig.shift = -100.0  # the clock of the driver jumps; both nodes take a new zero
    wait_until(lambda: not limits[-1].data, what='a jump is noticed')
    sees()

    rig.is_silent = True
    is_blind('/rig/hydraulic_load')
    rig.is_silent = False
    sees()

    group.processes['ring_displacement'].process.kill()
    is_blind('/ring/displacement')

    lead(heard, 'ring_alarm', DEACTIVATE)
    wait_until(lambda: 'not active' in told[-1].message, what='it says that it is inactive')
    with client(ros_domain) as joiner:
        late = joiner.listen(Bool, 'ring/within_limits')
        wait_until(lambda: bool(late), what='the latched limit')
        assert not late[-1].data
