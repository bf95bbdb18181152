"""`saddlering generate`: a bag comes out whole, and bad arguments get one line and status 2."""

import math

import pytest

from saddlering_ros.bags.reader import read_run
from saddlering_ros.cli.generate import _plan
from saddlering_ros.cli.main import build_parser, main
from saddlering_ros.rig import TONNE
from saddlering_ros.virtual_rig.integrator import Scatter

QUICK = ['--test', 'dynamic', '--elevation', '50', '--duration', '2.5', '--rate', '100']


def test_a_bag_with_an_effect_can_be_read_again(tmp_path, capsys):
    out = tmp_path / 'run'
    assert main(['generate', str(out), *QUICK, '--effect', 'probe_gain=0.05',
                 '--effect', 'probe_gain.probe=3', '--set', 'K1=1.5e8', '--seed', '4']) == 0
    assert 'run' in capsys.readouterr().out
    assert read_run(out).test == 'dynamic'


def test_options_are_in_the_units_that_they_name():
    parser, _ = build_parser()
    plan = _plan(parser.parse_args([
        'generate', 'out', '--test', 'static', '--elevation', '50', '--gap-scatter', '3',
        '--stiffness-scatter', '4', '--noise', '0.5', '--peak', '20', '--load-step', '2']))
    assert plan.physical.scatter == Scatter(pytest.approx(3e-6), pytest.approx(0.04))
    assert plan.physical.elevation == pytest.approx(math.radians(50.0))
    assert plan.instruments.noise == pytest.approx(5e-7)
    assert (plan.schedule.peak, plan.schedule.step) == pytest.approx((20.0 * TONNE, 2.0 * TONNE))


def test_an_existing_bag_is_kept_unless_told_otherwise(tmp_path, capsys):
    out = tmp_path / 'run'
    assert main(['generate', str(out), *QUICK]) == 0
    before = read_run(out).load
    assert main(['generate', str(out), *QUICK, '--seed', '1']) == 2
    assert '--overwrite' in capsys.readouterr().err
    assert (read_run(out).load == before).all()
    assert main(['generate', str(out), *QUICK, '--seed', '1', '--overwrite']) == 0
    assert not (read_run(out).load[:50] == before[:50]).all()


@pytest.mark.parametrize(('arguments', 'said'), [
    (['--effect', 'rust=1'], 'radial_friction'),
    (['--effect', 'film_creep.tau=1'], 'share, time, rows'),
    (['--set', 'K9=1'], 'K1, n1, D1, K2, n2, D2'),
    (['--set', 'K1=hard'], 'NAME=NUMBER'),
    (['--elevation', '120'], '-10 to 90'),
    (['--noise', '-1'], 'give 0 to 10000'),
    (['--hold', 'nan'], 'hold'),
    (['--load-step', '2'], 'static'),
    (['--rate', '0'], 'rate'),
    (['--seed', '-3'], 'seed'),
    (['--rig', 'missing.yaml'], 'missing.yaml')])
def test_bad_arguments_get_one_line_and_leave_nothing(tmp_path, capsys, arguments, said):
    assert main(['generate', str(tmp_path / 'run'), *QUICK, *arguments]) == 2
    complaint = capsys.readouterr().err
    assert said in complaint
    assert len(complaint.strip().splitlines()) == 1
    assert list(tmp_path.iterdir()) == []
