"""A verdict prints the contact law that `identify` finds in the same bags, in the same words."""

from dataclasses import replace
from pathlib import Path
import re
from types import SimpleNamespace

import numpy as np
import pytest

from saddlering_ros.bags.reader import read_run
from saddlering_ros.diagnosis import ring_diagnosis
from saddlering_ros.diagnosis.verdict import contact_law
from saddlering_ros.discrepancy import Estimate
from saddlering_ros.identification.methods import identify
from saddlering_ros.identification.result import identification_text
from saddlering_ros.identification.uncertainty import UNDETERMINED
from saddlering_ros.quantities import span
from saddlering_ros.report.chapters import of_file
from saddlering_ros.rig import default_rig, PARAMETER_NAMES, read_parameters, write_parameters

BAGS = Path(__file__).resolve().parents[2] / 'bags'
RIG = default_rig()


@pytest.fixture(name='runs', scope='module')
def runs_fixture():
    return [read_run(BAGS / name, rig=RIG) for name in ('static_50', 'dynamic_50_fast')]


@pytest.fixture(name='found', scope='module')
def found_fixture(runs):
    return identify(runs, RIG)


def test_none_explains_a_factor_of_identify_that_is_more_than_a_sound_ring_leaves(
        campaign, monkeypatch):
    run = read_run(campaign(runs=('static_50',))[0])
    alone = identify([run], RIG)
    monkeypatch.setattr(ring_diagnosis, 'MAX_SOUND', 0.5 * alone.sound_factor)
    found = ring_diagnosis.diagnose_ring([run], rig=RIG)
    assert found.verdict == 'none'
    (note,) = [one for one in found.notes if one.startswith('identify finds ')]
    assert note.startswith(f'identify finds {alone.sound_factor:.2f} times the misfit of noise')
    monkeypatch.setattr('saddlering_ros.discrepancy.diagnose',
                        lambda *_, **__: replace(found.diagnosis, verdict='unknown'))
    doubted = ring_diagnosis.diagnose_ring([run], rig=RIG)
    assert doubted.verdict == 'unknown'
    assert ring_diagnosis.USUAL[True] in doubted.notes
    assert max(doubted.diagnosis.probabilities.values()) == (
        doubted.diagnosis.probabilities['none']) == ring_diagnosis.SOUND
    assert doubted.diagnosis.headline.startswith('Perhaps nothing is wrong')
    assert doubted.next_test.startswith('None is needed')


def diagnosis(causes=(), std=0.001, more=(), place=0.5):
    base = {name: Estimate(1.0, std, '') for name in (*PARAMETER_NAMES, *more)}
    after = SimpleNamespace(theta_unit=np.r_[np.full(len(base) - 1, 0.5), place])
    return SimpleNamespace(
        causes=causes, base_alone=base, base=base,
        fits=SimpleNamespace(base_covariance=np.eye(len(base)), after=after))


def test_without_a_cause_values_and_reasons_are_those_of_identify(found):
    law = contact_law(diagnosis(), found, 1)
    for name in PARAMETER_NAMES:
        value = getattr(found.parameters.contact, name)
        assert law.before[name].value == law.after[name].value == value
    assert law.reasons_before == law.reasons_after == found.reasons
    assert 'n1' in law.reasons_before


def test_a_stiffness_that_is_open_is_open_in_catalogue_units_too(found):
    assert {'n1', 'n2'} <= set(found.reasons)
    told = [line for line in identification_text(found).splitlines()
            if line.lstrip().startswith(('K1 (axial', 'K2 (radial'))]
    assert len(told) == 2
    assert all('best known' in line for line in told)
    page = of_file(found.parameters)
    assert re.findall(r'N/mm\^n</td><td[^>]*></td><td>([^<]*)<', page) == [UNDETERMINED] * 2


def test_the_page_of_a_file_has_the_interval_of_identify_and_units_of_effects(found):
    """D had the interval 4.93 to 8.54 where that of identify was 5.15 to 8.81; a force was
    '4944.3 (SI)'."""
    deviations = np.sqrt(np.diag(found.parameters.source.covariance))
    damping, half = found.parameters.contact.D2, 1.96 * deviations[5]
    effects = {'radial_friction': {'force': 4944.0, 'sharpness': 0.5}, 'load_gain': {'gain': 0.02}}
    page = of_file(replace(found.parameters, effects=effects))
    factor = np.exp(half / damping)
    assert f'>{span(damping / factor, damping * factor)}<' in page
    assert all(words in page for words in ('4.94 kN', '>0.500<', '+2.00 %'))
    assert '(SI)' not in page


def test_a_cause_leaves_open_what_the_contact_law_alone_left_open(found):
    law = contact_law(diagnosis(('a cause',)), found, 1)
    assert law.after['K1'].value == 1.0
    assert law.reasons_after['n1'] == found.reasons['n1']


def test_a_cause_may_determine_what_only_waves_of_the_raceways_left_open(found):
    wavy = replace(found, reasons={**found.reasons, 'K1': 'K1 is known only within a factor 2'})
    law = contact_law(diagnosis(('a cause',)), wavy, 1)
    assert 'K1' in law.reasons_before
    assert law.reasons_after == found.reasons


def test_a_cause_beside_which_a_parameter_is_at_its_bound_leaves_it_open(found):
    law = contact_law(diagnosis(('a cause',), place=0.99999), found, 1)
    assert 'D2' not in law.reasons_before
    assert law.reasons_after['D2'].startswith('D2 is at its bound')


@pytest.mark.parametrize('alone', ['found', 'no unloading branch'])
def test_fitted_waves_are_no_part_of_the_contact_law(alone, found):
    wavy = diagnosis(('a cause',), more=('waves 1', 'waves 2'))
    law = contact_law(wavy, found if alone == 'found' else alone, 1)
    assert [*law.after] == [*law.before] == [*PARAMETER_NAMES]
    assert law.covariance.shape == (6, 6)


def test_where_identify_refuses_its_words_stay_and_wide_parameters_are_open():
    law = contact_law(diagnosis(std=1.0), 'no unloading branch', 1)
    assert law.refusal == 'no unloading branch'
    assert law.reasons_before['K1'].startswith('K1 is known only within a factor')
    assert not contact_law(diagnosis(), 'no unloading branch', 1).reasons_before


def test_a_parameter_file_keeps_what_is_not_determined(tmp_path, found):
    write_parameters(tmp_path / 'p.yaml', found.parameters)
    assert read_parameters(tmp_path / 'p.yaml').source.undetermined == found.reasons
