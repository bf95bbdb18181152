"""Processes of nodes: their middleware, start, signals and end; needs no launch package or rclpy.

A group of nodes ends in every case, before their imports are done with status 0. The middleware
looks for nodes on this machine, and sends by UDP.
"""

from collections.abc import Iterator, Mapping, Sequence
import contextlib
from dataclasses import dataclass, field
import fcntl
import importlib.util
import json
import os
from pathlib import Path
import signal
import socket
import stat
from subprocess import DEVNULL, Popen, STDOUT
import sys
import tempfile
import threading
import time
from typing import Any

from saddlering_ros.files import (
    check_writable,
    FileConflict,
    remove_unlocked,
    share_directory,
    temporary_folder,
)
from saddlering_ros.ros.names import ALARM, names, NodeError, REPLAY, RING, SIGNALS

REPLAY_NODES = names(REPLAY)
RING_NODES = names(RING)
ALARM_NODES = names(ALARM)
DOMAINS = range(1, 100)
MAX_DOMAIN = 232
"""The ports of a higher domain do not exist (DDS wire protocol, 9.6.1)."""
LOG_PREFIX = 'saddlering_node_logs_'
"""Of the temporary folder of the logs of nodes; one of a killed launcher is removed later."""

PATIENCE = (3.0, 1.0)
"""How long a process may take to leave after SIGINT, then after SIGTERM [s], before SIGKILL."""

Values = Mapping[str, Any]


def domain_from(text: str, name: str) -> int:
    """The ROS domain in a text; NodeError with the `name` of where it was given."""
    if not (text.isascii() and text.isdecimal()) or int(text) > MAX_DOMAIN:
        raise NodeError(f'{name} is {text!r}: give a ROS domain from 0 to {MAX_DOMAIN}')
    return int(text)


@contextlib.contextmanager
def own_domain() -> Iterator[int]:
    """A ROS domain of one's own on this machine, held by a file lock while it is needed."""
    folder = Path(tempfile.gettempdir()) / f'saddlering_domains_{os.getuid()}'
    folder.mkdir(exist_ok=True)
    first = os.getpid() % len(DOMAINS)
    for number in (*DOMAINS[first:], *DOMAINS[:first]):
        if participants(number):
            continue
        with (folder / str(number)).open('w') as lock:
            try:
                fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
            except OSError:
                continue
            yield number
            return
    raise NodeError(f'all ROS domains from {DOMAINS[0]} to {DOMAINS[-1]} are in use '
                    f'({folder}): end another replay first')


def participants(domain: int, table: str | None = None) -> int:
    """How many ROS programs of `domain` this machine has, by their ports of discovery.

    table: the text of /proc/net/udp. A participant of number n listens to port
    7400 + 250 domain + 10 + 2 n (DDSI-RTPS 2.5, 9.6.2.3).
    """
    if table is None:
        try:
            table = Path('/proc/net/udp').read_text()
        except OSError:
            return 0
    ports = {int(line.split()[1].rpartition(':')[2], 16) for line in table.splitlines()[1:]}
    first = 7400 + 250 * domain + 10
    return len(ports & set(range(first, first + 240, 2)))


def crowded_words(count: int, domain: int) -> str:
    """A warning if so many programs in a domain do not all find each other; '' if they do."""
    if count <= MAX_LOCAL or os.environ.get(DISCOVERY_VARIABLES[0]) != 'LOCALHOST':
        return ''
    return (f'ROS domain {domain} has {count} programs on this machine, and with '
            f'ROS_AUTOMATIC_DISCOVERY_RANGE=LOCALHOST only {MAX_LOCAL} find each other: some '
            'nodes are invisible. Give each rig a ROS_DOMAIN_ID of its own, or set the range '
            'to SUBNET')


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
    """A value as YAML, in the numbers that rcl reads."""
    if isinstance(value, float):
        text = repr(value)
        return text if '.' in text else text.replace('e', '.0e')  # rcl takes 1e-07 for words
    if isinstance(value, (list, tuple)):
        return '[' + ', '.join(map(_yaml, value)) + ']'
    return json.dumps(value, ensure_ascii=False)


