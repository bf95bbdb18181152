"""Tasks run in processes with limits; nothing is lost, and nothing done twice that was done."""

from concurrent.futures import Executor, Future
from dataclasses import replace
import json
import os
from pathlib import Path
import signal
import subprocess
import sys
import threading
import time
from types import SimpleNamespace

from campaign_stubs import marks, tasks, write_bag
import pyarrow.parquet
import pytest

from saddlering_ros.campaign.running import document_of, local_workers, run_campaign, Workers
from saddlering_ros.campaign.store import CampaignError, CampaignInterruptedError, Store
from saddlering_ros.campaign.tables import write_tables
from saddlering_ros.campaign.task import session_verdict
from saddlering_ros.errors import ReportError

HERE = Path(__file__).resolve().parent


@pytest.fixture(autouse=True)
def _stubs_can_be_imported(monkeypatch):
    monkeypatch.setenv('PYTHONPATH', os.pathsep.join([str(HERE), os.getcwd()]))


def run(folder, store, compute='judge', *, retry=False, jobs=2, **limits):
    with local_workers(jobs) as workers:
        return run_campaign(tasks(folder, compute, **limits), store, workers, retry=retry)


def test_every_session_gets_a_result_and_a_second_run_computes_nothing(works, tmp_path):
    store = Store(tmp_path / 'store')
    first, second = run(works, store), run(works, store)
    assert (first.total, first.computed, first.failed) == (4, 4, 0)
    assert (second.done, second.computed) == (4, 0)
    assert all(len(processes) == 1 for processes in marks(works).values())


def test_the_tables_hold_verdicts_parameters_and_limits(works, tmp_path):
    store = Store(tmp_path / 'store')
    run(works, store)
    write_tables(store, tasks(works))
    verdicts = pyarrow.parquet.read_table(store.folder / 'verdicts.parquet').to_pylist()
    assert {row['ring']: row['verdict'] for row in verdicts} == {
        'SR-1': 'none', 'SR-2': 'none', 'SR-3-friction': 'named'}
    cause, = next(row['causes'] for row in verdicts if row['verdict'] == 'named')
    assert (cause['effect'], cause['size'], cause['group']) == (
        'radial_friction', 5e3, ['radial_friction'])
    parameters = pyarrow.parquet.read_table(store.folder / 'parameters.parquet').to_pylist()
    assert len(parameters) == 24
    assert parameters[0]['covariance'][0] == pytest.approx(parameters[0]['std']**2)
    limits = pyarrow.parquet.read_table(store.folder / 'detection_limits.parquet')
    assert limits.num_rows == 4


@pytest.mark.parametrize(('compute', 'kind', 'words'), [
    ('forever', 'timeout', 'no verdict within 0.5 s: give a larger --time-limit, and --retry'),
    ('greedy', 'memory', 'give a larger --memory-limit, and --retry'),
    ('killed', 'killed', 'status -9, as without free memory: use fewer workers or shorter bags')])
def test_a_session_beyond_its_limits_is_a_result_with_its_reason(tmp_path, compute, kind, words):
    write_bag(tmp_path / 'works', 'SR-1', 'static_50')
    store = Store(tmp_path / 'store')
    limits = {'seconds': 0.5} if compute == 'forever' else {'memory': 1 << 28}
    summary = run(tmp_path / 'works', store, compute, **limits)
    task, = tasks(tmp_path / 'works', compute)
    found = store.read_result(task.key)
    assert (summary.failed, summary.faults, found['kind']) == (1, 1, kind)
    assert words in found['reason']


def test_a_refusal_of_the_rig_names_the_option_of_the_campaign(tmp_path):
    write_bag(tmp_path / 'works', 'SR-1', 'static_50')
    store = Store(tmp_path / 'store')
    run(tmp_path / 'works', store, 'on_another_rig')
    task, = tasks(tmp_path / 'works', 'on_another_rig')
    assert store.read_result(task.key)['reason'].endswith(': give --rig FILE of that rig')


def test_a_refused_bag_is_no_failure_of_ours_and_retry_repeats_the_failures_alone(tmp_path):
    works, store = tmp_path / 'works', Store(tmp_path / 'store')
    for ring in ('refused', 'broken', 'SR-1'):
        write_bag(works, ring, 'static_50')
    summary = run(works, store)
    assert (summary.done, summary.failed, summary.faults) == (3, 2, 1)
    assert run(works, store).computed == 0
    assert run(works, store, retry=True).computed == 2
    assert sorted(len(processes) for processes in marks(works).values()) == [1, 2, 2]


