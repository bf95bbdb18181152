"""The process behind one slot: it loads the program once and forks a child for each session.

`SessionRunner` starts it. Each line on standard input is a task with the path of its answer; each
line on standard output reports how its child ended. A fork costs milliseconds where a new
interpreter costs seconds. The child has one thread, its own memory limit, and is killed at its
time limit or with its parent.
"""

from __future__ import annotations

from collections.abc import Callable
import ctypes
import importlib
import json
import os
from pathlib import Path
import resource
import select
import signal
import sys
import time
from typing import Any

from saddlering_ros.campaign.task import SessionTask, task_from
from saddlering_ros.errors import SaddleringError

POLL = 0.02
"""Longest time [s] between two looks at whether the child has ended."""

_PR_SET_PDEATHSIG = 1

ENDED, TIMED_OUT, ORPHANED = 'ended', 'timed out', 'orphaned'


def main() -> None:
    """Serve tasks until standard input closes."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # the terminal's Ctrl-C is for the coordinator
    for line in sys.stdin:
        request = json.loads(line)
        task = task_from(request['task'])
        compute = _load(task.compute)
        process = os.fork()
        if process == 0:
            _work(task, compute, Path(request['answer']))
        how, status = _wait(process, task.limits.seconds)
        if how == ORPHANED:
            return
        print(json.dumps({'how': how, 'status': status}), flush=True)


def _load(name: str) -> Callable[[SessionTask], dict[str, Any]]:
    """The computing function; every child shares the modules that are loaded here."""
    module, _, function = name.partition(':')
    found: Callable[[SessionTask], dict[str, Any]] = getattr(
        importlib.import_module(module), function)
    prepare = getattr(importlib.import_module(module), 'prepare', None)
    if prepare is not None:
        prepare()
    return found


def _wait(process: int, seconds: float) -> tuple[str, int]:
    """Wait for the child; end it at its time limit or when its waiter is gone."""
    end = time.monotonic() + seconds
    pause = 0.001
    while True:
        done, status = os.waitpid(process, os.WNOHANG)
        if done:
            return ENDED, os.waitstatus_to_exitcode(status)
        gone = bool(select.select([sys.stdin], [], [], pause)[0])
        pause = min(2.0 * pause, POLL)
        if gone or time.monotonic() > end:
            os.kill(process, signal.SIGKILL)
            os.waitpid(process, 0)
            return (ORPHANED if gone else TIMED_OUT), 0


def _work(
    task: SessionTask, compute: Callable[[SessionTask], dict[str, Any]], answer: Path
) -> None:
    """Compute in the child, write the answer, and leave without the parent's clean-up."""
    ctypes.CDLL(None).prctl(_PR_SET_PDEATHSIG, signal.SIGKILL)
    status = 1
    try:
        nothing = os.open(os.devnull, os.O_RDWR)
        os.dup2(nothing, 0)
        os.dup2(nothing, 1)
        _limit_memory(task.limits.memory)
        answer.write_text(json.dumps(_attempt(task, compute)), encoding='utf-8')
        status = 0
    finally:
        os._exit(status)


def _limit_memory(size: int) -> None:
    """Allow `size` bytes of address space beyond those mapped already."""
    mapped = int(Path('/proc/self/statm').read_text().split()[0]) * resource.getpagesize()
    resource.setrlimit(resource.RLIMIT_AS, (mapped + size, mapped + size))


def _attempt(
    task: SessionTask, compute: Callable[[SessionTask], dict[str, Any]]
) -> dict[str, Any]:
    try:
        return {'status': 'done', **compute(task)}
    except SaddleringError as problem:
        return failure('refused', ' '.join(str(problem).split()))
    except MemoryError:
        return failure('memory', f'{task.name}: needs more than {task.limits.memory >> 20} MB: '
                                  'give a larger --memory-limit')
    except Exception as problem:
        words = ' '.join(str(problem).split())
        return failure('failed', f'{type(problem).__name__}: {words}')


def failure(kind: str, reason: str) -> dict[str, Any]:
    """Entry of a result that has no verdict."""
    return {'status': 'failed', 'kind': kind, 'reason': reason}