@dataclass
class NodeProcess:
    """One running node."""

    name: str
    process: Popen[bytes]
    log: Path

    @property
    def running(self) -> bool:
        return self.process.poll() is None

    def said(self) -> str:
        return self.log.read_text(errors='replace')


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

    def __enter__(self) -> 'NodeGroup':
        self._held = contextlib.ExitStack()
        if self.domain_id is None:
            self.domain_id = self._held.enter_context(own_domain())
        if self.log_folder is None:
            self.log_folder = self._held.enter_context(
                temporary_folder(Path(tempfile.gettempdir()), LOG_PREFIX))
        self.log_folder.mkdir(parents=True, exist_ok=True)
        self._read_end, write_end = os.pipe()
        for end in (self._read_end, write_end):
            self._held.callback(os.close, end)
        self._held.callback(self.stop)
        return self

    def __exit__(self, *_: object) -> None:
        self._held.close()

    @property
    def environment(self) -> dict[str, str]:
        """Environment of the nodes and of their clients: own domain, this machine only."""
        return {**os.environ, **transport_environment(), 'ROS_DOMAIN_ID': str(self.domain_id),
                'ROS_AUTOMATIC_DISCOVERY_RANGE': 'LOCALHOST', **(self.extra_environment or {})}

    def start(self, name: str, parameters: Values | None = None, *,
              files: Sequence[Path | str] = ()) -> NodeProcess:
        """Start the node `name` (a module of saddlering_ros.nodes) in a separate process."""
        assert self.log_folder is not None
        renamed = {'__ns': self.namespace} if self.namespace else {}
        log = self.log_folder / f'{name}.log'
        command = [sys.executable, '-m', f'saddlering_ros.nodes.{name}',
                   *ros_arguments(parameters, files, renamed)]
        with log.open('wb') as stream, signals_held():  # or nobody would know of the process
            process = Popen(command, stdin=DEVNULL, stdout=stream, stderr=STDOUT,
                            env={**self.environment, LIFELINE: str(self._read_end)},
                            pass_fds=(self._read_end,), start_new_session=True)
            self.processes[name] = NodeProcess(name, process, log)
        return self.processes[name]

    def wait(self, name: str, timeout: float) -> int:
        """Wait for a node to leave; its exit status. NodeError if it or another one fails."""
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
                why = (f' ({signal.Signals(-status).name}): start it again' if status < 0
                       else f': {last_line(node.said())}')
                raise NodeError(f'{node.name} ended with status {status}{why}')

    def stop(self) -> None:
        """End all nodes: SIGINT, SIGTERM after a while, SIGKILL after another."""
        try:
            for number, patience in zip((signal.SIGINT, signal.SIGTERM), PATIENCE, strict=True):
                self._signal(number)
                deadline = time.monotonic() + patience
                while time.monotonic() < deadline and any(
                        node.running for node in self.processes.values()):
                    time.sleep(0.01)
        finally:
            self._signal(signal.SIGKILL)
            for node in self.processes.values():
                node.process.wait()

    def _signal(self, number: signal.Signals) -> None:
        for node in self.processes.values():
            with contextlib.suppress(ProcessLookupError):
                if node.running:
                    os.killpg(node.process.pid, number)


def last_line(text: str) -> str:
    """The last line of a log that is not empty."""
    return next((line.strip() for line in reversed(text.splitlines()) if line.strip()),
                'no output')


@contextlib.contextmanager
def start_nodes(bag: Path | str, *, nodes: Sequence[str] = RING_NODES, rate: float = 0.0,
                parameters: Mapping[str, Values] | None = None, files: Sequence[Path | str] = (),
                domain_id: int | None = None, log_folder: Path | None = None,
                exit_at_end: bool = True, start_paused: bool = False, namespace: str = '') -> Any:
    """Replay `bag` to `nodes` in lockstep; yields the NodeGroup, ends every process on leaving.

    The clock starts last and waits for all others. `group.wait('replay_clock', timeout)` returns
    when the bag is at its end and everyone has dealt with it. `parameters` by node name.
    """
    parameters = parameters or {}
    streaming = [name for name in nodes if name in (*RING_NODES, *ALARM_NODES)]
    of_replay: dict[str, Values] = {
        **{name: {'bag': str(bag)} for name in (*REPLAY_NODES, 'ring_simulator')},
        'replay_clock': {
            'bag': str(bag), 'lockstep': True, 'rate': float(rate),
            'exit_at_end': exit_at_end, 'start_paused': start_paused,
            'participants': [*REPLAY_NODES, *streaming],
            **{name: value for name, value in parameters.get('ring_simulator', {}).items()
               if name == 'elevation_deg'}}}
    with NodeGroup(domain_id=domain_id, log_folder=log_folder, namespace=namespace,
                   extra_environment=transport_environment(PACKED)) as group:
        for name in (*nodes, *REPLAY_NODES, 'replay_clock'):
            group.start(name, {**of_replay.get(name, {}), **parameters.get(name, {})}, files=files)
        yield group


LIFELINE = 'SADDLERING_LIFELINE'
"""Environment variable with the number of the pipe's reading end."""

LAST_WORDS = 5.0  # [s]; nodes end within 2


def follow_lifeline() -> None:
    """Leave (SIGTERM to oneself, exit a while later) when the pipe's other end closes."""
    number = os.environ.pop(LIFELINE, '')
    if not number.isdigit():
        return

    def watch() -> None:
        with contextlib.suppress(OSError):
            while os.read(int(number), 1):
                pass
        os.kill(os.getpid(), signal.SIGTERM)
        threading.Event().wait(LAST_WORDS)
        os._exit(1)

    threading.Thread(target=watch, name='lifeline', daemon=True).start()


