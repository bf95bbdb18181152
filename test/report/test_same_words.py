"""Console, report and live page print the same words for the same result."""

from html import unescape
import re
from types import SimpleNamespace

from documents import document
import pytest

from saddlering_ros.comparison.change import Change
from saddlering_ros.diagnosis.ring_wording import document_text, headline
from saddlering_ros.discrepancy import Cause, Effect, Estimate, Parameter
from saddlering_ros.discrepancy.problem.fits import Gain
from saddlering_ros.discrepancy.verdict.wording import headline_of, lacking_words
from saddlering_ros.identification.result import parameter_words
from saddlering_ros.live.commands import Job, with_diagnosis, with_identification
from saddlering_ros.quantities import VERDICT_WORDS
from saddlering_ros.report import chapters

OPEN = {'value': 1.27e8, 'unit': 'N/m^n', 'std': None, 'interval': None, 'pinned': False,
        'reason': 'the rollers may be unequal', 'at_bound': False}


def of_verdict(verdict, **changes):
    shape = {'shape': 'delta_x follows the load', 'channel': 'delta_x', 'coordinate': 'load',
             'share_of_range': 0.05}
    cause = {'title': 'Dry friction', **document()['causes'][0]}
    open_cause = {**cause, 'effect': 'settling', 'group': ['settling', 'load_gain'],
                  'title': 'Settling', 'parameters': {
                      'amplitude': {'value': 1e-5, 'std': 1e-6, 'unit': 'm'}}}
    causes = {'named': [cause], 'ambiguous': [cause, open_cause],
              'unknown': [shape, {**cause, 'partial': True}], 'none': []}
    return document(verdict, next_test='Load twice as fast.', causes=causes[verdict], **changes)


@pytest.mark.parametrize('verdict', VERDICT_WORDS)
def test_a_verdict_has_the_same_words_everywhere(verdict):
    said = of_verdict(verdict, near_limit=['it falls with a run'], remainder=[
        {'run': 'static_70', 'channel': 'delta_y', 'share_of_range': 0.004, 'times_noise': 9.0,
         'along': 'load', 'size': 2e-6, 'unit': 'm'}])
    answer = with_diagnosis(Job('goal'), said)
    console = document_text(said)
    banner = ' '.join(unescape(re.sub(r'<[^>]+>', ' ', chapters.verdict_banner(said))).split())
    for place in (console, banner, f'{answer.title} {answer.words} '
                  + ' '.join(answer.lines)):
        assert f'erdict: {verdict} ({VERDICT_WORDS[verdict]})' in place
        assert answer.words in place
        assert 'Load twice as fast.' in place
    assert 'The verdict is near its limit: it falls with a run.' in answer.lines
    assert answer.lines[-1].startswith(
        'Beyond noise, causes and small errors remain: static_70, delta_y')
    for line in answer.lines[1:]:
        assert line in console
        assert line in banner


@pytest.mark.parametrize('rest', [[], [
    {'run': 'static_70', 'channel': 'delta_y', 'share_of_range': 0.004, 'times_noise': 9.0}]])
@pytest.mark.parametrize('verdict', VERDICT_WORDS)
def test_a_headline_is_one_sentence_with_titles(verdict, rest):
    said = headline(of_verdict(verdict, complete=not rest, remainder=rest))
    assert said.endswith('.')
    assert '. ' not in said
    assert not re.search(r'radial_friction|load_gain', said)
    is_established = verdict in ('named', 'ambiguous')
    assert said.endswith('; a rest of 0.40 % of range in delta_y fits no cause.') == bool(
        is_established and rest)
    assert (' mainly ' in said) == bool(is_established and rest)


def test_a_rest_says_what_small_errors_of_the_ring_are_left_beside_it():
    """It said 0.48 %, and the table of the same report had 5.5 %."""
    runs = [{'bag': name, 'elevation_deg': 30.0, 'test': 'static', 'held_out': False, 'channels': {
        channel: {'nrmse_before': 0.3, 'nrmse_after': after, 'noise_floor': 0.007, 'sound': 0.03}
        for channel, after in (('delta_x', 0.008), ('delta_y', misfit), ('parity', 0.4))}}
        for name, misfit in (('static_30', 0.055), ('static_50', 0.053))]
    rest = {'run': 'static_30', 'channel': 'delta_y', 'share_of_range': 0.0048,
            'times_noise': 2.1, 'along': 'load', 'size': 2e-7, 'unit': 'm'}
    told = headline(of_verdict('named', complete=False, remainder=[rest], runs=runs))
    assert told.endswith('; a rest of 0.48 % of range in delta_y fits no cause beside small '
                         'errors of the ring (with these, the model leaves up to 5.5 % in '
                         'delta_y).')


def test_the_headline_of_runs_held_out_in_turn_does_not_tell_of_held_out_runs():
    words = lacking_words(['dry friction'], '; a rest', 0.9, 0.8, 'held out in turn')
    assert words == ('The simulation lacks mainly dry friction: 80 % of the misfit on runs held '
                     'out in turn; a rest.')


def test_a_steady_line_beside_a_rest_is_told_without_the_gain_of_a_model():
    line = {**document()['causes'][0], 'effect': 'mains_pickup', 'group': ['mains_pickup'],
            'parameters': {name: {'value': value, 'std': 1e-8, 'unit': unit} for name, value, unit
                           in (('cosine', 3e-6, 'm'), ('sine', 4e-6, 'm'),
                               ('frequency', 50.0, 'Hz'))}}
    assert headline(document(
        'named', causes=[line], gain={'fit': 0.0, 'held_out': 0.0, 'how': 'none'}, complete=False,
        remainder=[{'share_of_range': 0.004, 'channel': 'delta_y'}])).endswith(
            'at 50.0 Hz); a rest of 0.40 % of range in delta_y fits no cause.')


@pytest.mark.parametrize('verdict', VERDICT_WORDS)
def test_the_headline_of_any_simulator_and_of_a_change_is_one_sentence(verdict):
    effect = Effect('Dry friction', {'size': Parameter(0.0, 1.0)}, id='friction')
    cause = Cause('friction', effect, 0, ('friction', 'play'), {
        'size': Estimate(0.5, 0.1, 'N')}, 1e-9, 40.0, 0.05, Gain(0.9, 0.8, 'held out'))
    found = SimpleNamespace(
        verdict=verdict, complete=verdict == 'none', gain=cause.gain,
        causes=[] if verdict == 'none' else [cause], probabilities={},
        title_of={'friction': 'Dry friction', 'play': 'Play'}.get,
        remainder=[SimpleNamespace(share_of_range=0.004, channel='force', along='time')])
    change = Change.headline.fget(SimpleNamespace(verdict=verdict, diagnosis=found))
    for said in (headline_of(found), change):
        assert said.endswith('.')
        assert '. ' not in said
    if verdict not in ('none', 'unknown'):
        assert headline_of(found) == (
            'The simulation lacks mainly either Dry friction or Play (these data cannot tell '
            'which): 80 % of the misfit on held-out runs; a rest of 0.40 % of range in force fits '
            'no cause.')


def test_an_open_parameter_has_the_same_words_on_the_live_page():
    answer = with_identification(Job('goal', words='identified'), {'parameters': {'K1': OPEN}})
    assert answer.lines == [parameter_words('K1', OPEN)]
    assert answer.lines[0].startswith('K1: not determined by these data (best known 1.27')
