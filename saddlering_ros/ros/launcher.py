"""Starts node processes and ends them again in every case; needs no launch package."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
import contextlib
from dataclasses import dataclass, field
import fcntl
import os
from pathlib import Path
import signal
from subprocess import DEVNULL, Popen, STDOUT
import sys
import tempfile
import time
from types import TracebackType
from typing import Any, IO

from saddlering_ros.files import temporary_folder
from saddlering_ros.ros.errors import NodeError
from saddlering_ros.ros.lifeline import LIFELINE
from saddlering_ros.ros.registry import ACTION, ALARM, names, REPLAY, RING
from saddlering_ros.ros.transport import packed_publication, transport_environment

REPLAY_NODES = names(REPLAY)
RING_NODES = names(RING)
ALARM_NODES = names(ALARM)
ACTION_NODES = names(ACTION)
DOMAINS = range(1, 100)
LOG_PREFIX = 'saddlering_node_logs_'
"""Of the temporary folder of the logs of nodes; one of a killed launcher is removed later."""

PATIENCE = (3.0, 1.0)
"""How long a process may take to leave after SIGINT, then after SIGTERM [s], before SIGKILL."""

Values = Mapping[str, Any]


class Domain:
    """A ROS domain of one's own on this machine, held by a file lock while it is needed."""

    def __init__(self, number: int, lock: IO[str]) -> None:
        self.number = number
        self._lock = lock

    @classmethod
    def take(cls) -> Domain:
        """A domain that no other process has taken this way."""
        folder = Path(tempfile.gettempdir()) / f'saddlering_domains_{os.getuid()}'
        folder.mkdir(exist_ok=True)
        first = os.getpid() % len(DOMAINS)
        for offset in range(len(DOMAINS)):
            number = DOMAINS[(first + offset) % len(DOMAINS)]
            if in_use(number):
                continue
            lock = (folder / str(number)).open('w')
            with contextlib.suppress(OSError):
                fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
                return cls(number, lock)
            lock.close()
        raise NodeError(f'all ROS domains from {DOMAINS[0]} to {DOMAINS[-1]} are in use '
                        f'({folder}): end another replay first')

    def release(self) -> None:
        """Let others have it."""
        self._lock.close()


def in_use(domain: int) -> bool:
    """Whether some ROS program on this machine listens to the discovery of `domain`."""
    port = f':{7400 + 250 * domain:04X}'
    with contextlib.suppress(OSError):
        lines = Path('/proc/net/udp').read_text().splitlines()[1:]
        return any(line.split()[1].endswith(port) for line in lines)
    return False


def environment(domain_id: int, extra: Mapping[str, str] | None = None) -> dict[str, str]:
    """The environment of nodes and clients of one group: own domain, this machine only."""
    return {**os.environ, **transport_environment(), 'ROS_DOMAIN_ID': str(domain_id),
            'ROS_AUTOMATIC_DISCOVERY_RANGE': 'LOCALHOST', **(extra or {})}


def ros_arguments(parameters: Values | None = None, files: Sequence[Path | str] = (),
                  remappings: Mapping[str, str] | None = None) -> list[str]:
    """`--ros-args ...` for parameters, parameter files and remappings."""
    arguments: list[str] = []
    for path in files:
        arguments += ['--params-file', str(path)]
    for name, value in (parameters or {}).items():
        arguments += ['-p', f'{name}:={_yaml(value)}']
    for old, new in (remappings or {}).items():
        arguments += ['-r', f'{old}:={new}']
    return ['--ros-args', *arguments] if arguments else []


def _yaml(value: Any) -> str:
    if isinstance(value, bool):
        return 'true' if value else 'false'
    if isinstance(value, float):
        return repr(value) if '.' in repr(value) else f'{value:f}'
    if isinstance(value, (list, tuple)):
        return '[' + ', '.join(_yaml(item) for item in value) + ']'
    if isinstance(value, int):
        return str(value)
    return "'" + str(value).replace("'", "''") + "'"


@dataclass
class NodeProcess:
    """One running node."""

    name: str
    process: Popen[bytes]
    log: Path

    @property
    def running(self) -> bool:
        """Whether the process still runs."""
        return self.process.poll() is None

    def said(self) -> str:
        """Its output so far."""
        with contextlib.suppress(OSError):
            return self.log.read_text(errors='replace')
        return ''


