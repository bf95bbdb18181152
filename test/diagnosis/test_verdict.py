"""Claims about the verdict: its JSON is the contract, its parameter file simulates."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from saddlering_ros.bags import read_run
from saddlering_ros.cli.main import main
from saddlering_ros.diagnosis import diagnose_bags, Verdict
from saddlering_ros.diagnosis.summary import verdict_text
from saddlering_ros.effects import catalogue
from saddlering_ros.rig import (
    CHANNELS,
    default_rig,
    PARAMETER_NAMES,
    read_parameters,
    write_parameters,
)
from saddlering_ros.ring.simulator import simulate

pytestmark = pytest.mark.slow

FITTED = ('static_50', 'dynamic_50', 'dynamic_50_fast')
SEALED = ('static_70',)
FORCE = 8000.0


@pytest.fixture(scope='module')
def verdict(campaign) -> Verdict:
    """Diagnosis of a rig whose ring has dry friction, 70 deg kept sealed."""
    bags = campaign('radial_friction', FORCE, 'force', FITTED + SEALED)
    return diagnose_bags(bags[: len(FITTED)], bags[len(FITTED) :])


@pytest.fixture(scope='module')
def document(verdict: Verdict) -> dict[str, Any]:
    return json.loads(json.dumps(verdict.to_json(), allow_nan=False))


def test_it_has_every_field_of_the_contract(document):
    assert {'verdict', 'causes', 'runs', 'parameters', 'next_test'} <= set(document)
    assert document['verdict'] in ('none', 'named', 'ambiguous', 'unknown')
    assert document['next_test'] is None or isinstance(document['next_test'], str)


def test_each_cause_has_group_parameters_evidence_and_gain(document):
    for cause in document['causes']:
        assert cause['effect'] in catalogue()
        assert cause['effect'] in cause['group']
        assert set(cause['group']) <= set(catalogue())
        assert all(set(item) == {'value', 'std', 'unit'} for item in cause['parameters'].values())
        assert set(cause['evidence']) == {'p_value', 'delta_bic'}
        assert 0.0 <= cause['gain']['fit'] <= 1.0
        assert 0.0 <= cause['gain']['held_out'] <= 1.0


def test_each_run_has_four_channels_with_noise_floor(document):
    assert [run['held_out'] for run in document['runs']] == [False, False, False, True]
    assert [run['elevation_deg'] for run in document['runs']] == pytest.approx([50, 50, 50, 70])
    for run in document['runs']:
        assert run['test'] in ('static', 'dynamic')
        assert set(run['channels']) == set(CHANNELS)
        for figures in run['channels'].values():
            assert set(figures) == {'nrmse_before', 'nrmse_after', 'noise_floor'}
            assert figures['noise_floor'] > 0.0


def test_parameters_stand_before_and_after_with_deviations(document):
    assert set(document['parameters']['before']) == set(PARAMETER_NAMES)
    expected = set(PARAMETER_NAMES) | {f'{name}_std' for name in PARAMETER_NAMES}
    assert set(document['parameters']['after']) == expected


def test_friction_is_found_measured_and_worth_it_on_the_sealed_run(document):
    cause = document['causes'][0]
    assert document['verdict'] in ('named', 'ambiguous')
    assert 'radial_friction' in cause['group']
    assert cause['gain']['held_out'] > 0.3
    if cause['effect'] == 'radial_friction':
        assert cause['parameters']['force']['value'] == pytest.approx(FORCE, rel=0.3)


def test_the_noise_floor_is_what_remains_on_runs_explained(document):
    static = document['runs'][0]['channels']['delta_x']
    assert 0.2 < static['nrmse_after'] / static['noise_floor'] < 4.0


def test_the_extended_parameter_file_simulates_better(verdict, campaign, tmp_path: Path):
    path = tmp_path / 'extended.yaml'
    write_parameters(path, verdict.extended_parameters())
    parameters = read_parameters(path)
    assert parameters.effects
    run = read_run(campaign('radial_friction', FORCE, 'force', FITTED + SEALED)[0])
    plain = type(parameters)(parameters.contact, {}, parameters.source)
    answers = [
        simulate(default_rig(), item, run.elevation, run.time[::5], run.load[::5], max_step=5e-3)
        for item in (parameters, plain)
    ]
    assert np.isfinite(answers[0].displacement.delta_x).all()
    assert not np.allclose(answers[0].displacement.delta_x, answers[1].displacement.delta_x)


def test_words_for_a_terminal_say_verdict_and_cause(verdict):
    text = verdict_text(verdict)
    assert text.startswith(f'verdict: {verdict.verdict}')
    assert all(cause.effect in text for cause in verdict.diagnosis.causes)


def test_the_command_writes_json_parameters_and_report(campaign, tmp_path: Path, capsys):
    bag = campaign('radial_friction', FORCE, 'force', FITTED + SEALED)[1]
    out, page = tmp_path / 'extended.yaml', tmp_path / 'report.html'
    arguments = ['diagnose', str(bag), '--out', str(out), '--report', str(page), '--json', '-']
    assert main(arguments) == 0
    assert json.loads(capsys.readouterr().out)['runs'][0]['bag'] == str(bag)
    assert read_parameters(out).source.method == 'diagnose'
    assert page.read_text().lstrip().lower().startswith('<!doctype html')
