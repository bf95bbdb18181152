"""What a campaign costs beside its verdicts: speed-up, overhead, memory, resuming after kills.

python benchmarks/campaign.py [--sessions N] [--work S] [--memory N] [--kills N] judges stub
sessions that keep a processor busy for S seconds each, on one and two local slots and on two Dask
workers; then N sessions that take no time, for the coordinator's memory; then campaigns whose
client is killed at random moments.
"""

from __future__ import annotations

import argparse
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
import json
import os
from pathlib import Path
import random
import resource
import signal
import subprocess
import sys
import tempfile
import time
from typing import Any

from saddlering_ros.campaign import run_campaign, SessionLimits, SessionTask, Store
from saddlering_ros.campaign.running import dask_workers, local_workers, Workers
from saddlering_ros.campaign.tables import write_fleet, write_tables

HERE = Path(__file__).resolve().parent
NAMES = ('K1', 'n1', 'D1', 'K2', 'n2', 'D2')
VALUES = (1.3e8, 1.11, 3e6, 1.3e8, 1.11, 3e6)


def spin(task: SessionTask) -> dict[str, Any]:
    """Keep a processor busy for as long as the task's service hours say [s]."""
    end = time.process_time() + (task.service_hours or 0.0)
    while time.process_time() < end:
        sum(range(1000))
    return answer()


def answer() -> dict[str, Any]:
    """A verdict document of the usual shape."""
    after = dict(zip(NAMES, VALUES, strict=True))
    after |= {f'{name}_std': 0.01 * value for name, value in after.items()}
    covariance = [[(0.01 * VALUES[row]) ** 2 if row == column else 0.0 for column in range(6)]
                  for row in range(6)]
    return {'verdict': {'verdict': 'none', 'causes': [],
                        'parameters': {'before': {}, 'after': after}},
            'covariance': covariance, 'report': ''}


def stub_tasks(count: int, work: float) -> list[SessionTask]:
    """Sessions without bags; each ring has ten."""
    return [
        SessionTask(f'{number:032x}', f'session {number}', f'SR-{number // 10}', 'rig',
                    1.77e9 + 86400.0 * number, work, False, (), '', '', SessionLimits(),
                    'campaign:spin')
        for number in range(count)
    ]


@contextmanager
def dask_cluster(folder: Path) -> Iterator[str]:
    """The address of a scheduler with two workers, each a process."""
    file = folder / 'scheduler.json'
    common = ['--scheduler-file', str(file), '--no-dashboard', '--host', '127.0.0.1']
    commands = [['distributed.cli.dask_scheduler', '--port', '0', *common]]
    commands += [['distributed.cli.dask_worker', '--no-nanny', '--nthreads', '1', *common]] * 2
    processes = [subprocess.Popen([sys.executable, '-m', *command], stdout=subprocess.DEVNULL,
                                  stderr=subprocess.DEVNULL) for command in commands]
    try:
        from distributed import Client

        while not file.exists():
            time.sleep(0.1)
        address = str(json.loads(file.read_text())['address'])
        with Client(address, set_as_default=False) as client:
            client.wait_for_workers(2)
        yield address
    finally:
        for process in processes:
            process.kill()
            process.wait()


def timed(count: int, work: float, slots: int, address: str | None = None) -> float:
    """Wall time [s] of a campaign, its slots warmed by one session each."""
    with tempfile.TemporaryDirectory() as folder:
        workers = local_workers(slots) if address is None else dask_workers(address)
        with workers as found:
            warm = stub_tasks(count + 4, 0.2)[count:]
            run_campaign(warm, Store(Path(folder) / 'warm'), found)
            began = time.perf_counter()
            run_campaign(stub_tasks(count, work), Store(Path(folder) / 'store'), found)
            return time.perf_counter() - began


