"""Claims about `saddlering diagnose`: its JSON is the contract, its parameter file simulates.

The command is the one of the tutorial, for a rig whose ring has dry friction, 70 deg held out.
"""

from dataclasses import dataclass
import json
from pathlib import Path
import shlex
from typing import Any

import numpy as np
import pytest
from typed_pages import typed_page

from saddlering_ros.bags.reader import read_run
from saddlering_ros.effects import catalogue
from saddlering_ros.record.displacement import displacement_of_run
from saddlering_ros.rig import CHANNELS, default_rig, PARAMETER_NAMES, read_parameters
from saddlering_ros.ring.simulator import simulate

pytestmark = pytest.mark.slow

PAGE = Path(__file__).resolve().parents[2] / 'docs' / 'tutorial.md'
FORCE = 8000.0


@dataclass(frozen=True)
class Diagnosed:
    """What the command printed and wrote."""

    bags: list[Path]
    printed: str
    json: Path
    parameters: Path
    page: Path


@pytest.fixture(scope='module')
def diagnosed(campaign, made_once) -> Diagnosed:
    page = typed_page(PAGE, made_once, campaign)
    words = shlex.split(page.of('diagnose').line)
    bags = [page.folder / word for word in words if word.startswith('bags/')]
    return Diagnosed(bags, page.of('diagnose').printed, *(
        page.folder / name for name in ('verdict.json', 'extended.yaml', 'report.html')))


@pytest.fixture(scope='module')
def document(diagnosed: Diagnosed) -> dict[str, Any]:
    def refuse(word: str) -> float:
        raise AssertionError(f'{word} is no JSON')

    return json.loads(diagnosed.json.read_text(), parse_constant=refuse)


def test_each_cause_has_group_parameters_evidence_and_gain(document):
    assert document['verdict'] == 'named'
    assert document['next_test'].startswith('To confirm dry friction in the radial row: ')
    assert document['causes']
    for cause in document['causes']:
        assert cause['effect'] in catalogue()
        assert cause['effect'] in cause['group']
        assert set(cause['group']) <= set(catalogue())
        for size in cause['parameters'].values():
            assert set(size) == {'value', 'std', 'interval', 'unit'}
            ends = size['interval'] or [size['value']] * 2
            assert ends[1] - ends[0] == pytest.approx(2.0 * 1.96 * size['std'], rel=1e-3)
        assert set(cause['evidence']) == {'p_value', 'delta_bic'}
        assert 0.0 <= cause['gain']['fit'] <= 1.0
        assert 0.0 <= cause['gain']['held_out'] <= 1.0


def test_each_run_has_four_channels_with_noise_floor(document):
    assert [run['held_out'] for run in document['runs']] == [False, False, True]
    assert [run['elevation_deg'] for run in document['runs']] == pytest.approx([50, 50, 70])
    assert [run['test'] for run in document['runs']] == ['static', 'dynamic', 'static']
    for run in document['runs']:
        assert set(run['channels']) == set(CHANNELS)
        for figures in run['channels'].values():
            assert set(figures) == {'nrmse_before', 'nrmse_after', 'noise_floor', 'sound'}
            assert figures['noise_floor'] > 0.0


def test_misfits_are_those_of_the_curves_and_count_from_the_zero(document, diagnosed):
    """The text said that a constant offset of each probe was fitted, and none was."""
    curves = np.genfromtxt(diagnosed.page.with_name('report_curves.csv'), delimiter=',',
                           names=True, dtype=None, encoding='utf-8')
    for run in document['runs']:
        own = curves[curves['bag'] == Path(run['bag']).name]
        for name, figures in run['channels'].items():
            measured, before = own[f'{name}_measured'], own[f'{name}_simulated']
            assert figures['nrmse_before'] == pytest.approx(
                np.sqrt(np.mean((before - measured)**2)) / np.ptp(measured))
    assert 'counted from the zero of the run' in diagnosed.printed
    assert 'offset' not in diagnosed.printed


def test_parameters_stand_before_and_after_with_deviations(document):
    assert set(document['parameters']['before']) == set(PARAMETER_NAMES)
    expected = set(PARAMETER_NAMES) | {f'{name}_std' for name in PARAMETER_NAMES}
    assert set(document['parameters']['after']) == expected


def test_a_stiffness_that_is_not_determined_is_shown_in_no_unit_without_that_word(
        document, diagnosed):
    undetermined = document['parameters']['undetermined']['after']
    assert {'K1', 'K2'} <= set(undetermined)
    told = [line for line in diagnosed.printed.splitlines() if line.startswith(('  K1', '  K2'))]
    assert len(told) == 4
    assert all('best known' in line for line in told)


def test_friction_is_found_measured_and_worth_it_on_the_sealed_run(document):
    (cause,) = document['causes']
    assert cause['group'] == ['radial_friction']
    assert cause['gain']['held_out'] > 0.3
    assert cause['parameters']['force']['value'] == pytest.approx(FORCE, rel=0.3)


def test_the_noise_floor_is_what_remains_on_runs_explained(document):
    static = document['runs'][0]['channels']['delta_x']
    assert 0.2 < static['nrmse_after'] / static['noise_floor'] < 4.0


def test_the_extended_parameter_file_simulates_better(diagnosed):
    parameters = read_parameters(diagnosed.parameters)
    assert parameters.source.method == 'diagnose'
    assert set(parameters.effects) == {'radial_friction'}
    run = read_run(diagnosed.bags[0])
    measured = displacement_of_run(default_rig(), run).displacement.delta_x
    plain = type(parameters)(parameters.contact, {}, parameters.source)
    misfit = [
        np.nanstd(simulate(default_rig(), item, run.elevation, run.time, run.load, max_step=5e-3
                           ).displacement.delta_x - measured) for item in (parameters, plain)]
    assert misfit[0] < 0.5 * misfit[1]


def test_words_for_a_terminal_say_verdict_and_cause(diagnosed, document):
    assert f'verdict: {document["verdict"]}' in diagnosed.printed
    assert all(cause['effect'] in diagnosed.printed for cause in document['causes'])


def test_the_command_names_its_bags_and_writes_a_page(diagnosed, document):
    assert [run['bag'] for run in document['runs']] == [
        f'bags/{bag.name}' for bag in diagnosed.bags]
    assert diagnosed.page.read_text().lstrip().lower().startswith('<!doctype html')
