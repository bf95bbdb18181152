"""What the middleware drops is sent again at once, and the user's own settings of it stand."""

import os
from pathlib import Path
import signal
import socket
import subprocess
import sys
import time
from types import SimpleNamespace
from typing import Any
import xml.etree.ElementTree

import numpy as np
import pytest
import rclpy
from rosnet import Driver, wait_until

from saddlering_interfaces.msg import RingDisplacement
from saddlering_ros.rig import default_rig
from saddlering_ros.ros import launcher
from saddlering_ros.ros.launcher import NodeGroup, PACKED, PROFILE_VARIABLES, transport_environment
from saddlering_ros.ros.raw_topics import DEPTH, RawPublisher
from saddlering_ros.ros.streaming_node import StreamingNode

BURST = 3000
"""Messages that do not fit into the receive buffer of a node's socket; the rest is dropped."""


@pytest.mark.ros
def test_a_reader_that_stood_still_has_everything_after_it_goes_on(group, heard) -> None:
    driver = Driver(heard)
    simulator, residual = group.start('ring_simulator'), group.start('ring_residual')

    def matched() -> bool:
        """Both ways: what comes before a reader knows of its writer is not kept for it."""
        if not heard.progress.keys() >= {simulator.name, residual.name}:
            return False
        simulates, subtracts = heard.progress[simulator.name], heard.progress[residual.name]
        return bool(driver.load.subscriptions() and simulates.publishers[0]
                    and simulates.subscriptions[0] >= 2 and subtracts.publishers[1])

    wait_until(matched, 80.0, 'all are matched')

    def sent() -> int:
        return heard.progress[simulator.name].published[0]

    def received() -> int:
        return heard.progress[residual.name].received[1]

    stamps = 1_700_000_000_000_000_000 + 1_000_000 * np.arange(1000 + BURST)
    load = np.full(len(stamps), default_rig().preload)
    driver.send_load(stamps[:1000], load[:1000])
    wait_until(lambda: sent() == received() == 1000, what='the zero is found')
    for start in range(1000, len(stamps), BURST):
        rows = slice(start, start + BURST)
        residual.process.send_signal(signal.SIGSTOP)
        for portion in range(start, start + BURST, 100):
            driver.send_load(stamps[portion:portion + 100], load[portion:portion + 100])
            time.sleep(0.01)
        wait_until(lambda rows=rows: sent() == rows.stop, what='it is simulated')
        residual.process.send_signal(signal.SIGCONT)
        wait_until(lambda rows=rows: received() == rows.stop, what='everything is received')


@pytest.mark.ros
def test_a_reader_killed_costs_its_writers_nothing_and_its_heir_hears(group, heard) -> None:
    driver = Driver(heard)
    simulator = group.start('ring_simulator')
    wait_until(lambda: bool(driver.load.subscriptions()), what='it is matched')
    load = np.full(10, default_rig().preload)
    stamp = 1_700_000_000_000_000_000

    def cost(seconds: float) -> float:
        """Processor time of a message [s], median, while `seconds` are filled at about 1 kHz."""
        nonlocal stamp
        costs = []
        end = time.monotonic() + seconds
        while time.monotonic() < end:
            stamps = stamp + 1_000_000 * np.arange(10)
            stamp += 10_000_000
            began = time.thread_time()
            driver.send_load(stamps, load)
            costs.append((time.thread_time() - began) / 10)
            time.sleep(0.01)
        return float(np.median(costs))

    before = cost(1.5)
    simulator.process.kill()
    simulator.process.wait()
    cost(3.5)
    assert cost(1.5) < 4.0 * before  # by shared memory ten times, from the third second on
    heard.progress.clear()
    group.start('ring_simulator')
    wait_until(lambda: 'ring_simulator' in heard.progress, 80.0, 'it lives')

    def heir_hears() -> bool:
        cost(0.05)
        return heard.progress['ring_simulator'].received[0] > 0

    wait_until(heir_hears, what='the heir hears')
    other = Driver(heard)  # silent, as one that was killed seems to be

    def sources(word: str) -> bool:
        cost(0.05)
        return word in heard.diagnostics.get('ring_simulator: sources', (0, ''))[1]

    wait_until(lambda: sources('of which one at most sends'), what='no mixture is seen')

    def mixes() -> bool:
        other.send_load(np.array([stamp]), load[:1])
        return sources('their samples are mixed')

    wait_until(mixes, what='the mixture is seen')


