"""Submission of tasks to an executor, a few at a time, until every session has its result."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Sequence
from concurrent.futures import CancelledError, Executor, FIRST_COMPLETED, Future, wait
from dataclasses import dataclass, field, replace
import time

from saddlering_ros.campaign.errors import CampaignError, CampaignInterruptedError
from saddlering_ros.campaign.runner import execute
from saddlering_ros.campaign.store import Status, Store
from saddlering_ros.campaign.task import SessionTask
from saddlering_ros.errors import SaddleringError

TASKS_A_SLOT = 2
"""Tasks submitted at most for each slot: one that runs and one that waits."""

MAX_LOST_WORKERS = 3
"""Number of workers that died with a task after which it is given up."""

STATUS_SECONDS = 1.0
HEARTBEAT = 2.0
"""Longest time [s] between two looks at whether the executor is alive."""


@dataclass(frozen=True)
class Summary:
    """Of all sessions of a campaign, how many have a result, how many of these are failures.

    computed: in this run; faults: failures of our own, not of the bags.
    """

    total: int
    done: int
    failed: int
    computed: int
    faults: int


@dataclass
class _Count:
    done: int = 0
    failed: int = 0
    computed: int = 0
    faults: int = 0

    def add(self, document: dict[str, object], *, new: bool) -> None:
        self.done += 1
        self.computed += new
        if document['status'] == 'failed':
            self.failed += 1
            self.faults += document.get('kind') != 'refused'


def run_campaign(
    tasks: Sequence[SessionTask], store: Store, executor: Executor, slots: int, *,
    retry: bool = False, alive: Callable[[], bool] = lambda: True,
    on_status: Callable[[Status], None] = lambda status: None,
) -> Summary:
    """Compute the missing results until every task has one; `retry` repeats failures.

    alive: whether the executor still works; where it does not, or a result cannot be written, the
    campaign ends with CampaignError. The next call continues it.
    """
    store.prepare()
    count = _Count()
    work = _Work(store, executor, TASKS_A_SLOT * slots, _waiting(tasks, store, count, retry=retry))
    began = last = time.time()

    def status(*, running: bool) -> Status:
        return Status(
            total=len(tasks), done=count.done, failed=count.failed, started=began,
            updated=time.time(), slots=slots, computed=count.computed, running=running)

    store.write_status(status(running=True))
    try:
        while not work.is_done:
            documents, is_late = work.next_results()
            for document in documents:
                count.add(document, new=True)
            if is_late and not alive():
                raise _gone(count.done, len(tasks))
            if time.time() - last >= STATUS_SECONDS:
                last = time.time()
                store.write_status(status(running=True))
                on_status(status(running=True))
    finally:
        work.cancel()
        store.write_status(status(running=False))
    on_status(status(running=False))
    return Summary(len(tasks), count.done, count.failed, count.computed, count.faults)


def _waiting(
    tasks: Sequence[SessionTask], store: Store, count: _Count, *, retry: bool
) -> deque[SessionTask]:
    """The tasks without a result, with `retry` failed ones too; the others are counted."""
    waiting = deque[SessionTask]()
    for task in tasks:
        found = store.read_result(task.key)
        if found is None:
            waiting.append(task)
        elif retry and found['status'] == 'failed':
            waiting.append(replace(task, attempt=int(found.get('attempt', 0)) + 1))
        else:
            count.add(found, new=False)
    return waiting


@dataclass
class _Work:
    """Tasks that wait and tasks that run, `limit` at most; lost: dead workers by task."""

    store: Store
    executor: Executor
    limit: int
    waiting: deque[SessionTask]
    running: dict[Future[str], SessionTask] = field(default_factory=dict)
    lost: dict[str, int] = field(default_factory=dict)

    @property
    def is_done(self) -> bool:
        return not (self.waiting or self.running)

    def next_results(self) -> tuple[list[dict[str, object]], bool]:
        """Results that came, and whether the executor may be gone: none came, or a worker died."""
        while self.waiting and len(self.running) < self.limit:
            task = self.waiting.popleft()
            self.running[self.executor.submit(
                execute, task.as_dict(), str(self.store.folder.resolve()))] = task
        finished, _ = wait(self.running, timeout=HEARTBEAT, return_when=FIRST_COMPLETED)
        documents, given_again = [], 0
        for future in finished:
            task = self.running.pop(future)
            document = _result(future, task, self.store, self.lost)
            if document is None:
                self.waiting.append(task)
                given_again += 1
            else:
                documents.append(document)
        return documents, given_again > 0 or not finished

    def cancel(self) -> None:
        """Withdraw tasks that no worker has begun."""
        for future in self.running:
            future.cancel()


def _result(
    future: Future[str], task: SessionTask, store: Store, lost: dict[str, int]
) -> dict[str, object] | None:
    """The result of a finished future; None if the task must be given again."""
    try:
        key = future.result()
    except SaddleringError:
        raise  # the store cannot be written: no other task would fare better
    except (Exception, CancelledError) as problem:
        return _of_lost_worker(task, store, lost, problem)
    document = store.read_result(key)
    if document is None:
        raise CampaignError(f'{store.place_of(key)}: was reported as written and is missing: '
                            'give workers and coordinator the same --out folder')
    return document


def _of_lost_worker(
    task: SessionTask, store: Store, lost: dict[str, int], problem: BaseException
) -> dict[str, object] | None:
    found = store.read_result(task.key)
    if found is not None and int(found.get('attempt', 0)) >= task.attempt:
        return found  # written before its worker died
    lost[task.key] = lost.get(task.key, 0) + 1
    if lost[task.key] < MAX_LOST_WORKERS:
        return None
    document: dict[str, object] = {
        'key': task.key, 'attempt': task.attempt, 'task': task.as_dict(), 'seed': task.seed,
        'seconds': 0.0, 'status': 'failed', 'kind': 'worker',
        'reason': f'{MAX_LOST_WORKERS} workers died during this session '
                  f'({type(problem).__name__}): run the campaign with --retry',
    }
    store.write_result(document)
    return document


def _gone(done: int, total: int) -> CampaignInterruptedError:
    return CampaignInterruptedError(
        f'the scheduler no longer answers; {done} of {total} sessions have a result: start '
        'it again and repeat the command')
