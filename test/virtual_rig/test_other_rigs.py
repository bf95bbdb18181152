"""Effects of the virtual rig have the size of the rig, and loads are in the unit of its file."""

from dataclasses import replace

import pytest

from benchmarks.examiner import draw_truth, DrawSettings
from saddlering_ros.bags.reader import read_run
from saddlering_ros.cli.main import main
from saddlering_ros.files import share_directory
from saddlering_ros.rig import default_rig, FULL_SCALE_LOAD
from saddlering_ros.virtual_rig.effects import EFFECTS, parse_requests

SMALL = replace(default_rig(), full_scale_load=FULL_SCALE_LOAD / 25.0)
QUICK = ['--test', 'dynamic', '--elevation', '50', '--duration', '2.5', '--rate', '100']


@pytest.fixture(name='small_file')
def small_file_fixture(tmp_path):
    """The shipped rig with a full scale of 20 kN, printed in kN."""
    text = (share_directory() / 'config' / 'rig.yaml').read_text()
    for old, new in (('245166.25', '20000.0'), ('4903.325', '400.0'),
                     ('force_unit: t ', 'force_unit: kN ')):
        assert old in text
        text = text.replace(old, new)
    path = tmp_path / 'rig.yaml'
    path.write_text(text)
    return path


def test_an_effect_without_a_size_has_the_typical_size_of_the_rig():
    for name in EFFECTS:
        nominal, = parse_requests([name])
        small, = parse_requests([name], rig=SMALL)
        for parameter in nominal.effect.parameters:
            ratio = {'N': 0.04, 'N m': 0.04, 'm/N': 25.0, 'rad/(N m)': 25.0, 'm/N^0.5': 5.0}
            expected = ratio.get(parameter.unit, 1.0) * nominal.values[parameter.name]
            assert small.values[parameter.name] == pytest.approx(expected), (name, parameter.name)


def test_a_size_that_is_given_is_taken_on_any_rig():
    found, = parse_requests(['radial_friction=5000'], rig=SMALL)
    assert found.values['force'] == 5000.0
    assert found.values['presliding'] == 2e-6


def test_drawn_sizes_follow_the_rig():
    settings = DrawSettings(effects=('cylinder_friction',))
    nominal, small = (draw_truth(3, 'single', settings, rig) for rig in (default_rig(), SMALL))
    for key in ('force', 'presliding'):
        expected = nominal.effects[0].values[key] / 25.0
        assert small.effects[0].values[key] == pytest.approx(expected)
    assert small.instruments.load_noise == pytest.approx(nominal.instruments.load_noise / 25.0)
    assert small.contact == nominal.contact


def test_loads_of_generate_are_in_the_unit_of_the_rig_file(tmp_path, small_file):
    out = tmp_path / 'run'
    assert main(['generate', str(out), *QUICK, '--rig', str(small_file), '--peak', '10',
                 '--hold', '1', '--lowest', '1']) == 0
    load = read_run(out).load
    assert load.max() == pytest.approx(10e3, rel=0.02)
    assert load.min() == pytest.approx(1e3, rel=0.05)


def test_the_list_of_effects_has_forms_units_and_the_sizes_of_the_rig(small_file, capsys):
    assert main(['generate', '--list-effects', '--rig', str(small_file)]) == 0
    listed = capsys.readouterr().out
    assert 'lugre' in listed
    line = next(line for line in listed.splitlines() if 'force [N]' in line)
    assert 'typical 244.7' in line  # of cylinder_friction: 3000 N on 245 kN
