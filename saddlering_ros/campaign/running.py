"""How a campaign runs: tasks go to slots, a few at a time, until every session has its result.

A slot is a thread, of this process or of a Dask worker, that waits for a worker process of its
own. The process judges one session after the other; it is killed at the time limit of a session,
on cancel, and with its starter. Dask's local cluster is not used on one machine: it starts no
faster (2 to 4 s against 1.5 to 2.5 s for two slots on two busy processors), it ends no task at
its time limit, and every campaign would need Dask.
"""

from collections import Counter, deque
from collections.abc import Callable, Iterator, Sequence
from concurrent import futures
from contextlib import contextmanager
from dataclasses import dataclass, replace
import os
import threading
import time
from typing import Any
from urllib.parse import urlsplit

from saddlering_ros.campaign.store import CampaignError, CampaignInterruptedError, Status, Store
from saddlering_ros.campaign.task import failure, SessionTask
from saddlering_ros.errors import Cancelled, SaddleringError
from saddlering_ros.files import versions_in_use
from saddlering_ros.jobs.worker import DONE, Worker

CONNECT_SECONDS = 10.0
"""Longest wait [s] for a scheduler; a person waits for the message meanwhile."""
LOOPBACK = ('localhost', '127.0.0.1', '::1')

ONE_THREAD = dict.fromkeys(
    ('OMP_NUM_THREADS', 'OPENBLAS_NUM_THREADS', 'MKL_NUM_THREADS', 'SADDLERING_THREADS'), '1')

TASKS_A_SLOT = 2
"""Tasks submitted at most for each slot: one that runs and one that waits."""

MAX_LOST_WORKERS = 3
"""Number of workers that died with a task after which it is given up."""

STATUS_SECONDS = 1.0
"""Between two writings of the status [s], which people read."""
HEARTBEAT = 2.0
"""Longest time [s] between two looks at whether the executor is alive."""


class Slot:
    """The worker process of one thread."""

    def __init__(self) -> None:
        self._worker: Worker | None = None
        self._stopped = False

    def judge(self, task: SessionTask) -> dict[str, Any]:
        """The verdict on a task's session, or why there is none; a failure is an answer too."""
        if task.problem:
            return failure('refused', task.problem)
        if self._worker is None:
            self._worker = Worker('saddlering_ros.campaign.task', ONE_THREAD)
        end = time.monotonic() + task.seconds
        try:
            kind, answer = self._worker.run(
                task, lambda progress: None, lambda: self._stopped or time.monotonic() > end)
        except Cancelled:
            if self._stopped:
                raise CampaignInterruptedError('the campaign was stopped') from None
            return failure('timeout', f'no verdict within {task.seconds:g} s: give a '
                                      'larger --time-limit, and --retry')
        if kind != DONE:
            return failure('killed', f'{answer}: run the campaign with --retry')
        if answer.get('kind') == 'memory':
            self._worker.kill()  # what is left of its memory is in pieces
        return answer

    def stop(self) -> None:
        """End the present computation at once; its task gets no result. For another thread."""
        self._stopped = True

    def close(self) -> None:
        if self._worker is not None:
            self._worker.close()


def document_of(task: SessionTask, seconds: float, answer: dict[str, Any]) -> dict[str, Any]:
    """The result document of an answer to a task."""
    return {'key': task.key, 'attempt': task.attempt, 'task': task.as_dict(), 'seed': task.seed,
            'versions': versions_in_use(), 'seconds': seconds, **answer}


class _Thread(threading.local):
    """The slot of each thread: executors hand tasks to threads, not to objects."""

    def __init__(self) -> None:
        self.slot = Slot()


_THREAD = _Thread()


def execute(task: SessionTask, store: Store) -> str:
    """What an executor is given: judge a task, unless it has a result; its key."""
    if not store.has_result(task.key, task.attempt):
        began = time.monotonic()
        answer = _THREAD.slot.judge(task)
        store.write_result(document_of(task, time.monotonic() - began, answer))
    return task.key


@dataclass(frozen=True)
class Workers:
    """An executor, its tasks at a time, whether it is there; local: its slots in this process."""

    executor: futures.Executor
    slots: int
    alive: Callable[[], bool] = lambda: True
    warning: str = ''
    local: Sequence[Slot] = ()


@contextmanager
def local_workers(jobs: int | None = None) -> Iterator[Workers]:
    """`jobs` slots of this machine (default: its processors)."""
    count = jobs or len(os.sched_getaffinity(0))
    slots: list[Slot] = []
    executor = futures.ThreadPoolExecutor(count, thread_name_prefix='slot',
                                          initializer=lambda: slots.append(_THREAD.slot))
    try:
        yield Workers(executor, count, local=slots)
    finally:
        executor.shutdown(wait=False, cancel_futures=True)
        for slot in slots:
            slot.stop()
        executor.shutdown()
        for slot in slots:
            slot.close()


