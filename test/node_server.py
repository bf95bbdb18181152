"""Starts nodes of tests by a fork of one process that has imported all of them.

An interpreter that imports a node costs half a second of processor time, a simulator two; a fork
starts and ends with a tenth, and the gate starts about two hundred. A forked node runs the same
`main()` in a process, a session and a log of its own. Tests marked `interpreters` start the
interpreters that a user starts.
"""

from collections.abc import Mapping, Sequence
import contextlib
import gc
import importlib
import inspect
import json
import os
from pathlib import Path
import signal
import socket
import subprocess
import sys
import time
import traceback
import types
from typing import Any

from saddlering_ros.ros.launcher import LIFELINE

PREFIX = 'saddlering_ros.nodes.'
NEEDED_BY_WORKERS = ('saddlering_ros.api.functions', 'saddlering_ros.jobs.worker')
MAX_REQUEST = 1 << 20
TICKS = os.sysconf('SC_CLK_TCK')


class NodeServer:
    """The process that forks nodes."""

    def __init__(self) -> None:
        ours, theirs = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
        for end in (ours, theirs):
            end.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, MAX_REQUEST)
        with theirs:
            self._process = subprocess.Popen(
                [sys.executable, __file__, str(theirs.fileno())], stdin=subprocess.DEVNULL,
                pass_fds=(theirs.fileno(),), start_new_session=True,
                env={**os.environ, 'SADDLERING_THREADS': '1'})  # a thread does not survive a fork
        self._socket = ours
        self.newest: dict[str, int] = {}
        """Process of each node that was started last, by its name."""

    def popen(self, command: Sequence[str], *, stdout: Any, env: Mapping[str, str],
              pass_fds: Sequence[int], **options: Any) -> Any:
        """Stand in for the `subprocess.Popen` of the launcher."""
        module = command[2] if command[1:2] == ['-m'] else ''
        if not module.startswith(PREFIX):
            return subprocess.Popen(command, stdout=stdout, env=env, pass_fds=pass_fds, **options)
        lifeline, = pass_fds
        number = self._ask({'module': module, 'words': command[3:], 'env': dict(env),
                            'folder': str(Path.cwd())}, (stdout.fileno(), lifeline))
        self.newest[module.removeprefix(PREFIX)] = number
        return ForkedNode(self, number, command)

    def status(self, number: int) -> int | None:
        """Exit status of a node; None while it runs."""
        found: int | None = self._ask({'status': number})
        return found

    def processor_seconds(self) -> float:
        """What the server and its ended nodes have computed so far [s]."""
        with contextlib.suppress(OSError):
            fields = Path(f'/proc/{self._process.pid}/stat').read_text().rpartition(')')[2].split()
            return sum(map(int, fields[11:15])) / TICKS
        return 0.0

    def close(self) -> None:
        """End the server."""
        self._socket.close()
        self._process.wait()

    def _ask(self, question: Mapping[str, Any], files: Sequence[int] = ()) -> Any:
        socket.send_fds(self._socket, [json.dumps(question).encode()], files)
        answer = self._socket.recv(MAX_REQUEST)
        if not answer:
            raise RuntimeError('the server of nodes has ended')
        return json.loads(answer)


class ForkedNode:
    """A running node, with the part of `subprocess.Popen` that the launcher and tests use."""

    def __init__(self, server: NodeServer, number: int, command: Sequence[str]) -> None:
        self._server = server
        self.pid, self.args = number, command
        self.returncode: int | None = None

    def poll(self) -> int | None:
        """Exit status, or None."""
        if self.returncode is None:
            self.returncode = self._server.status(self.pid)
        return self.returncode

    def wait(self, timeout: float | None = None) -> int:
        """Wait until it ends; its exit status."""
        deadline = None if timeout is None else time.monotonic() + timeout
        while (status := self.poll()) is None:
            if deadline is not None and time.monotonic() > deadline:
                raise subprocess.TimeoutExpired(list(self.args), timeout or 0.0)
            time.sleep(0.01)
        return status

    def send_signal(self, number: int) -> None:
        """Send a signal, unless it has ended."""
        if self.poll() is None:
            os.kill(self.pid, number)

    def kill(self) -> None:
        """SIGKILL."""
        self.send_signal(signal.SIGKILL)

    def terminate(self) -> None:
        """SIGTERM."""
        self.send_signal(signal.SIGTERM)


# --- in the server ---