def test_a_backlog_is_sent_in_portions_that_no_queue_loses() -> None:
    """The zero of a record of 20 kHz releases 10 000 rows: of 64 000, 3 000 were lost."""
    since_wait, most = 0, 0

    def send(message: bytes) -> None:
        nonlocal since_wait, most
        since_wait += 1
        most = max(most, since_wait)

    def wait(_: object) -> None:
        nonlocal since_wait
        since_wait = 0

    publisher = SimpleNamespace(handle=SimpleNamespace(publish_raw=send), wait_for_all_acked=wait)
    node: Any = SimpleNamespace(create_publisher=lambda *_: publisher,
                                resolve_topic_name=lambda name: name)
    flow = RawPublisher(node, '/ring/displacement', RingDisplacement)
    flow.send([b''] * 12_000, 1)
    assert flow.published == 12_000
    assert most <= DEPTH // 2


PLAIN_NODE = """
import rclpy
from geometry_msgs.msg import WrenchStamped
from saddlering_interfaces.msg import ReplayProgress
rclpy.init()
node = rclpy.create_node('plain')
publisher = node.create_publisher(WrenchStamped, '/rig/hydraulic_load', 10)
heard = []
node.create_subscription(ReplayProgress, '/replay/progress', heard.append, 10)
node.create_timer(0.01, lambda: publisher.publish(WrenchStamped()))
while not any(sum(said.received) for said in heard):
    rclpy.spin_once(node)
"""


@pytest.mark.ros
def test_a_plain_node_without_the_profile_is_heard_and_hears(group) -> None:
    plain = {name: value for name, value in group.environment.items()
             if name not in PROFILE_VARIABLES}
    group.start('ring_simulator')
    subprocess.run([sys.executable, '-c', PLAIN_NODE], env=plain, timeout=80.0, check=True)


def test_the_profile_is_one_fast_dds_can_read_and_gives_way_to_the_users(monkeypatch) -> None:
    for name in (*PROFILE_VARIABLES, launcher.PUBLICATION_VARIABLE):
        monkeypatch.delenv(name, raising=False)
    assert transport_environment()[launcher.PUBLICATION_VARIABLE] == 'SYNCHRONOUS'
    assert transport_environment(PACKED)[launcher.PUBLICATION_VARIABLE] == 'ASYNCHRONOUS'
    for users in ('SYNCHRONOUS', 'ASYNCHRONOUS'):
        monkeypatch.setenv(launcher.PUBLICATION_VARIABLE, users)
        assert transport_environment()[launcher.PUBLICATION_VARIABLE] == users
        assert transport_environment(PACKED)[launcher.PUBLICATION_VARIABLE] == users
    path = transport_environment()[PROFILE_VARIABLES[0]]
    space = '{http://www.eprosima.com/XMLSchemas/fastRTPS_Profiles}'
    root = xml.etree.ElementTree.parse(path)

    def number(name: str) -> int:
        found = root.find(f'.//{space}{name.replace("/", f"/{space}")}')
        assert found is not None
        return int(found.text or 0)

    assert 0 < number('heartbeatPeriod/nanosec') <= 50_000_000
    assert number('leaseAnnouncement/sec') == 0
    monkeypatch.setenv(PROFILE_VARIABLES[1], '/the/users.xml')
    assert transport_environment() == transport_environment(PACKED) == {}
    assert PROFILE_VARIABLES[0] not in NodeGroup(1).environment


def test_larger_buffers_cost_no_file_descriptor() -> None:
    """A copy of every open file was left, and the copies were copied by the next node."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM):
        before = len(os.listdir('/proc/self/fd'))
        launcher.widen_sockets()
        assert len(os.listdir('/proc/self/fd')) == before


@pytest.mark.ros
def test_a_node_holds_more_than_the_block_of_a_driver_before_it_reads(ros_domain: int) -> None:
    """Of 50 samples of five topics at once the last were lost, and probe 4 "did not read"."""
    def buffers() -> dict[str, int]:
        sizes = {}
        for place in Path('/proc/self/fd').iterdir():
            if place.is_symlink() and 'socket:' in os.readlink(place):
                with socket.socket(fileno=os.dup(int(place.name))) as one:
                    if one.type == socket.SOCK_DGRAM:
                        sizes[os.readlink(place)] = one.getsockopt(
                            socket.SOL_SOCKET, socket.SO_RCVBUF)
        return sizes

    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as plain:
        usual, before = plain.getsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF), buffers()
    rclpy.init(args=[], domain_id=ros_domain)
    node = StreamingNode('a_node')
    try:
        own = [size for name, size in buffers().items() if name not in before]
        assert own
        assert min(own) > usual
    finally:
        node.destroy_node()
        rclpy.try_shutdown()
