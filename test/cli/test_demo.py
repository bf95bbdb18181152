"""Claims about `saddlering demo`: its refusals, its end by a signal, and the whole story.

The interrupted demo is a program that starts programs. The whole story runs in this process, on
forked nodes.
"""

from contextlib import suppress
import json
import os
from pathlib import Path
import signal
import subprocess
import sys
import time
from unittest import mock

from browser import browser_page
from few_effects import few_effects
import pytest
from rosnet import ended
from shared_pictures import DRAWN, drawn_once

from benchmarks.examiner import draw_truth, DrawSettings, RecordSettings, write_campaign
from saddlering_ros.cli.main import main

SHORTER = RecordSettings(hold=1.2, static_rate=25.0, duration=8.0, dynamic_rate=250.0)
"""Bags whose replay takes half the steps of those of other tests."""


def start(*arguments, **options):
    command = [sys.executable, '-m', 'saddlering_ros.cli.main', 'demo', *map(str, arguments)]
    return subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True,
                            **options)


def children_of(number):
    """Processes whose session was started by `number`, or that are its children, by /proc."""
    found = []
    for entry in Path('/proc').iterdir():
        try:
            parent = int((entry / 'stat').read_text().rpartition(')')[2].split()[1])
        except (OSError, ValueError, IndexError):
            continue
        if parent == number:
            found.append(int(entry.name))
    return found


@pytest.mark.parametrize(('make', 'said'), [
    (lambda folder: folder / 'none', 'no such folder'),
    (lambda folder: folder, 'holds no bags')])
def test_a_folder_without_bags_is_one_line_and_status_2(tmp_path, capsys, make, said):
    status = main(['demo', '--bags', str(make(tmp_path)), '--out', str(tmp_path / 'out')])
    assert status == 2
    line = capsys.readouterr().err
    assert said in line
    assert line.count('\n') == 1
    assert not (tmp_path / 'out').exists()


def test_an_out_that_is_a_file_is_refused_before_any_work(tmp_path, capsys):
    (tmp_path / 'out').write_text('mine')
    assert main(['demo', '--out', str(tmp_path / 'out')]) == 2
    assert 'is not a folder' in capsys.readouterr().err
    assert (tmp_path / 'out').read_text() == 'mine'


def test_an_interrupted_demo_leaves_no_process_and_no_file(tmp_path):
    with start('--out', tmp_path / 'out', cwd=tmp_path) as demo, ended(demo):
        deadline = time.monotonic() + 240.0
        while len(children_of(demo.pid)) < 6 and time.monotonic() < deadline:
            time.sleep(0.05)
        nodes = children_of(demo.pid)
        assert len(nodes) >= 6
        demo.send_signal(signal.SIGTERM)
        said, _ = demo.communicate(timeout=60.0)
    assert 'saddlering_demo_run_' not in said  # its scratch, which is gone
    assert demo.returncode == 128 + signal.SIGTERM
    assert not [pid for pid in nodes if Path(f'/proc/{pid}').exists()]
    assert list(tmp_path.iterdir()) == []


@pytest.mark.ros
@pytest.mark.slow
@pytest.mark.timeout(1800)
def test_the_demo_finds_a_cause_live_and_halves_the_misfit_of_the_runs_kept_back(
        tmp_path, capsys):
    bags = tmp_path / 'bags'
    settings = DrawSettings(('radial_friction',), fixed={'radial_friction': {'force': 8000.0}})
    write_campaign(draw_truth(4, 'single', settings), bags,
                   ('static_50', 'dynamic_50_fast', 'dynamic_70'), SHORTER)
    with (mock.patch.dict(os.environ, ROS_LOG_DIR=str(tmp_path)), mock.patch(DRAWN, drawn_once()),
          few_effects('radial_friction', 'tilt_friction', 'cylinder_friction', 'film_creep',
                      'settling')):
        status = main(['demo', '--bags', str(bags), '--out', str(tmp_path / 'out')])
    assert status == 0, capsys.readouterr()
    assert 'verdict: ' in capsys.readouterr().out
    numbers = json.loads((tmp_path / 'out' / 'numbers.json').read_text())
    assert numbers['verdict']['verdict'] in ('named', 'ambiguous')
    assert numbers['live']['gain'] > 0.5
    assert all(replay['lost'] == 0 for replay in numbers['live']['replays'])
    names = {path.name for path in (tmp_path / 'out').iterdir()}
    assert {'report.html', 'numbers.json', 'parameters_identified.yaml',
            'parameters_extended.yaml', 'comparison_static.png'} <= names
    page = (tmp_path / 'out' / 'report.html').read_text(encoding='utf-8')
    assert f'saddlering demo --bags {bags} --out {tmp_path / "out"}' in page
    with suppress(pytest.skip.Exception), browser_page() as tab:  # where there is a Chromium
        tab.open((tmp_path / 'out' / 'report.html').as_uri())
        tab.wait('document.documentElement.dataset.charts === "ready"')
        assert tab.unfit_for_people() == []
