"""What every test gets: a ROS domain of its own, on this machine only."""

from collections.abc import Callable, Iterator
import contextlib
import os
import signal
import socket
from typing import Any

from gate_budget import GateBudget
import pytest

# A shell's background jobs ignore SIGINT, and what they start inherits that; tests that interrupt
# a program want it as it comes from a terminal.
if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:
    signal.signal(signal.SIGINT, signal.default_int_handler)


def pytest_configure(config: pytest.Config) -> None:
    """Print at the end of a run which tests cost most."""
    config.pluginmanager.register(GateBudget())


DOMAINS = range(1, 101)
"""Domains whose ports lie below Linux's range for outgoing connections (32768 and up)."""

DISCOVERY_PORT = 7400
PORTS_PER_DOMAIN = 250


class DomainLease:
    """A ROS domain that nobody else on this machine holds, for as long as it is open.

    Another run of these tests is kept out by a lock on an abstract socket of the domain's name,
    any other ROS by looking whether the domain's discovery port is taken.
    """

    def __init__(self) -> None:
        self.number, self._lock = _lease()

    def close(self) -> None:
        self._lock.close()


def _lease() -> tuple[int, socket.socket]:
    start = os.getpid() % len(DOMAINS)
    for domain in [*DOMAINS[start:], *DOMAINS[:start]]:
        if _taken(domain):
            continue
        lock = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM)
        try:
            lock.bind(f'\0saddlering_ros-test-domain-{domain}')
        except OSError:
            lock.close()
            continue
        return domain, lock
    raise RuntimeError('every ROS domain from 1 to 100 is in use on this machine')


def _taken(domain: int) -> bool:
    """Return whether some participant listens to the multicast discovery of `domain`."""
    port = DISCOVERY_PORT + PORTS_PER_DOMAIN * domain
    with open('/proc/net/udp') as table:
        return any(line.split()[1].endswith(f':{port:04X}') for line in list(table)[1:])


@pytest.fixture(autouse=True)
def _own_ros_domain(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> None:
    """Give tests marked `ros` a domain of their own, for them and the processes they start."""
    if request.node.get_closest_marker('ros') is not None:
        request.getfixturevalue('ros_domain')


@pytest.fixture
def ros_domain(monkeypatch: pytest.MonkeyPatch) -> Iterator[int]:
    """Return the number of a ROS domain that is this test's alone; the environment has it."""
    lease = DomainLease()
    monkeypatch.setenv('ROS_DOMAIN_ID', str(lease.number))
    monkeypatch.setenv('ROS_AUTOMATIC_DISCOVERY_RANGE', 'LOCALHOST')
    monkeypatch.delenv('ROS_LOCALHOST_ONLY', raising=False)
    monkeypatch.delenv('ROS_STATIC_PEERS', raising=False)
    yield lease.number
    lease.close()


@pytest.fixture(autouse=True)
def _nothing_left_of_ros(
        request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    """Nodes, action clients and servers of a test marked `ros` are destroyed by its end.

    Those left over outlive their context, and are destroyed by the garbage collector in no order:
    the middleware can then wait for ever, at the exit of the process.
    """
    if request.node.get_closest_marker('ros') is None:
        yield
        return
    from rclpy.action import ActionClient, ActionServer
    from rclpy.exceptions import InvalidHandle
    from rclpy.node import Node
    handles: dict[Any, str] = {Node: 'handle', ActionClient: '_client_handle',
                               ActionServer: '_handle'}
    made: list[tuple[object, Any]] = []
    for kind, name in handles.items():
        monkeypatch.setattr(kind, '__init__', _noted(kind.__init__, name, made))
    yield
    left = []
    for one, handle in made:
        with contextlib.suppress(InvalidHandle), handle:
            left.append(one)
    assert not left, f'not destroyed: {left}'


def _noted(initialise: Callable[..., None], name: str, made: list[tuple[object, Any]],
           ) -> Callable[..., None]:
    """`initialise`, which also adds what it made and its handle to `made`."""
    def noting(self: object, *args: object, **options: object) -> None:
        initialise(self, *args, **options)
        made.append((self, getattr(self, name)))
    return noting
