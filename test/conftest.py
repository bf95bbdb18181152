"""What every test gets: a ROS domain of its own, on this machine only."""

from collections.abc import Callable, Iterator
import contextlib
import gc
import os
import signal
from typing import Any

import gate_budget
from gate_budget import GateBudget
from hypothesis import settings
from hypothesis.internal.conjecture import providers
from made_once import MadeOnce
from node_server import NodeServer
import pytest
from ros_domains import DomainLease
from short_bags import ShortBags

# A shell's background jobs ignore SIGINT, and what they start inherits that; tests that interrupt
# a program want it as it comes from a terminal.
if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:
    signal.signal(signal.SIGINT, signal.default_int_handler)


# The same examples at every run; fresh ones by --hypothesis-profile=default. Without the numbers
# that stand in the code: they would change the examples with every commit, and each process
# would read all files for them.
settings.register_profile('gate', derandomize=True, database=None, deadline=None)
settings.load_profile('gate')
providers._get_local_constants = lambda: providers._local_constants


def pytest_configure(config: pytest.Config) -> None:
    """Print at the end of a run which tests cost most; let workers share the compilation.

    In a new clone each test file is compiled, with the words of its assertions. Two workers that
    collect in the same order compile every file twice; the second one begins at the end.
    """
    config.pluginmanager.register(GateBudget())
    worker = os.environ.get('PYTEST_XDIST_WORKER', 'gw0')
    if int(worker.removeprefix('gw')) % 2 and config.args == ['test']:
        folders = [place for place in (config.rootpath / 'test').iterdir() if place.is_dir()]
        config.args = sorted(map(str, folders), reverse=True)


def pytest_addoption(parser: pytest.Parser) -> None:
    """Let campaigns be asked for: they are too dear for the gate."""
    parser.addoption('--campaigns', action='store_true',
                     help='run the tests marked campaign too (make bench-blind)')


FOLDERS_WITH_NODES = ('test/nodes', 'test/live', 'test/cli')
"""Where tools/test.sh looks for tests marked `ros`."""


@pytest.hookimpl(tryfirst=True)
def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> None:
    """Refuse a test with nodes where the gate would not run it; leave campaigns out.

    All workers have the tests in one order, however they collected them: files with slow ones
    first, so that none is left for one worker while the other has no more to do. The tests of a
    file stay together, since they share what its fixtures made.
    """
    slow = {item.path for item in items if item.get_closest_marker('slow')}
    items.sort(key=lambda item: (item.path not in slow, item.path))
    if not config.getoption('--campaigns'):
        left_out = [item for item in items if item.get_closest_marker('campaign')]
        config.hook.pytest_deselected(items=left_out)
        items[:] = [item for item in items if item not in left_out]
    for item in items:
        if item.get_closest_marker('ros') and not item.nodeid.startswith(FOLDERS_WITH_NODES):
            raise pytest.UsageError(f'{item.nodeid} is marked ros: put it into one of '
                                    f'{", ".join(FOLDERS_WITH_NODES)}, or change tools/test.sh')


def pytest_collection_finish(session: pytest.Session) -> None:
    """Spare the garbage collector what was imported: it stays to the end."""
    gc.collect()
    gc.freeze()


@pytest.fixture(scope='session')
def made_once(tmp_path_factory: pytest.TempPathFactory) -> MadeOnce:
    """Folders that all workers of this run have in common."""
    return MadeOnce(tmp_path_factory)


@pytest.fixture(scope='session')
def campaign(made_once: MadeOnce) -> ShortBags:
    """campaign(effect, value, parameter, runs=..., seed=...): short bags of one virtual rig."""
    return ShortBags(made_once)


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
def _own_signals() -> Iterator[None]:
    """A command that a test runs in this process leaves the signals of the run as they were."""
    before = {number: signal.getsignal(number)
              for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)}
    yield
    for number, handler in before.items():
        if signal.getsignal(number) is not handler:
            signal.signal(number, handler)


@pytest.fixture(scope='session', autouse=True)
def _own_logs(tmp_path_factory: pytest.TempPathFactory) -> None:
    """Keep the logs of nodes out of the user's home, which may be read-only."""
    os.environ['ROS_LOG_DIR'] = str(tmp_path_factory.mktemp('ros_log'))


@pytest.fixture
def no_pictures(monkeypatch: pytest.MonkeyPatch) -> None:
    """Let reports have their words alone: a picture takes 0.3 s of processor time."""
    from shared_pictures import DRAWN
    monkeypatch.setattr(DRAWN, lambda chart: b'undrawn')


@pytest.fixture
def no_next_test(monkeypatch: pytest.MonkeyPatch) -> None:
    """Let diagnoses propose no further test: simulated ones are a fifth of a ring's diagnosis."""
    monkeypatch.setattr('saddlering_ros.discrepancy.engine.open_models', lambda search: None)


@pytest.fixture(scope='session')
def node_server() -> Iterator[NodeServer]:
    """Forks the nodes of this process's tests; see its module."""
    server = NodeServer()
    gate_budget.BESIDE.append(server.processor_seconds)
    yield server
    gate_budget.BESIDE.remove(server.processor_seconds)
    server.close()


@pytest.fixture(autouse=True)
def _forked_nodes(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> None:
    """Let launchers fork the nodes of tests marked `ros`, unless those want interpreters."""
    marked = request.node.get_closest_marker
    if marked('ros') is not None and marked('interpreters') is None:
        server = request.getfixturevalue('node_server')
        monkeypatch.setattr('saddlering_ros.ros.launcher.Popen', server.popen)


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