@contextlib.contextmanager
def signals_held() -> Iterator[None]:
    """A signal that would end this program acts when the block is done, not within it.

    Handlers hold it, and no mask, which a process that the block starts would inherit.
    """
    came: list[signal.Signals] = []
    handlers = {number: signal.getsignal(number) for number in (*SIGNALS, signal.SIGHUP)
                if threading.current_thread() is threading.main_thread()}
    held = {number: handler for number, handler in handlers.items()
            if handler not in (None, signal.SIG_IGN)}
    for number in held:
        signal.signal(number, lambda number, _: came.append(signal.Signals(number)))
    try:
        yield
    finally:
        for number, handler in held.items():
            signal.signal(number, handler)
        for number in came:
            signal.raise_signal(number)


def check_ros() -> None:
    """End a node in one line where ROS is missing, as in an environment of the wheel alone."""
    for package in ('rclpy', 'saddlering_interfaces'):
        if importlib.util.find_spec(package) is None:
            sys.exit(f'{Path(sys.argv[0]).name}: Python package {package} is not installed here; '
                     'docs/install.md states how ROS 2 Jazzy gets there')


DISCOVERY_VARIABLES = ('ROS_AUTOMATIC_DISCOVERY_RANGE', 'ROS_LOCALHOST_ONLY')
PROFILE_VARIABLES = ('FASTRTPS_DEFAULT_PROFILES_FILE', 'FASTDDS_DEFAULT_PROFILES_FILE')
MAX_LOCAL = 32
"""Programs of a domain that find each other on one machine with the range LOCALHOST: the number
of ports that rmw_fastrtps announces itself to, which no profile can raise."""

PUBLICATION_VARIABLE = 'RMW_FASTRTPS_PUBLICATION_MODE'
PROMPT, PACKED = 'SYNCHRONOUS', 'ASYNCHRONOUS'
"""Prompt, a message is on its way before `publish` returns. Packed, messages that wait go out
together: for nodes in lockstep, where throughput counts and latency does not. The thread that
sends them takes part of the processor from the publishing one, and delays a stream in real time.
"""


def transport_environment(publication: str = PROMPT) -> dict[str, str]:
    """Environment that a process needs, before rclpy.init, to use config/fastdds.xml.

    Empty if the user has chosen a file. Other middlewares ignore it. It sets no publication mode.
    """
    if any(os.environ.get(name) for name in PROFILE_VARIABLES):
        return {}
    return {PROFILE_VARIABLES[0]: str(share_directory() / 'config' / 'fastdds.xml'),
            PUBLICATION_VARIABLE: os.environ.get(PUBLICATION_VARIABLE) or publication}


def prepare_middleware() -> None:
    """Set the transport of this process, keep its discovery here; FileConflict if that cannot be.

    The user may have chosen a range. ROS 2's own default is the subnet: everybody there could see
    the topics, call services, send goals and publish loads.
    """
    logs = os.environ.get('ROS_LOG_DIR') or f'{os.environ.get("ROS_HOME") or "~/.ros"}/log'
    check_writable(Path(logs).expanduser(), f'log folder {logs} (ROS_LOG_DIR)')
    for name in PROFILE_VARIABLES:
        if (file := os.environ.get(name)) and not Path(file).is_file():
            raise FileConflict(f'{name} is {file!r}, and there is no such file: correct it, or '
                               'unset it: nodes then take config/fastdds.xml')
    os.environ.update(transport_environment())
    if not any(os.environ.get(name) for name in DISCOVERY_VARIABLES):
        os.environ[DISCOVERY_VARIABLES[0]] = 'LOCALHOST'


RECEIVE_BUFFER = 1 << 20
"""Bytes of a socket for what a node has not read yet. The 208 kB of Linux hold 160 messages: of a
driver that sends blocks of 250, a quarter came 3 s later, when the driver's middleware asked."""


def widen_sockets() -> None:
    """Ask for larger receive buffers: rmw_fastrtps takes none from a profile with LOCALHOST."""
    for number in map(int, os.listdir('/proc/self/fd')):
        with contextlib.suppress(OSError):  # of the folder itself, which is closed by now
            if not stat.S_ISSOCK(os.fstat(number).st_mode):
                continue  # `fromfd` would leave a copy of it open
            with socket.fromfd(number, socket.AF_INET, socket.SOCK_DGRAM) as one:
                one.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, RECEIVE_BUFFER)


def sweep(folder: Path = Path('/dev/shm')) -> int:
    """Remove the segments of Fast DDS that no living process holds; how many.

    Fast DDS keeps a lock on `<name>_el` for as long as the owner of `<name>` lives; the lock ends
    with the process, however it ends. Each segment left behind costs half a megabyte of memory.
    Ports are left alone: Fast DDS itself makes a dead one anew when it is next used.
    """
    return sum(remove_unlocked(lock, lock.with_name(lock.name.removesuffix('_el')), lock)
               for lock in folder.glob('fastrtps_*_el')
               if not lock.name.startswith('fastrtps_port'))