class Immediate(ThreadPoolExecutor):
    """Writes stub results in the coordinator itself: only its own memory is measured."""

    def submit(self, function: Any, *arguments: Any, **_: Any) -> Any:
        document, folder = arguments
        store = Store(Path(folder))
        store.write_result({'key': document['key'], 'attempt': 0, 'task': document, 'seed': 0,
                            'versions': {}, 'seconds': 0.0, 'status': 'done', **answer()})
        return super().submit(lambda: document['key'])


def coordinator_memory(count: int) -> tuple[float, float]:
    """Largest memory [MB] of a coordinator: until the tables, and after the fleet."""
    with tempfile.TemporaryDirectory() as folder:
        store = Store(Path(folder))
        tasks = stub_tasks(count, 0.0)
        run_campaign(tasks, store, Workers(Immediate(1), 1))
        write_tables(store, tasks)
        tables = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
        write_fleet(store, tasks[: 2000], {})
        return tables, resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024


def results_of(store: Store) -> dict[str, int]:
    """When each result was written [ns], by key."""
    return {path.stem: path.stat().st_mtime_ns
            for path in (store.folder / 'results').glob('[0-9a-f]*.json')}


def kills(count: int, seed: int) -> str:
    """Kill the client at random moments; what was done stays and is not done again."""
    chance = random.Random(seed)
    with tempfile.TemporaryDirectory() as folder:
        store = Store(Path(folder))
        script = ('from pathlib import Path\nimport sys\nfrom campaign import *\n'
                  'with local_workers(2) as found:\n'
                  '    run_campaign(stub_tasks(60, 0.3), Store(Path(sys.argv[1])), found)\n')
        repeated = 0
        seen: dict[str, int] = {}
        for _ in range(count):
            process = subprocess.Popen([sys.executable, '-c', script, folder])
            begun = len(results_of(store))
            while len(results_of(store)) == begun and process.poll() is None:
                time.sleep(0.05)
            time.sleep(chance.uniform(0.0, 1.5))
            process.send_signal(signal.SIGKILL)
            process.wait()
            now = results_of(store)
            repeated += sum(now.get(key) != stamp for key, stamp in seen.items())
            seen = now
        with local_workers(2) as found:
            summary = run_campaign(stub_tasks(60, 0.3), store, found)
    return (f'{count} kills: {len(seen)} of 60 results kept, {repeated} lost or repeated; the '
            f'last run computed {summary.computed} and has {summary.done} of {summary.total}')


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument('--sessions', type=int, default=20)
    parser.add_argument('--work', type=float, default=2.0)
    parser.add_argument('--memory', type=int, default=10_000)
    parser.add_argument('--kills', type=int, default=10)
    parser.add_argument('--only-memory', type=int, help=argparse.SUPPRESS)
    args = parser.parse_args()
    os.environ['PYTHONPATH'] = os.pathsep.join([str(HERE), str(HERE.parent)])
    if args.only_memory:
        print('{:.0f} MB, with the fleet {:.0f} MB'.format(*coordinator_memory(args.only_memory)))
        return 0
    one, two = (timed(args.sessions, args.work, slots) for slots in (1, 2))
    floor = args.sessions * args.work
    print(f'{args.sessions} sessions of {args.work:g} s: one slot {one:.1f} s (overhead '
          f'{100.0 * (one / floor - 1.0):.1f} % of the work), two slots {two:.1f} s: '
          f'{one / two:.2f} times as fast', flush=True)
    with tempfile.TemporaryDirectory() as folder, dask_cluster(Path(folder)) as address:
        both = timed(args.sessions, args.work, 2, address)
    print(f'two Dask workers {both:.1f} s: {one / both:.2f} times as fast', flush=True)
    for count in (100, args.memory):
        told = subprocess.run([sys.executable, __file__, '--only-memory', str(count)], check=True,
                              capture_output=True, text=True).stdout.strip()
        print(f'coordinator of {count} sessions: {told}', flush=True)
    print(kills(args.kills, 0))
    return 0


if __name__ == '__main__':
    sys.exit(main())
