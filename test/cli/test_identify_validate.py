"""Claims about `saddlering identify` and `saddlering validate` on bags."""

import json
from pathlib import Path
import sys
from unittest import mock

import numpy as np
import pytest
from shared_pictures import DRAWN, drawn_once

sys.path.append(str(Path(__file__).parent.parent / 'identification'))
from identification_records import dynamic_run, RIG, static_run

from saddlering_ros.bags.write import write_bag
from saddlering_ros.cli.main import main
from saddlering_ros.identification import methods
from saddlering_ros.record.record import TestMetadata
from saddlering_ros.rig import read_parameters, TRUE_TO_SCALE

QUICK = ('--particles', '10', '--iterations', '10')


def write(folder, run):
    facts = TestMetadata(run.test, float(np.degrees(run.elevation)), run='1')
    return str(write_bag(
        folder / run.name, facts, run.stamps, run.load, [run.stamps] * 4, list(run.gaps),
        RIG.probes))


@pytest.fixture(scope='module')
def bags(tmp_path_factory):
    folder = tmp_path_factory.mktemp('bags')
    runs = [static_run(50.0, seed=1), dynamic_run(50.0, seconds=4.0, seed=2),
            static_run(70.0, seed=3)]
    return [write(folder, run) for run in runs]


@pytest.fixture(scope='module')
def parameter_file(bags, tmp_path_factory):
    path = tmp_path_factory.mktemp('found') / 'params.yaml'
    page = path.with_name('page.html')
    with mock.patch(DRAWN, drawn_once()):
        assert main(['identify', *bags, '--out', str(path), '--report', str(page), *QUICK]) == 0
    return path


def test_identify_writes_a_file_with_what_it_found(parameter_file, bags):
    parameters = read_parameters(parameter_file)
    found = parameters.contact.to_array()
    assert found == pytest.approx(TRUE_TO_SCALE.to_array(), rel=0.05)
    assert parameters.source.method == 'default'
    assert parameters.source.bags == tuple(bags)
    assert parameters.source.covariance.shape == (6, 6)


def test_identify_writes_a_page_that_says_how_to_get_it_again(parameter_file, bags):
    page = parameter_file.with_name('page.html').read_text(encoding='utf-8')
    assert f'saddlering identify {bags[0]}' in page
    assert f'{read_parameters(parameter_file).contact.D1 / 1e6:.2f}'[:3] in page


def test_identify_prints_a_report_and_no_progress_into_a_pipe(bags, capsys):
    assert main(['identify', *bags, *QUICK]) == 0
    printed = capsys.readouterr()
    assert 'reduced chi square' in printed.out
    assert 'N/mm^' in printed.out
    assert printed.err == ''


def test_an_interrupt_of_the_fit_beside_errors_keeps_the_first_law(bags, tmp_path, capsys):
    """Ctrl-C lost the first law, which the second fit of up to 100 s does not change."""
    path = tmp_path / 'params.yaml'
    with (mock.patch.object(methods, 'MAX_SOUND', 0.0),
          mock.patch.object(methods, '_beside_errors', side_effect=KeyboardInterrupt)):
        assert main(['identify', *bags, '--out', str(path), *QUICK]) == 130
    printed = capsys.readouterr()
    assert 'cancelled: the law without errors of the ring is complete' in printed.out
    assert f'written: {path}' in printed.out
    assert read_parameters(path).contact.to_array() == pytest.approx(
        TRUE_TO_SCALE.to_array(), rel=0.05)


def test_identify_json_on_stdout_is_json_alone(bags, capsys):
    assert main(['identify', bags[0], '--json', '-', *QUICK]) == 0
    document = json.loads(capsys.readouterr().out)
    assert document['parameters']['D1']['std'] is None
    assert document['parameters']['D1']['pinned'] is False


@pytest.mark.usefixtures('no_pictures')
def test_validate_prints_a_table_writes_json_and_pictures(bags, parameter_file, tmp_path, capsys):
    out = tmp_path / 'validation.json'
    command = ['validate', bags[2], '--params', str(parameter_file), '--json', str(out),
               '--plots', str(tmp_path / 'plots'), '--report', str(tmp_path / 'page.html')]
    assert main(command) == 0
    printed = capsys.readouterr().out
    assert 'delta_x' in printed
    assert 'in µm or µrad' in printed
    assert 'criteria:' in printed
    assert f'saddlering validate {bags[2]}' in (tmp_path / 'page.html').read_text('utf-8')
    run = json.loads(out.read_text())['runs'][0]
    assert run['channels']['delta_x']['nrmse'] < 0.02
    assert run['held_out'] is False  # its name is among those that were fitted
    assert len(list((tmp_path / 'plots').glob('*.png'))) == 1


@pytest.mark.parametrize(
    ('wrong', 'words'),
    [
        (['--bounds', 'K1=1e9:1e7'], 'K1'),
        (['--bounds', 'K1=soft'], 'NAME=LOW:HIGH'),
        (['--bounds', 'Q=1:2'], 'no such parameter'),
        (['--particles', '1'], 'particles')])
def test_what_cannot_be_meant_is_said_in_one_line(bags, wrong, words, capsys):
    assert main(['identify', bags[0], *wrong]) == 2
    error = capsys.readouterr().err
    assert error.count('\n') == 1
    assert words in error


@pytest.mark.parametrize(('options', 'words'), [
    (('--accuracy', '1e9'), '1 iterations, accuracy reached'),
    (('--iterations', '500', '--stagnation', '1'), 'no more progress')])
def test_the_swarm_can_be_told_when_to_stop(bags, capsys, options, words):
    assert main(['identify', bags[0], '--method', 'paper', '--particles', '5', *options]) == 0
    assert words in capsys.readouterr().out
