"""The examples of docs/from_another_node.md run as they stand, against running nodes."""

from collections.abc import Iterator
import contextlib
from pathlib import Path
import signal
import subprocess
import sys
import threading
from typing import Any

import pytest
from rclpy.action import ActionServer
from rclpy.task import Future
from ros_domains import DomainLease
from rosnet import Client, Driver, ended, wait_until
from std_msgs.msg import Bool
from std_srvs.srv import Trigger

from saddlering_interfaces.action import IdentifyRing
from saddlering_ros.ros.launcher import NodeGroup, RING_NODES

pytestmark = pytest.mark.ros
EXAMPLES = Path(__file__).parents[2] / 'examples'


def start(group: NodeGroup, name: str, *arguments: str) -> subprocess.Popen[str]:
    return subprocess.Popen([sys.executable, '-u', EXAMPLES / name, *arguments], text=True,
                            env=group.environment, stdout=subprocess.PIPE,
                            stderr=subprocess.STDOUT)


@pytest.fixture(scope='module')
def server(bag_root: Path, tmp_path_factory: pytest.TempPathFactory) -> Iterator[NodeGroup]:
    """An identification server for all tests of this file."""
    lease = DomainLease()
    with contextlib.closing(lease), NodeGroup(
            domain_id=lease.number, log_folder=tmp_path_factory.mktemp('log')) as nodes:
        nodes.start('ring_identification', {'bag_root': str(bag_root)})
        yield nodes


def test_the_client_of_the_identification_prints_progress_and_parameters(bag, server) -> None:
    with start(server, 'identify_client.py', bag.name) as client, ended(client):
        said, _ = client.communicate(timeout=120.0)
    assert 'best' in said
    assert 'k1 = ' in said
    assert 'Traceback' not in said


def test_the_client_ends_a_canceled_goal_with_its_reason(bag, server) -> None:
    with start(server, 'identify_client.py', bag.name) as client, ended(client):
        assert client.stdout is not None
        assert 'best' in client.stdout.readline()  # it runs
        client.send_signal(signal.SIGINT)
        said, _ = client.communicate(timeout=60.0)
    assert 'canceled' in said or 'k1 = ' in said  # the latter when it was quicker
    assert 'Traceback' not in said


def test_the_client_ends_when_its_server_is_gone(group: NodeGroup, heard: Client) -> None:
    runs = threading.Event()

    async def execute(_goal: Any) -> None:
        runs.set()
        await Future()

    with heard.lock:
        server = ActionServer(heard.node, IdentifyRing, '/identify_ring', execute)
    with start(group, 'identify_client.py', 'run') as client, ended(client):
        assert runs.wait(80.0)
        with heard.lock:
            server.destroy()
        said, _ = client.communicate(timeout=60.0)
    assert said == 'the server is gone: start it again, and ask again\n'


def test_the_listener_prints_the_residual_each_second(record, group, heard) -> None:
    for name in RING_NODES:
        group.start(name)
    driver = Driver(heard)
    with start(group, 'residual_listener.py') as listener, ended(listener):
        wait_until(lambda: driver.matched(2) and heard.ring_nodes_matched(), 80.0, 'all matched')
        wait_until(lambda: heard.progress['ring_residual'].subscriptions[0] >= 2, what='heard')
        driver.send(record)
        assert listener.stdout is not None
        line = ''
        while 'delta_x' not in line:
            line = listener.stdout.readline()
            assert line, 'the listener ended'
        assert abs(float(line.split('delta_x')[1].split()[0])) < 5.0  # um: it is the same ring
        listener.send_signal(signal.SIGINT)
        said, _ = listener.communicate(timeout=60.0)
    assert 'Traceback' not in said
    assert listener.returncode == 0


def test_the_interlock_stops_on_an_alarm_and_on_silence_and_starts_by_reset_alone(group, heard):
    enabled: list[bool] = []
    limit = Beat(heard, 'ring/within_limits')
    with heard.lock:
        heard.node.create_subscription(
            Bool, 'rig/hydraulics_enabled', lambda message: enabled.append(message.data), 10)

    def becomes(value: bool) -> None:
        enabled.clear()
        wait_until(lambda: value in enabled, what=f'enabled {value}')

    def reset() -> str:
        return heard.call(Trigger, '/interlock/reset').message

    def starts() -> None:
        enabled.clear()
        wait_until(lambda: reset() == 'enabled' and True in enabled, what='it starts')

    with start(group, 'interlock.py') as interlock, ended(interlock), contextlib.closing(limit):
        becomes(False)
        assert 'silent' in reset(), 'nothing has been heard'
        limit.value = True
        starts()
        limit.value = None  # ring_alarm has died
        becomes(False)
        limit.value = True  # it is started again
        starts()
        limit.value = False
        becomes(False)
        wait_until(lambda: reset() == 'ring_alarm reports an alarm', what='the alarm is heard')
        limit.value = True  # ring_alarm was started again and has forgotten its alarm
        becomes(False)
        enabled.clear()
        wait_until(lambda: len(enabled) > 8, what='the stop is kept')
        assert not any(enabled)
        interlock.send_signal(signal.SIGINT)
        said, _ = interlock.communicate(timeout=60.0)
    assert interlock.returncode == 0
    assert 'Traceback' not in said


class Beat:
    """Repeats a value on a topic as ring_alarm does; None is silence."""

    def __init__(self, one: Client, topic: str) -> None:
        self.value: bool | None = None
        with one.lock:
            self._publisher = one.node.create_publisher(Bool, topic, 1)
        self._ended = threading.Event()
        self._thread = threading.Thread(target=self._repeat, daemon=True)
        self._thread.start()

    def _repeat(self) -> None:
        while not self._ended.wait(0.05):
            value = self.value
            if value is not None:
                self._publisher.publish(Bool(data=value))

    def close(self) -> None:
        self._ended.set()
        self._thread.join()
