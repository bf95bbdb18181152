"""The examples of docs/from_another_node.md run as they stand, against running nodes."""

from __future__ import annotations

from collections.abc import Iterator
import contextlib
from pathlib import Path
import signal
import subprocess
import sys

import pytest
from ros_domains import DomainLease
from rosnet import Client, Driver, wait_until

from saddlering_ros.ros.launcher import NodeGroup, RING_NODES

pytestmark = pytest.mark.ros
EXAMPLES = Path(__file__).parents[2] / 'examples'


def start(group: NodeGroup, name: str, *arguments: str) -> subprocess.Popen[str]:
    return subprocess.Popen([sys.executable, '-u', EXAMPLES / name, *arguments], text=True,
                            env=group.environment, stdout=subprocess.PIPE,
                            stderr=subprocess.STDOUT)


@contextlib.contextmanager
def ended(process: subprocess.Popen[str]) -> Iterator[None]:
    """Leave no process in the domain, whatever the test comes to."""
    try:
        yield
    finally:
        process.kill()


@pytest.fixture(scope='module')
def server(bag_root: Path, tmp_path_factory: pytest.TempPathFactory) -> Iterator[NodeGroup]:
    """An identification server for all tests of this file."""
    lease = DomainLease()
    with contextlib.closing(lease), NodeGroup(
            domain_id=lease.number, log_folder=tmp_path_factory.mktemp('log')) as nodes:
        nodes.start('ring_identification', {'bag_root': str(bag_root)})
        yield nodes


def test_the_client_of_the_identification_prints_progress_and_parameters(
        bag: Path, server: NodeGroup) -> None:
    with start(server, 'identify_client.py', bag.name) as client, ended(client):
        said, _ = client.communicate(timeout=120.0)
    assert 'best' in said
    assert 'K1' in said or 'k1 = ' in said
    assert 'Traceback' not in said


def test_the_client_ends_a_canceled_goal_with_its_reason(
        bag: Path, server: NodeGroup) -> None:
    with start(server, 'identify_client.py', bag.name) as client, ended(client):
        assert client.stdout is not None
        assert 'best' in client.stdout.readline()  # it runs
        client.send_signal(signal.SIGINT)
        said, _ = client.communicate(timeout=60.0)
    assert 'canceled' in said or 'k1 = ' in said  # the latter when it was quicker
    assert 'Traceback' not in said


def test_the_listener_prints_the_residual_each_second(
        record, group: NodeGroup, heard: Client) -> None:
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
