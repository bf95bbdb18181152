"""The same campaign on a real Dask scheduler with workers as processes, which are killed."""

from contextlib import contextmanager
from importlib.util import find_spec
import json
import os
from pathlib import Path
import signal
import subprocess
import sys
import threading
import time

from campaign_stubs import marks, tasks, write_bag
import pytest

from saddlering_ros.campaign import running
from saddlering_ros.campaign.running import _warning, dask_workers, run_campaign
from saddlering_ros.campaign.store import CampaignError, CampaignInterruptedError, Store

# Not imported to find out: it takes a second of each process that collects tests.
pytestmark = pytest.mark.skipif(find_spec('distributed') is None, reason='needs distributed')

HERE = Path(__file__).resolve().parent


class Cluster:
    """A scheduler and two workers, each a process of its own, on this machine only."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.file = folder / 'scheduler.json'
        python_path = os.pathsep.join([str(HERE), os.getcwd()])
        self.environment = {**os.environ, 'PYTHONPATH': python_path,
                            'DASK_DISTRIBUTED__SCHEDULER__ALLOWED_FAILURES': '3'}
        self.scheduler = self._start(
            'distributed.cli.dask_scheduler', '--host', '127.0.0.1', '--port', '0',
            '--no-dashboard', '--scheduler-file', str(self.file))
        self.workers = [self.add_worker() for _ in range(2)]

    def add_worker(self) -> subprocess.Popen[bytes]:
        return self._start(
            'distributed.cli.dask_worker', '--scheduler-file', str(self.file), '--no-nanny',
            '--nthreads', '1', '--no-dashboard', '--host', '127.0.0.1',
            '--local-directory', str(self.folder))

    @property
    def address(self) -> str:
        end = time.monotonic() + 60.0
        while time.monotonic() < end:
            try:
                return str(json.loads(self.file.read_text())['address'])
            except (OSError, ValueError):
                time.sleep(0.05)
        raise AssertionError('the scheduler did not start')

    def wait_for_workers(self, count: int) -> None:
        from distributed import Client

        with Client(self.address, timeout=60, set_as_default=False) as client:
            client.wait_for_workers(count, timeout=60)

    def close(self) -> None:
        for process in [*self.workers, self.scheduler]:
            process.kill()
            process.wait()

    def _start(self, module: str, *arguments: str) -> subprocess.Popen[bytes]:
        return subprocess.Popen(
            [sys.executable, '-m', module, *arguments], env=self.environment,
            stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)


@pytest.fixture(name='cluster')
def cluster_fixture(tmp_path):
    cluster = Cluster(tmp_path)
    try:
        cluster.wait_for_workers(2)
        yield cluster
    finally:
        cluster.close()


@contextmanager
def once(condition, action):
    """Do `action` as soon as `condition` is true."""
    def watch():
        end = time.monotonic() + 60.0
        while not condition() and time.monotonic() < end:
            time.sleep(0.01)
        action()

    thread = threading.Thread(target=watch, daemon=True)
    thread.start()
    yield
    thread.join(60.0)


def run(cluster, folder, store, compute):
    with dask_workers(cluster.address) as workers:
        return run_campaign(tasks(folder, compute), store, workers)


def test_workers_and_scheduler_may_be_killed(cluster, works, tmp_path):
    for number in range(6):
        write_bag(works, f'SR-{10 + number}', 'static_50')
    store = Store(tmp_path / 'store')

    def kill_a_worker():
        cluster.workers[0].send_signal(signal.SIGKILL)
        cluster.workers.append(cluster.add_worker())

    with once(lambda: sum(map(len, marks(works).values())) >= 2, kill_a_worker):
        first = run(cluster, works, store, 'slowly')
    assert (first.done, first.failed) == (10, 0)
    repeated = [found for found in marks(works).values() if len(found) > 1]
    assert len(repeated) <= 2  # at most what the dead worker had

    other = Store(tmp_path / 'other')
    write_bag(works, 'endless', 'static_50')  # the scheduler dies before all are judged

    def has_results():
        return list((other.folder / 'results').glob('[0-9a-f]*.json'))

    with once(has_results, lambda: cluster.scheduler.send_signal(signal.SIGKILL)), \
            pytest.raises(CampaignInterruptedError, match='have a result'):
        run(cluster, works, other, 'slowly')
    assert has_results()


def test_no_scheduler_is_one_line(monkeypatch):
    monkeypatch.setattr(running, 'CONNECT_SECONDS', 0.5)
    with pytest.raises(CampaignError, match='no Dask scheduler answers at'), \
            dask_workers('tcp://127.0.0.1:9'):
        pass


@pytest.mark.parametrize(('address', 'warned'), [
    ('tcp://127.0.0.1:8786', False), ('localhost:8786', False), ('tls://10.0.0.7:8786', False),
    ('tcp://10.0.0.7:8786', True), ('10.0.0.7:8786', True)])
def test_a_scheduler_elsewhere_without_tls_is_warned_of(address, warned):
    assert bool(_warning(address)) == warned
