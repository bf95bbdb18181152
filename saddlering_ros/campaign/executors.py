"""Executors of tasks: processes of this machine, or a Dask cluster."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Executor, ThreadPoolExecutor
from contextlib import contextmanager
from dataclasses import dataclass
import os
from urllib.parse import urlsplit

from saddlering_ros.campaign.errors import CampaignError
from saddlering_ros.campaign.runner import runner_of_this_thread, SessionRunner

CONNECT_SECONDS = 10.0
LOOPBACK = ('localhost', '127.0.0.1', '::1')


@dataclass(frozen=True)
class Workers:
    """An executor, how many tasks it runs at a time, and whether it is still there.

    runners: its slots, where they are of this process.
    """

    executor: Executor
    slots: int
    alive: Callable[[], bool] = lambda: True
    warning: str = ''
    runners: Sequence[SessionRunner] = ()


@contextmanager
def local_workers(jobs: int | None = None) -> Iterator[Workers]:
    """`jobs` slots of this machine (default: its processors).

    Each slot is a thread that waits for a process of its own; the process computes.
    """
    slots = jobs or len(os.sched_getaffinity(0))
    runners: list[SessionRunner] = []
    executor = ThreadPoolExecutor(slots, thread_name_prefix='slot',
                                  initializer=lambda: runners.append(runner_of_this_thread()))
    try:
        yield Workers(executor, slots, runners=runners)
    finally:
        executor.shutdown(wait=False, cancel_futures=True)
        for runner in runners:
            runner.stop()
        executor.shutdown()


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
        executor = client.get_executor(pure=False)
        yield Workers(executor, slots, lambda: client.status == 'running', _warning(address))
    finally:
        client.close(timeout=2.0)


def _warning(address: str) -> str:
    parts = urlsplit(address if '//' in address else f'//{address}')
    if parts.scheme == 'tls' or (parts.hostname or '') in LOOPBACK:
        return ''
    return (f'{address} is reached without TLS: anyone on that network can run programs on the '
            'workers (see docs/campaigns.md)')