def test_a_result_half_written_or_altered_is_computed_again_and_said(works, tmp_path):
    store = Store(tmp_path / 'store')
    run(works, store)
    for number, change in enumerate((lambda text: text[:100],
                                     lambda text: text.replace('300.0', '300.1'),
                                     lambda text: text.replace('"done"', '"failed"'))):
        victim = tasks(works)[number]
        place = store.place_of(victim.key)
        before = place.read_text()
        place.write_text(change(before))
        assert place.read_text() != before
        found = run(works, store)
        assert (found.computed, found.altered) == (1, [str(place)])
        assert store.read_result(victim.key)['status'] == 'done'


def test_a_store_that_cannot_be_written_ends_the_campaign_with_one_line(works, tmp_path):
    store = Store(tmp_path / 'store')
    store.prepare()
    (store.folder / 'results').rmdir()
    (store.folder / 'results').symlink_to('/proc/self/fd')
    with pytest.raises(CampaignError, match='cannot be written'):
        run(works, store)


def test_stopping_ends_what_is_computed_and_writes_nothing(tmp_path):
    write_bag(tmp_path / 'works', 'SR-1', 'static_50')
    store = Store(tmp_path / 'store')

    def stop_soon(workers):
        while not marks(tmp_path / 'works'):
            time.sleep(0.02)
        for slot in workers.local:
            slot.stop()

    with local_workers(1) as workers:
        threading.Thread(target=stop_soon, args=(workers,), daemon=True).start()
        with pytest.raises(CampaignInterruptedError):
            run_campaign(tasks(tmp_path / 'works', 'forever'), store, workers)
    assert not list((store.folder / 'results').iterdir())


def test_a_client_killed_at_any_moment_loses_and_repeats_nothing(works, tmp_path):
    for number in range(6):
        write_bag(works, f'SR-{10 + number}', 'static_50')
    store = Store(tmp_path / 'store')
    script = (f'import sys; sys.path.insert(0, {str(HERE)!r})\n'
              'from pathlib import Path\nfrom test_running import run\n'
              'from saddlering_ros.campaign.store import Store\n'
              'run(Path(sys.argv[1]), Store(Path(sys.argv[2])), "slowly")')
    for moment in (2, 5):
        process = subprocess.Popen([sys.executable, '-c', script, works, store.folder])
        end = time.monotonic() + 60.0
        while len(finished(store)) < moment and time.monotonic() < end:
            time.sleep(0.02)
        process.send_signal(signal.SIGKILL)
        process.wait()
    before = finished(store)
    time.sleep(0.3)  # children of the dead client must be gone
    judged = marks(works)
    summary = run(works, store, 'slowly')
    assert summary.done == summary.total == 10
    again = {key: len(found) for key, found in marks(works).items()}
    assert all(again[key] == len(judged[key]) for key in before)
    assert not any(alive(found[-1]) for found in marks(works).values())


def test_keys_hold_the_limits_of_nothing_but_the_result(works):
    first, second = tasks(works, seconds=1.0)[0], tasks(works, seconds=2.0)[0]
    assert first.key == second.key
    assert first.seed == replace(first, attempt=3).seed


def changing(folder):
    """Tasks of the bags, one of which gets other content after it was found."""
    found = tasks(folder)
    bag = Path(found[0].bags[0].path)
    next(bag.glob('*.mcap')).write_text('another recording')
    return found, found[0]


def test_a_bag_that_changes_after_it_was_found_has_no_verdict_under_its_old_hash(works, tmp_path):
    store = Store(tmp_path / 'store')
    found, changed = changing(works)
    with local_workers(2) as workers:
        run_campaign(found, store, workers)
    result = store.read_result(changed.key)
    assert (result['status'], result['kind']) == ('failed', 'changed')
    assert 'has changed since the campaign found it' in result['reason']
    assert run(works, store).computed == 1  # of the new content, under its own key