def _warning(address: str) -> str:
    parts = urlsplit(address if '//' in address else f'//{address}')
    if parts.scheme == 'tls' or (parts.hostname or '') in LOOPBACK:
        return ''
    return (f'{address} is reached without TLS: anyone on that network can run programs on the '
            'workers (see docs/campaigns.md)')


@contextmanager
def dask_workers(address: str) -> Iterator[Workers]:
    """The workers of the Dask scheduler at `address`, one task a thread."""
    try:
        from distributed import Client
    except ModuleNotFoundError as problem:
        raise CampaignError("--scheduler needs Dask: pip install 'saddlering_ros[cluster]'"
                            ) from problem
    try:
        client = Client(address, timeout=CONNECT_SECONDS, set_as_default=False)
    except (OSError, ValueError, TimeoutError) as problem:
        raise CampaignError(f'no Dask scheduler answers at {address}: start one with "dask '
                            'scheduler --no-dashboard" and give its address') from problem
    try:
        slots = sum(client.nthreads().values())
        if not slots:
            raise CampaignError(f'the Dask scheduler at {address} has no workers: start some with '
                                f'"dask worker {address} --nthreads 1"')
        yield Workers(client.get_executor(pure=False), slots,
                      lambda: client.status == 'running', _warning(address))
    finally:
        client.close(timeout=2.0)


def run_campaign(tasks: Sequence[SessionTask], store: Store, workers: Workers, *,
                 retry: bool = False,
                 on_status: Callable[[Status], None] = lambda status: None) -> Status:
    """Compute the missing results until every task has one; `retry` repeats failures.

    Where the workers are gone, or a result cannot be written, the campaign ends with
    CampaignError. The next call continues it.
    """
    store.prepare()
    status = Status(len(tasks), started=time.time(), updated=time.time(), slots=workers.slots)
    waiting = _waiting(tasks, store, status, retry=retry)
    running: dict[futures.Future[str], SessionTask] = {}
    lost: Counter[str] = Counter()
    store.write_status(status)
    there = Store(store.folder.resolve())  # also for a worker in another folder
    try:
        while waiting or running:
            while waiting and len(running) < TASKS_A_SLOT * workers.slots:
                task = waiting.popleft()
                running[workers.executor.submit(execute, task, there)] = task
            finished, _ = futures.wait(
                running, timeout=HEARTBEAT, return_when=futures.FIRST_COMPLETED)
            is_late = not finished
            for future in finished:
                task = running.pop(future)
                document = _result_of(future, task, store, lost)
                if document is None:
                    waiting.append(task)
                    is_late = True
                else:
                    status.add(document, new=True)
            if is_late and not workers.alive():
                raise CampaignInterruptedError(
                    f'the scheduler no longer answers; {status.done} of {len(tasks)} sessions '
                    'have a result: start it again and repeat the command')
            if time.time() - status.updated >= STATUS_SECONDS:
                status.updated = time.time()
                store.write_status(status)
                on_status(status)
    finally:
        for future in running:
            future.cancel()
        status.updated, status.running = time.time(), False
        store.write_status(status)
    on_status(status)
    return status


def _waiting(tasks: Sequence[SessionTask], store: Store, status: Status, *,
             retry: bool) -> deque[SessionTask]:
    """The tasks without a whole result, with `retry` failed ones too; the others are counted.

    A whole result is of the task's data, with the report that the task asks for.
    """
    waiting = deque[SessionTask]()
    for task in tasks:
        document = store.read_result(task.key)
        if document is None:
            place = store.place_of(task.key)
            status.altered += [str(place)] if place.exists() else []
            waiting.append(task)
            continue
        if document['status'] == 'failed':
            is_whole = not retry and document.get('kind') not in ('changed', 'unwritten')
        else:
            is_whole = (not task.reports or document['task']['reports']
                        or document['verdict']['verdict'] == 'none')
        if is_whole:
            status.add(document, new=False)
        else:
            waiting.append(replace(task, attempt=int(document.get('attempt', 0)) + 1))
    return waiting


def _result_of(future: futures.Future[str], task: SessionTask, store: Store,
               lost: Counter[str]) -> dict[str, Any] | None:
    """The result of a finished task, or None to try again; lost: dead workers by task."""
    try:
        future.result()
    except SaddleringError:
        raise  # the store cannot be written: no other task would fare better
    except (Exception, futures.CancelledError) as problem:
        # The result may have been written before the worker died.
        if not store.has_result(task.key, task.attempt):
            lost[task.key] += 1
            if lost[task.key] < MAX_LOST_WORKERS:
                return None
            store.write_result(document_of(task, 0.0, failure(
                'worker', f'{MAX_LOST_WORKERS} workers died during this session '
                f'({type(problem).__name__}): run the campaign with --retry')))
    document = store.read_result(task.key)
    if document is None:
        raise CampaignError(f'{store.place_of(task.key)}: was reported as written and is missing: '
                            'give workers and coordinator the same --out folder')
    return document