@dataclass
class NodeGroup:
    """Node processes in a ROS domain of their own; a context manager that leaves none behind.

    Every process also ends when the one that started it does, killed or not: each holds the
    reading end of a pipe whose writing end is here.
    """

    domain_id: int | None = None
    log_folder: Path | None = None
    extra_environment: Mapping[str, str] | None = None
    namespace: str = ''
    processes: dict[str, NodeProcess] = field(default_factory=dict)

    def __enter__(self) -> NodeGroup:
        self._domain = None if self.domain_id is not None else Domain.take()
        if self._domain is not None:
            self.domain_id = self._domain.number
        self._temporary = contextlib.ExitStack()
        if self.log_folder is None:
            self.log_folder = self._temporary.enter_context(
                temporary_folder(Path(tempfile.gettempdir()), LOG_PREFIX))
        self.log_folder.mkdir(parents=True, exist_ok=True)
        self._read_end, self._write_end = os.pipe()
        return self

    def __exit__(self, kind: type[BaseException] | None, problem: BaseException | None,
                 trace: TracebackType | None) -> None:
        self.stop()
        os.close(self._read_end)
        os.close(self._write_end)
        if self._domain is not None:
            self._domain.release()
        self._temporary.close()

    @property
    def environment(self) -> dict[str, str]:
        """Environment that a client of these nodes needs."""
        assert self.domain_id is not None
        return environment(self.domain_id, self.extra_environment)

    def start(self, name: str, parameters: Values | None = None, *,
              files: Sequence[Path | str] = (), remappings: Mapping[str, str] | None = None,
              ) -> NodeProcess:
        """Start the node `name` (a module of saddlering_ros.nodes) in a separate process."""
        assert self.log_folder is not None
        renamed = {**({'__ns': self.namespace} if self.namespace else {}), **(remappings or {})}
        log = self.log_folder / f'{name}.log'
        command = [sys.executable, '-m', f'saddlering_ros.nodes.{name}',
                   *ros_arguments(parameters, files, renamed)]
        with log.open('wb') as stream:
            process = Popen(
                command, stdin=DEVNULL, stdout=stream, stderr=STDOUT,
                env={**self.environment, LIFELINE: str(self._read_end)},
                pass_fds=(self._read_end,), start_new_session=True)
        self.processes[name] = NodeProcess(name, process, log)
        return self.processes[name]

    def wait(self, name: str, timeout: float) -> int:
        """Wait for a node to leave by itself; its exit status. NodeError when it or another fails.

        Any node that ends with an error in the meantime is reported with its last line.
        """
        deadline = time.monotonic() + timeout
        while self.processes[name].running:
            self.check()
            if time.monotonic() > deadline:
                raise NodeError(f'{name} is still running after {timeout:g} s: '
                                f'{last_line(self.processes[name].said())}')
            time.sleep(0.02)
        return int(self.processes[name].process.returncode)

    def check(self) -> None:
        """NodeError if a node has ended with an error."""
        for node in self.processes.values():
            status = node.process.poll()
            if status:
                raise NodeError(f'{node.name} ended with status {status}: '
                                f'{last_line(node.said())}')

    def stop(self) -> None:
        """End all nodes: SIGINT, SIGTERM after a while, SIGKILL after another."""
        try:
            for number, patience in zip((signal.SIGINT, signal.SIGTERM), PATIENCE, strict=True):
                self._signal(number)
                deadline = time.monotonic() + patience
                while self._alive() and time.monotonic() < deadline:
                    time.sleep(0.01)
        finally:
            self._signal(signal.SIGKILL)
            for node in self.processes.values():
                node.process.wait()

    def _alive(self) -> list[NodeProcess]:
        return [node for node in self.processes.values() if node.running]

    def _signal(self, number: signal.Signals) -> None:
        for node in self._alive():
            with contextlib.suppress(ProcessLookupError):
                os.killpg(node.process.pid, number)


def last_line(text: str) -> str:
    """The last line of a log that is not empty."""
    lines = [line.strip() for line in text.splitlines() if line.strip()]
    return lines[-1] if lines else 'no output'


@contextlib.contextmanager
def start_nodes(
    bag: Path | str, *, nodes: Sequence[str] = RING_NODES, lockstep: bool = True,
    rate: float = 0.0, parameters: Mapping[str, Values] | None = None,
    files: Sequence[Path | str] = (), domain_id: int | None = None,
    log_folder: Path | None = None, exit_at_end: bool = True, start_paused: bool = False,
    namespace: str = '',
) -> Any:
    """Replay `bag` to `nodes`; yields the NodeGroup, and ends every process on leaving.

    The clock starts last and waits for all others. `group.wait('replay_clock', timeout)` returns
    when the bag is at its end and everyone has dealt with it. `parameters` by node name.
    """
    given = {name: dict(values) for name, values in (parameters or {}).items()}
    streaming = [name for name in nodes if name in (*RING_NODES, *ALARM_NODES)]
    clock = {'bag': str(bag), 'lockstep': lockstep, 'rate': float(rate),
             'exit_at_end': exit_at_end, 'start_paused': start_paused,
             'participants': [*REPLAY_NODES, *streaming]}
    if 'elevation_deg' in given.get('ring_simulator', {}):
        clock['elevation_deg'] = given['ring_simulator']['elevation_deg']
    given['replay_clock'] = {**clock, **given.get('replay_clock', {})}
    for name in REPLAY_NODES:
        given[name] = {'bag': str(bag), **given.get(name, {})}
    if 'ring_simulator' in nodes and 'elevation_deg' not in given.get('ring_simulator', {}):
        given['ring_simulator'] = {'bag': str(bag), **given.get('ring_simulator', {})}
    with NodeGroup(domain_id=domain_id, log_folder=log_folder, namespace=namespace,
                   extra_environment=packed_publication() if lockstep else None) as group:
        for name in (*nodes, *REPLAY_NODES, 'replay_clock'):
            group.start(name, given.get(name), files=files)
        yield group