def test_a_result_of_changed_data_is_computed_again_when_the_old_are_back(works, tmp_path):
    store = Store(tmp_path / 'store')
    file = next(Path(tasks(works)[0].bags[0].path).glob('*.mcap'))
    before = file.read_text()
    found, changed = changing(works)
    with local_workers(2) as workers:
        run_campaign(found, store, workers)
        file.write_text(before)
        assert run_campaign(found, store, workers).computed == 1
    assert store.read_result(changed.key)['status'] == 'done'


def test_own_effects_are_part_of_the_key(works, tmp_path, monkeypatch):
    monkeypatch.setenv('SADDLERING_EFFECTS', str(tmp_path))
    without = tasks(works)[0]
    (tmp_path / 'snap.yaml').write_text('one')
    one = tasks(works)[0]
    (tmp_path / 'snap.yaml').write_text('two')
    assert len({without.key, one.key, tasks(works)[0].key}) == 3


def test_a_worker_with_other_effects_than_the_campaign_gives_no_verdict(
        works, tmp_path, monkeypatch):
    store = Store(tmp_path / 'store')
    found = tasks(works)
    (tmp_path / 'effects').mkdir()
    (tmp_path / 'effects' / 'snap.yaml').write_text('one')
    monkeypatch.setenv('SADDLERING_EFFECTS', str(tmp_path / 'effects'))
    with local_workers(1) as workers:
        run_campaign(found, store, workers)
    assert {store.read_result(task.key)['kind'] for task in found} == {'changed'}


class Mortal(Executor):
    """Workers that die in their first tasks, as a Dask worker under the memory killer."""

    def __init__(self, deaths):
        self.deaths = deaths

    def submit(self, function, *arguments):
        future = Future()
        self.deaths -= 1
        if self.deaths >= 0:
            future.set_exception(ConnectionError('the worker died'))
        else:
            future.set_result(function(*arguments))
        return future


@pytest.mark.parametrize(('deaths', 'kind'), [(2, None), (3, 'worker')])
def test_a_session_whose_workers_die_is_given_again_and_then_a_failure(tmp_path, deaths, kind):
    write_bag(tmp_path / 'works', 'SR-1', 'static_50')
    store = Store(tmp_path / 'store')
    found = tasks(tmp_path / 'works')
    count = run_campaign(found, store, Workers(Mortal(deaths), 1))
    assert (count.done, count.faults) == (1, int(bool(kind)))
    assert store.read_result(found[0].key).get('kind') == kind


def test_a_worker_of_another_version_gives_no_verdict(works, tmp_path):
    store = Store(tmp_path / 'store')
    found = [replace(task, program={**task.program, 'numpy': '1.0'}) for task in tasks(works)]
    with local_workers(1) as workers:
        run_campaign(found, store, workers)
    results = [store.read_result(task.key) for task in found]
    assert {result['kind'] for result in results} == {'changed'}
    assert 'for 1.0' in results[0]['reason']


def test_reports_that_were_not_asked_for_before_are_written_by_a_second_run(works, tmp_path):
    store = Store(tmp_path / 'store')
    run(works, store)
    asked = [replace(task, reports=str(store.reports)) for task in tasks(works)]
    for expected in (1, 0):  # the one session whose verdict is not `none`
        with local_workers(2) as workers:
            assert run_campaign(asked, store, workers).computed == expected


def test_a_session_whose_report_cannot_be_written_is_judged_again(works, tmp_path, monkeypatch):
    def full(_):
        raise ReportError('page.html: cannot be written (No space left on device)')
    monkeypatch.setattr('saddlering_ros.diagnose', lambda *_, **__: SimpleNamespace(
        verdict='named', write_report=full))
    store, task = Store(tmp_path / 'store'), tasks(works)[0]
    answer = session_verdict(replace(task, reports=str(store.reports)))
    assert answer['kind'] == 'unwritten'
    assert 'No space left on device' in answer['reason']
    store.prepare()
    store.write_result(document_of(task, 0.0, answer))
    with local_workers(1) as workers:
        count = run_campaign([task], store, workers)
    assert (count.computed, count.failed) == (1, 0)


def finished(store):
    folder = store.folder / 'results'
    return {path.stem for path in folder.glob('[0-9a-f]*.json')
            if json.loads(path.read_text())['status'] == 'done'} if folder.exists() else set()


def alive(process):
    try:
        return 'saddlering_ros.campaign' in Path(f'/proc/{process}/cmdline').read_text()
    except OSError:
        return False
