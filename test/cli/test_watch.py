"""`saddlering watch` as a person types it."""

import json
from pathlib import Path

import numpy as np
import pytest

from saddlering_ros.bags.reader import read_run
from saddlering_ros.bags.write import write_bag
from saddlering_ros.cli.main import main
from saddlering_ros.record.record import TestMetadata
from saddlering_ros.rig import default_rig, ParameterSet, TRUE_TO_SCALE, write_parameters

BAG = str(Path(__file__).resolve().parents[2] / 'bags' / 'dynamic_50_fast')


@pytest.fixture(name='parameters')
def parameters_fixture(tmp_path):
    path = tmp_path / 'params.yaml'
    write_parameters(path, ParameterSet(TRUE_TO_SCALE))
    return str(path)


def test_a_wrong_model_alarms_and_a_generous_materiality_does_not(parameters, capsys):
    assert main(['watch', BAG, '--params', parameters, '--json', '-']) == 0
    [found] = json.loads(capsys.readouterr().out)['runs']
    assert found['alarm']['channel'] == 'delta_x'
    assert found['alarm']['since_ns'] < found['alarm']['stamp_ns']
    assert 0.0 < found['alarm']['since'] < found['alarm']['time'] < 4.4
    assert found['notes'] == []  # the shipped bag rests long enough for the noise to be known
    assert main(['watch', BAG, BAG, '--params', parameters, '--materiality', '100']) == 0
    said = [line for line in capsys.readouterr().out.splitlines() if line.startswith('/')]
    assert len(said) == 2
    assert all('no alarm in' in line for line in said)


def test_a_rate_of_false_alarms_that_cannot_be_is_one_line(parameters, capsys):
    for option, value, words in (
            ('--false-alarm-hours', '0', 'is 0: give 0.001 to 1e+09 hours'),
            ('--false-alarm-hours', 'inf', 'is inf: give 0.001 to 1e+09 hours'),
            ('--materiality', 'nan', 'is nan: give 0 to 100 percent'),
            ('--materiality', '200', 'is 200: give 0 to 100 percent')):
        assert main(['watch', BAG, '--params', parameters, option, value]) == 2
        assert capsys.readouterr().err == f'saddlering watch: {option} {words}\n'


def test_a_load_cell_that_stands_still_is_told_as_such(tmp_path, parameters, capsys):
    """It was "the load never rests and then moves": the ring moved by 90 um under it."""
    run = read_run(BAG)
    still = 4903.0 + np.random.default_rng(0).normal(0.0, 10.0, run.load.size)
    bag = write_bag(tmp_path / 'still', TestMetadata('dynamic', 50.0), run.stamps, still,
                    [run.stamps] * 4, run.gaps, default_rig().probes)
    assert main(['watch', str(bag), '--params', parameters]) == 2
    assert 'the residual moved by more than the materiality while the load rested' in (
        capsys.readouterr().err)