def serve(pipe: socket.socket) -> None:
    """Import all nodes, then fork and report until the tests are gone."""
    from saddlering_ros.ring.warm import warm
    from saddlering_ros.ros.names import NODES
    for module in (*(node.module for node in NODES), *NEEDED_BY_WORKERS):
        importlib.import_module(module)
    warm()
    _prepare_for_all()
    gc.collect()
    gc.freeze()
    ended: dict[int, int] = {}
    while True:
        data, files, _, _ = socket.recv_fds(pipe, MAX_REQUEST, 4)
        if not data:
            return
        question = json.loads(data)
        if 'status' in question:
            answer = _status(question['status'], ended)
        else:
            answer = _forked(question, files, pipe)
        for number in files:
            os.close(number)
        pipe.send(json.dumps(answer).encode())


def _prepare_for_all() -> None:
    """Do what every node does at its start, once: two thirds of its processor time.

    The first line of a log looks for its caller in the files of all modules, and each kind of
    message loads a library when it is first used.
    """
    inspect.getframeinfo(sys._getframe())
    for name, module in list(sys.modules.items()):
        if not name.endswith(('.msg', '.srv', '.action')):
            continue
        for kind in map(type, list(vars(module).values())):
            if hasattr(kind, '__import_type_support__'):
                kind.__import_type_support__()


def _status(number: int, ended: dict[int, int]) -> int | None:
    if number not in ended:
        found, status = os.waitpid(number, os.WNOHANG)
        if not found:
            return None
        ended[number] = os.waitstatus_to_exitcode(status)
    return ended[number]


def _forked(question: dict[str, Any], files: Sequence[int], pipe: socket.socket) -> int:
    """Fork a node; its number, once it leads a session of its own."""
    ready, tell = os.pipe()
    number = os.fork()
    if number:
        os.close(tell)
        os.read(ready, 1)
        os.close(ready)
        return number
    try:
        os.setsid()
        os.close(ready)
        os.close(tell)
        pipe.close()
        _become(question, *files)
    except BaseException:
        traceback.print_exc()
    finally:
        sys.stderr.flush()
        os._exit(1)


def _become(question: dict[str, Any], output: int, lifeline: int) -> None:
    """Be what `python -m MODULE WORDS` would be."""
    from saddlering_ros.nodes import end_at_once
    os.dup2(output, 1)
    os.dup2(output, 2)
    os.close(output)
    os.chdir(question['folder'])
    os.environ.clear()
    os.environ.update({**question['env'], LIFELINE: str(lifeline)})
    module = question['module']
    sys.argv = [str(importlib.import_module(module).__file__), *question['words']]
    sys.orig_argv = [sys.executable, '-m', module, *question['words']]
    end_at_once()
    # What was imported stays exempt from collections. At its end a node has only its own objects
    # collected, where a user's looks at those of all libraries.
    gc.freeze = gc.unfreeze = lambda: None  # type: ignore[assignment]
    _fork_workers_too()
    importlib.import_module(module).main()
    os._exit(0)


class ForkedWorker:
    """The worker of a forked node: a fork as well, for two seconds of an interpreter.

    The part of `subprocess.Popen` that `saddlering_ros.jobs.worker` uses.
    """

    def __init__(self, command: Sequence[str], *, pass_fds: Sequence[int],
                 env: Mapping[str, str], **_: Any) -> None:
        self.returncode: int | None = None
        self.pid = os.fork()
        if not self.pid:
            try:
                _work(command[3:], pass_fds, env)
            except BaseException:
                traceback.print_exc()
            finally:
                sys.stderr.flush()
                os._exit(1)

    def poll(self) -> int | None:
        """Exit status, or None."""
        return self._waited(os.WNOHANG)

    def wait(self) -> int:
        """Wait until it ends; its exit status."""
        status = self._waited(0)
        assert status is not None
        return status

    def kill(self) -> None:
        """SIGKILL, unless it has ended."""
        if self.poll() is None:
            os.kill(self.pid, signal.SIGKILL)

    def _waited(self, option: int) -> int | None:
        if self.returncode is None:
            found, status = os.waitpid(self.pid, option)
            if found:
                self.returncode = os.waitstatus_to_exitcode(status)
        return self.returncode


def _fork_workers_too() -> None:
    from saddlering_ros.jobs import worker
    worker.subprocess = types.SimpleNamespace(  # type: ignore[assignment]
        Popen=ForkedWorker, DEVNULL=subprocess.DEVNULL)


def _work(words: Sequence[str], kept: Sequence[int], environment: Mapping[str, str]) -> None:
    """Be what `python -m saddlering_ros.jobs.worker WORDS` would be."""
    from saddlering_ros.jobs import worker
    os.setsid()
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, signal.SIG_DFL)
    for number in map(int, os.listdir('/proc/self/fd')):  # those of the node's middleware
        if number > 2 and number not in kept:
            with contextlib.suppress(OSError):
                os.close(number)
    os.environ.clear()
    os.environ.update(environment)
    sys.argv = [str(worker.__file__), *words]
    worker.main()
    os._exit(0)


if __name__ == '__main__':
    serve(socket.socket(fileno=int(sys.argv[1])))
