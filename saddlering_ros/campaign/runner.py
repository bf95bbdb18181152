"""Diagnosis of one session in a child process with limits; its result goes into the store."""

from __future__ import annotations

import contextlib
import json
import os
from pathlib import Path
import subprocess
import sys
import tempfile
import threading
import time
from typing import Any

from saddlering_ros.campaign.child import failure, TIMED_OUT
from saddlering_ros.campaign.errors import CampaignInterruptedError
from saddlering_ros.campaign.store import Store
from saddlering_ros.campaign.task import SessionTask, task_from
from saddlering_ros.files import temporary_folder, versions_in_use

ONE_THREAD = dict.fromkeys(
    ('OMP_NUM_THREADS', 'OPENBLAS_NUM_THREADS', 'MKL_NUM_THREADS', 'SADDLERING_THREADS'), '1')


START = 'from saddlering_ros.campaign.child import main; main()'
"""Command of the child process; by name, because its module is imported here already."""


class SessionRunner:
    """A slot: the child process that judges sessions one after the other."""

    def __init__(self) -> None:
        self._process: subprocess.Popen[str] | None = None
        self._stopped = False

    def run(self, task: SessionTask) -> dict[str, Any]:
        """The result document of a task; a failure of any kind is a result too."""
        began = time.monotonic()
        if task.problem:
            answer: dict[str, Any] = failure('refused', task.problem)
        else:
            answer = self._ask(task)
        return {
            'key': task.key, 'attempt': task.attempt, 'task': task.as_dict(), 'seed': task.seed,
            'versions': versions_in_use(), 'seconds': time.monotonic() - began, **answer,
        }

    def _ask(self, task: SessionTask) -> dict[str, Any]:
        with temporary_folder(Path(tempfile.gettempdir()), 'saddlering-') as folder:
            place = folder / 'answer.json'
            request = json.dumps({'task': task.as_dict(), 'answer': str(place)})
            try:
                process = self._ready()
                assert process.stdin is not None
                assert process.stdout is not None
                process.stdin.write(request + '\n')
                process.stdin.flush()
                report = json.loads(process.stdout.readline())
            except (OSError, ValueError):
                self.close()
                if self._stopped:
                    raise CampaignInterruptedError('the campaign was stopped') from None
                return failure('killed', 'the process of the sessions was killed: run the '
                                         'campaign with --retry')
            if report['how'] == TIMED_OUT:
                return failure('timeout', f'no verdict within {task.limits.seconds:g} s: '
                                          'give a larger --time-limit')
            if report['status'] != 0 or not place.exists():
                return failure('killed', f'its process ended with status {report["status"]}: '
                                         'run the campaign with --retry')
            answer: dict[str, Any] = json.loads(place.read_text(encoding='utf-8'))
            return answer

    def _ready(self) -> subprocess.Popen[str]:
        if self._process is None or self._process.poll() is not None:
            self.close()
            self._process = subprocess.Popen(
                [sys.executable, '-c', START], text=True,
                stdin=subprocess.PIPE, stdout=subprocess.PIPE, env={**os.environ, **ONE_THREAD})
        return self._process

    def stop(self) -> None:
        """End the present computation at once; its task gets no result. For another thread."""
        self._stopped = True
        process = self._process
        if process is not None:
            process.kill()

    def close(self) -> None:
        """End the child process and its computation."""
        process, self._process = self._process, None
        if process is None:
            return
        with contextlib.suppress(OSError):
            if process.stdin is not None:
                process.stdin.close()
        try:
            process.wait(timeout=2.0)
        except subprocess.TimeoutExpired:
            process.kill()
            process.wait()
        if process.stdout is not None:
            process.stdout.close()


class _Slot(threading.local):
    """The runner of each thread: executors hand tasks to threads, not to objects."""

    def __init__(self) -> None:
        self.runner = SessionRunner()


_SLOT = _Slot()


def runner_of_this_thread() -> SessionRunner:
    """The runner that `execute` uses in the calling thread."""
    return _SLOT.runner


def execute(document: dict[str, Any], folder: str) -> str:
    """Judge the session of a task's plain data, unless its result is in the store; its key.

    This function is all that an executor, local or Dask, is given.
    """
    task, store = task_from(document), Store(Path(folder))
    if store.has_result(task.key, task.attempt):
        return task.key
    store.write_result(runner_of_this_thread().run(task))
    return task.key
