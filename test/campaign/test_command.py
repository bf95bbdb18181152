"""`saddlering campaign` as a person types it."""

import json
import os
from pathlib import Path
import re

from campaign_stubs import verdict_document
import pytest

from saddlering_ros.campaign.sessions import find_bags, group_sessions
from saddlering_ros.campaign.store import Store
from saddlering_ros.campaign.task import tasks_of
from saddlering_ros.cli.main import main

HERE = Path(__file__).resolve().parent


@pytest.fixture(name='judged')
def judged_fixture(works, tmp_path):
    """A store in which every session of the works has its result already."""
    store = Store(tmp_path / 'store')
    store.prepare()
    for task in tasks_of(group_sessions(find_bags(works)), reports=store.reports):
        store.write_result({
            'key': task.key, 'attempt': 0, 'task': task.as_dict(), 'seed': task.seed,
            'versions': {}, 'seconds': 1.0, 'status': 'done', 'report': '',
            'verdict': verdict_document('named' if 'friction' in task.ring else 'none'),
            'covariance': [[1.0 if row == column else 0.0 for column in range(6)]
                           for row in range(6)]})
    return store


def test_the_plan_is_shown_and_nothing_is_written(works, tmp_path, capsys):
    assert main(['campaign', str(works), '--out', str(tmp_path / 'store'), '--plan']) == 0
    shown = capsys.readouterr().out
    assert '4 sessions of 3 rings, 7 bags' in shown
    assert not (tmp_path / 'store').exists()


def test_a_plan_has_no_json_and_says_so(works, capsys):
    assert main(['campaign', str(works), '--plan', '--json', '-']) == 2
    assert 'leave out one of --plan and --json' in capsys.readouterr().err


def test_an_elevation_that_no_test_has_cannot_be_held_out(works, capsys):
    assert main(['campaign', str(works), '--plan', '--hold-out', '71']) == 2
    assert '--hold-out 71: no session has a test at this elevation' in capsys.readouterr().err


def test_a_store_holds_tables_fleet_and_report(works, judged, capsys):
    assert main(['campaign', str(works), '--out', str(judged.folder)]) == 0
    assert '0 of them new' in capsys.readouterr().out
    names = {path.name for path in judged.folder.iterdir()}
    assert {'manifest.parquet', 'manifest.csv', 'results', 'verdicts.parquet',
            'parameters.parquet', 'fleet.json', 'report.html'} <= names
    document = json.loads((judged.folder / 'fleet.json').read_text())
    assert document['sessions']['verdicts'] == {'none': 3, 'named': 1}
    assert 'SR-3-friction' in (judged.folder / 'report.html').read_text()


def test_the_fleet_is_printed_as_json_alone(works, judged, capsys):
    assert main(['campaign', str(works), '--out', str(judged.folder), '--json', '-']) == 0
    assert json.loads(capsys.readouterr().out)['sessions']['total'] == 4


def test_status_of_a_campaign(works, judged, capsys):
    main(['campaign', str(works), '--out', str(judged.folder)])
    capsys.readouterr()
    assert main(['campaign', 'status', str(judged.folder)]) == 0
    assert re.search(r'4 of 4 sessions, 0 failed.*finished', capsys.readouterr().out)


@pytest.mark.parametrize(('arguments', 'words'), [
    (['nowhere', '--out', 'x'], 'is not a folder'), (['.'], 'no --out'),
    (['.', '--out', 'x', '--gap', '0'], '--gap is 0'),
    (['.', '--out', 'x', '--limit', 'K7=1'], 'give one of K1'),
    (['.', '--out', 'x', '--rig', 'none.yaml'], 'none.yaml'),
    (['status', 'nowhere'], 'holds no campaign')])
def test_what_cannot_be_used_is_one_line(tmp_path, monkeypatch, capsys, arguments, words):
    monkeypatch.chdir(tmp_path)
    assert main(['campaign', *arguments]) == 2
    error = capsys.readouterr().err
    assert words in error
    assert error.count('\n') == 1
    assert not os.listdir(tmp_path)
