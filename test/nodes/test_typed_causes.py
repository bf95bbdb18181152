"""A verdict's causes as typed messages hold what its JSON holds."""

from dataclasses import fields
import math

from builtin_interfaces.msg import Time
import pytest

from saddlering_interfaces import msg
from saddlering_interfaces.action import DiagnoseRing
from saddlering_interfaces.msg import DiagnosisHeldOut, DiagnosisInfluence, DiagnosisRefit
from saddlering_ros.discrepancy.verdict.results import HeldOutEvidence, Influence, Refit, Remainder
from saddlering_ros.rig import ParameterSet, ParameterSource, TRUE_TO_SCALE
from saddlering_ros.ros import messages
from saddlering_ros.ros.messages import fill_diagnosis, parameters_to_message

DOCUMENT = {'causes': [
    {'effect': 'radial_friction', 'group': ['radial_friction', 'probe_lag'],
     'parameters': {'force': {'value': 5e3, 'std': 100.0, 'interval': [4804.1, 5195.9],
                              'unit': 'N'}},
     'evidence': {'p_value': 1e-9, 'delta_bic': -40.0}, 'gain': {'fit': 0.4, 'held_out': None}},
    {'channel': 'gamma'}]}


def test_every_figure_of_a_cause_is_in_its_message() -> None:
    result = DiagnoseRing.Result()
    fill_diagnosis(result, {**DOCUMENT, 'verdict': DiagnoseRing.Result.NAMED})
    (cause,) = result.causes
    assert (cause.effect, list(cause.group)) == ('radial_friction',
                                                 ['radial_friction', 'probe_lag'])
    assert (list(cause.parameter_names), list(cause.units)) == (['force'], ['N'])
    assert (cause.values[0], cause.stds[0]) == (5e3, 100.0)
    assert (cause.lower[0], cause.upper[0]) == (4804.1, 5195.9)
    assert (cause.p_value, cause.delta_bic, cause.misfit_reduction_fit) == (1e-9, -40.0, 0.4)
    assert math.isnan(cause.misfit_reduction_held_out)


def test_the_verdict_document_fills_every_typed_field() -> None:
    result = DiagnoseRing.Result()
    fill_diagnosis(result, {
        **DOCUMENT, 'verdict': DiagnoseRing.Result.NAMED, 'next_test': None,
        'headline': 'radial friction', 'complete': False, 'stability': None,
        'probabilities': {'radial_friction': 0.9, 'unknown': 0.1},
        'remainder': [{'run': 'a', 'channel': 'gamma', 'share_of_range': 0.01,
                       'times_noise': 3.0, 'along': 'load', 'size': 2e-6, 'unit': 'rad'}],
        'detection_limits': [{'effect': 'probe_lag', 'unit': 's', 'limit': 1e-3,
                              'best_limit': None, 'material_limit': 2e-3, 'testable': True}],
        'candidates': [{'effects': ['probe_lag'], 'step': 2, 'p_value': 0.5, 'misfit': 7.0}],
        'refits': [vars(Refit('without a', None, False))], 'near_limit': ['it falls with a'],
        'influence': [vars(Influence('a', 0.0, 2.5, 31.0))],
        'held_out_evidence': [vars(HeldOutEvidence(
            'probe_lag', 'lag of a probe', ('b', 'c'), 12.0, 0.02, False))]})
    assert (result.verdict, result.headline, result.complete) == (
        'named', 'radial friction', False)
    assert dict(zip(result.outcomes, result.probabilities, strict=True)) == {
        'radial_friction': 0.9, 'unknown': 0.1}
    assert math.isnan(result.stability)
    assert (result.remainder[0].along, result.remainder[0].times_noise) == ('load', 3.0)
    assert (result.remainder[0].size, result.remainder[0].unit) == (2e-6, 'rad')
    assert (result.detection_limits[0].limit, result.detection_limits[0].testable) == (1e-3, True)
    assert (list(result.candidates[0].effects), result.candidates[0].step) == (['probe_lag'], 2)
    assert math.isnan(result.candidates[0].delta_bic)
    assert result.refits == [DiagnosisRefit(change='without a')]
    assert list(result.near_limit) == ['it falls with a']
    assert result.influence == [DiagnosisInfluence(run='a', end=2.5, evidence=31.0)]
    assert result.held_out_evidence == [DiagnosisHeldOut(
        effect='probe_lag', title='lag of a probe', runs=['b', 'c'], distance=12.0, share=0.02)]


@pytest.mark.parametrize(('message', 'entry'), [
    (DiagnosisHeldOut, HeldOutEvidence), (DiagnosisInfluence, Influence),
    (DiagnosisRefit, Refit), (msg.DiagnosisRemainder, Remainder)])
def test_a_message_has_every_field_of_its_entry(message: type, entry: type) -> None:
    assert set(message.get_fields_and_field_types()) == {one.name for one in fields(entry)}


def test_a_document_without_the_newer_fields_leaves_them_empty() -> None:
    result = DiagnoseRing.Result()
    fill_diagnosis(result, {'verdict': 'none', 'causes': []})
    assert (result.headline, list(result.outcomes), list(result.remainder)) == ('', [], [])


def test_an_undetermined_parameter_stays_one_through_its_message() -> None:
    source = ParameterSource('swarm', ('a',), undetermined={'D1': 'too few steps'})
    message = parameters_to_message(ParameterSet(TRUE_TO_SCALE, source=source), Time())
    assert list(message.determined) == [True, True, False, True, True, True]
    assert set(messages.parameters_from_message(message).source.undetermined) == {'D1'}
