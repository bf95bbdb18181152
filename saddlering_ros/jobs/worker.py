"""Heavy work in a separate process, so that the node's callbacks go on; a cancel kills it.

    python -m saddlering_ros.jobs.worker FD MODULE      (started by `Worker`, never by hand)

MODULE has `run(request, on_progress, is_cancelled) -> answer`, with the protocol of the API;
PRELOADED, if any, names the modules that `run` needs.
Values pass by a pipe that only this process and the child it started hold, so that pickles, which
could carry code, come from our own code alone.
"""

from collections.abc import Callable, Mapping
import contextlib
import importlib
from multiprocessing.connection import Connection, Pipe
import os
import signal
import subprocess
import sys
import threading
import time
from typing import Any

from saddlering_ros.errors import Cancelled, SaddleringError
from saddlering_ros.progress import IsCancelled, OnProgress, Progress
from saddlering_ros.ros.launcher import follow_lifeline, LIFELINE

POLL = 0.02
"""Period at which `is_cancelled` is asked while a job runs [s]."""

NICENESS = 5
"""The nodes that follow the rig go first."""

DONE, REFUSED, FAILED, CANCELED = 'done', 'refused', 'failed', 'canceled'
Outcome = tuple[str, Any]
"""How a job ended: DONE with its answer, CANCELED with that or a reason, else with a reason."""

Patience = Callable[[Progress], float]
"""Time [s] that a cancel leaves a job after this progress for the answer that is complete."""


class Worker:
    """One worker process, kept ready: its modules are loaded before the first job comes."""

    def __init__(self, module: str, environment: Mapping[str, str] | None = None) -> None:
        """environment: variables of the process beside those of this one."""
        self._module = module
        self._environment = environment or {}
        self._process: subprocess.Popen[bytes] | None = None
        self._pipe: Connection | None = None
        self._life: int | None = None
        self._starting = threading.Lock()
        self.start()

    def start(self) -> None:
        """Start the process, unless it runs. May be called from several threads."""
        with self._starting:
            if self._process is not None and self._process.poll() is None:
                return
            self.close()
            self._pipe, theirs = Pipe()
            read_end, self._life = os.pipe()
            self._process = subprocess.Popen(
                [sys.executable, '-m', __name__, str(theirs.fileno()), self._module],
                stdin=subprocess.DEVNULL, pass_fds=(theirs.fileno(), read_end),
                start_new_session=True, env={**os.environ, **self._environment,
                                             LIFELINE: str(read_end)})
            os.close(read_end)
            theirs.close()

    def run(self, request: Any, on_progress: OnProgress, is_cancelled: IsCancelled,
            patience: Patience = lambda _: 0.0) -> Outcome:
        """Do one job, with the progress and cancel protocol of the API.

        Blocks until the job has ended; call it from a thread. If is_cancelled returns True, the
        process is killed, in the middle of any work, and `Cancelled` is raised with the answer
        as `partial` that it gives within `patience`.
        """
        self.start()
        assert self._pipe is not None
        seconds = 0.0
        try:
            self._pipe.send(request)
            while True:
                if self._pipe.poll(POLL):
                    kind, value = self._pipe.recv()
                    if kind != 'progress':
                        return kind, value
                    on_progress(value)
                    seconds = patience(value)
                if is_cancelled():
                    raise Cancelled(partial=self._stop(seconds))
        except (EOFError, OSError):
            status = self.kill()
            remedy = ', as without free memory: use fewer workers or shorter bags'
            return FAILED, (f'the worker process ended with status {status}'
                            + remedy * (status == -signal.SIGKILL))

    def _stop(self, seconds: float) -> Any:
        """End the process; the answer that its job gives within `seconds`, or None."""
        end, answer = time.monotonic() + seconds, None
        assert self._pipe is not None
        with contextlib.suppress(EOFError, OSError):
            if seconds:
                self._pipe.send(None)
            while (left := end - time.monotonic()) > 0.0 and self._pipe.poll(left):
                kind, value = self._pipe.recv()
                if kind != 'progress':
                    answer = value if kind in (DONE, CANCELED) else None
                    break
        self.kill()
        return answer

    def kill(self) -> int:
        """End the process at once; its exit status."""
        if self._process is None:
            return 0
        self._process.kill()
        return self._process.wait()

    def close(self) -> None:
        self.kill()
        if self._pipe is not None:
            self._pipe.close()
        if self._life is not None:
            os.close(self._life)
        self._process = self._pipe = self._life = None


def main() -> None:
    """Serve the process that started this one: do jobs until the other end is gone."""
    follow_lifeline()
    with contextlib.suppress(OSError):
        os.nice(NICENESS)
    number, module = sys.argv[1:]
    pipe = Connection(int(number))
    job = importlib.import_module(module)
    for needed in getattr(job, 'PRELOADED', ()):
        importlib.import_module(needed)
    with contextlib.suppress(EOFError):  # the other end is gone
        while True:
            request = pipe.recv()
            try:
                # Whatever comes meanwhile is the wish to stop.
                answer = DONE, job.run(
                    request, lambda progress: pipe.send(('progress', progress)), pipe.poll)
            except Cancelled as stopped:
                answer = CANCELED, stopped.partial
            except SaddleringError as problem:
                answer = REFUSED, ' '.join(str(problem).split())
            except Exception as problem:
                answer = FAILED, f'{type(problem).__name__}: {" ".join(str(problem).split())}'
            pipe.send(answer)


if __name__ == '__main__':
    main()
