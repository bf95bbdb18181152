"""Claims about the next test of a verdict: specific, with an outcome for every cause."""

from dataclasses import replace
from itertools import combinations
import math
from types import SimpleNamespace

from few_effects import few_effects
import numpy as np
import pytest

from saddlering_ros.bags.reader import read_run
from saddlering_ros.diagnosis import diagnose_ring, next_test, ring_wording
from saddlering_ros.diagnosis.next_test import on_slewed_ring, propose, with_swapped_probes
from saddlering_ros.diagnosis.rig_dimensions import entries_of
from saddlering_ros.diagnosis.ring_wording import document_text, headline, size_of, title_of
from saddlering_ros.discrepancy import Point, Separation
from saddlering_ros.discrepancy.next_step import HeldOutEvidence
from saddlering_ros.discrepancy.verdict.wording import almost_a_cause_words, free_test_words
from saddlering_ros.effects import catalogue
from saddlering_ros.effects.base import RIG_TESTS
from saddlering_ros.quantities import lowered
from saddlering_ros.rig import default_rig

KNOWN_GROUPS = (
    ('load_gain', 'elevation_error', 'moment_arm', 'tilt_compliance'),
    ('radial_clearance', 'out_of_round', 'worn_sector_radial'),
    ('ring_ovalisation', 'probe_gain'), ('probe_lag', 'clock_offset'),
    ('tilt_friction', 'settling', 'probe_drift'), ('radial_friction', 'film_creep'))
"""Ambiguities that are known beforehand."""


def test_every_outcome_belongs_to_a_test_of_the_table():
    stated = {test for effect in catalogue().values() for test in effect.outcomes}
    assert stated == {item.id for item in RIG_TESTS}


@pytest.mark.parametrize('group', KNOWN_GROUPS, ids=lambda group: group[0])
def test_every_cause_of_a_known_ambiguity_gets_an_outcome_of_its_own(group):
    sentence = next_test.between(group)
    assert all(lowered(title_of(name)) in sentence for name in group)
    assert sentence.count(' means ') == len(group)
    assert 'is open' not in sentence


def test_two_effects_that_no_test_separates_act_on_different_channels():
    alike = [pair for pair in combinations(sorted(catalogue()), 2)
             if next_test.between(pair) is None]
    assert alike
    for pair in alike:
        first, second = (plain_channels(name) for name in pair)
        assert not first & second, pair


def plain_channels(name: str) -> set[str]:
    """Channels of an effect's choices, wider forms left out."""
    effect = catalogue()[name]
    plain = [item for item in effect.variants if not item.frees]
    return {channel for item in plain for channel in item.channels or effect.channels}


@pytest.mark.parametrize('effect', sorted(catalogue()))
def test_a_named_cause_gets_a_test_that_would_confirm_it(effect):
    sentence = next_test.confirming(effect, [])
    assert sentence.startswith(f'To confirm {lowered(title_of(effect))}: ')
    assert sentence.endswith('.')


def test_look_alikes_of_the_data_are_what_a_named_cause_is_confirmed_against():
    cosines = {'radial_friction': {'film_creep:0': 0.9, 'film_creep:1': 0.8, 'load_gain': 0.1},
               'load_gain': {'radial_friction': 0.1}}
    assert next_test.look_alikes('radial_friction', cosines) == ['film_creep']
    sentence = next_test.confirming('radial_friction', ['film_creep'])
    assert 'loop of the same height means dry friction in the radial row' in sentence
    assert 'a loop whose height depends on the rate means creep of the oil film' in sentence


@pytest.mark.parametrize(('named', 'alike', 'test'), [
    ('bracket_play', ('cylinder_friction', 'load_nonlinearity', 'damping_law'), 'inclinometer'),
    ('bolt_opening', ('probe_bracket', 'probe_saturation', 'probe_nonlinearity'), 'Slew the')])
def test_a_name_is_confirmed_by_the_test_that_tells_it_from_each_look_alike(named, alike, test):
    """Not by one that tells look-alikes from each other, and leaves the most similar open."""
    sentence = next_test.confirming(named, alike)
    assert test in sentence
    assert f'means {lowered(title_of(named))}{";" if ";" in sentence else "."}' in sentence


def proposed():
    class Payload:
        elevation = math.radians(50.0)
    runs = [type('Run', (), {'payload': Payload})]
    return propose(default_rig(), runs)


def simulated(kind: str, share: float) -> list[Separation]:
    proposal = next(item for item in proposed() if item.kind == kind)
    return [Separation(proposal, 100, round(100 * share), 100, {}, refitted=True)]


def test_the_simulated_test_of_a_group_states_its_outcomes_and_how_often_it_is_enough():
    group = ['radial_friction', 'film_creep']
    sentence = next_test.for_group(group, simulated('second_rate', 0.87))
    assert sentence.startswith('Record a slow ramp to 25 t and back in 60 s')
    assert 'a loop whose height depends on the rate means creep of the oil film' in sentence
    assert sentence.endswith('In 87 of 100 simulated draws, this test leaves the true cause alone '
                             '(95 % interval 79 to 92).')


@pytest.mark.parametrize(('together', 'words'), [
    (((('load_gain',),), (('load_offset',),), (('moment_arm',),)),
     'It parts all of these causes.'),
    (((('load_gain',), ('load_offset',)), (('moment_arm',),)),
     'It parts wrong moment arm from all others; it leaves open load gain error or load zero '
     'offset.'),
    (((('load_gain',), ('load_offset',), ('moment_arm',)),),
     'It leaves open load gain error or load zero offset or wrong moment arm.')])
def test_a_simulated_test_states_which_alternatives_it_parts(together, words):
    group = ('load_gain', 'load_offset', 'moment_arm')
    (one,) = simulated('other_elevation', 0.87)
    sentence = next_test.for_group(group, [replace(one, together=together)])
    assert words in sentence
    found = SimpleNamespace(
        verdict='unknown', held_out_evidence=(), remainder=(),
        separations=[replace(one, together=together)],
        causes=[SimpleNamespace(effect='load_gain', group=group)], explained=0.3, law=None,
        residual_after=AFTER)
    told = next_test.next_test(found, [], [], default_rig())
    assert told == f'If the cause is {told_titles(group)}: {sentence} {told_swap()}'
    found.residual_after = SimpleNamespace(fast=STILL, shapes=[])
    told = next_test.next_test(found, [], [], default_rig())
    assert told == f'If the cause is {told_titles(group)}: {sentence}'


@pytest.mark.parametrize(('verdict', 'explained', 'together', 'words'), [
    ('unknown', 0.3, ((('tilt_friction', 'load_gain'), ('tilt_friction', 'load_offset')),
                      (('tilt_friction', 'moment_arm'),), (('clock_offset', 'load_gain'),)),
     'this test leaves the true cause alone (95 % interval 79 to 92). Of load gain error or load '
     'zero offset or wrong moment arm: It parts wrong moment arm from all others; it leaves open '
     'load gain error or load zero offset.'),
    ('ambiguous', 0.9, ((('tilt_friction', 'load_gain'), ('tilt_friction', 'load_offset'),
                         ('tilt_friction', 'moment_arm')), (('clock_offset', 'load_gain'),)),
     'Of load gain error or load zero offset or wrong moment arm: Put a calibrated load cell')])
def test_each_group_is_told_what_parts_it(verdict, explained, together, words):
    (one,) = simulated('repeat_cycle', 0.87)
    groups = (('tilt_friction', 'clock_offset'), ('load_gain', 'load_offset', 'moment_arm'))
    found = SimpleNamespace(
        verdict=verdict, held_out_evidence=(), remainder=(),
        separations=[replace(one, together=together)], causes=[
            SimpleNamespace(effect=group[0], group=group, elsewhere=()) for group in groups],
        explained=explained, law=None, residual_after=AFTER)
    assert words in next_test.next_test(found, [], [], default_rig())


def told_swap() -> str:
    return next_test.for_residual(AFTER)


def an_unknown(explained: float, *group: str, law=None, runs=((), ())) -> str:
    """The next test of an `unknown` whose causes explain this share of the misfit."""
    cause = SimpleNamespace(effect=group[0], group=group)
    found = SimpleNamespace(
        verdict='unknown', held_out_evidence=(), remainder=(), separations=(), causes=[cause],
        law=law, explained=explained, residual_after=AFTER)
    return next_test.next_test(found, *runs, default_rig())


@pytest.mark.parametrize(('fitted', 'held_out', 'words'), [
    ((50.0, 50.0), (70.0, 50.0), 'Fit run_2 too: at one elevation many causes look alike. '),
    ((50.0, 70.0), (30.0,), ''), ((50.0,), (50.0,), ''), ((50.0,), (), '')])
def test_a_held_out_run_at_another_elevation_is_the_first_test_of_an_unknown(fitted, held_out,
                                                                             words):
    """A ring whose five bags name an elevation error was told to record a fast ramp."""
    runs = [SimpleNamespace(name=f'run_{number}', test='static', elevation=math.radians(degrees),
                            rig_hash=default_rig().digest)
            for number, degrees in enumerate((*fitted, *held_out))]
    told = an_unknown(0.014, 'bolt_opening', runs=(runs[:len(fitted)], runs[len(fitted):]))
    assert told == words + told_swap()


def test_causes_that_explain_little_get_no_test_of_their_own():
    group = ('bolt_opening', 'tilt_friction')
    assert an_unknown(0.3, *group).startswith('If the cause is opening bolted joint or dry ')
    assert an_unknown(0.014, *group) == told_swap()


def test_one_cause_that_is_not_established_gets_the_test_that_would_confirm_it():
    assert an_unknown(0.8, 'tilt_compliance').startswith(
        'To confirm tilt compliance in series: Repeat the static test at another elevation.')


@pytest.mark.parametrize(('target', 'coordinate', 'words'), [
    ('gamma', 'hysteresis', 'If the loop of gamma repeats'),
    ('d1', 'time', 'If eddy_current_1 moves without any load'),
    ('d4', 'load', 'Swap probes 2 and 4'),
    ('hydraulic_load', 'load', 'Put a calibrated load cell in line')])
def test_a_proposed_law_tells_what_the_next_test_is_about(target, coordinate, words):
    law = SimpleNamespace(terms=[SimpleNamespace(target=target, coordinate=coordinate)])
    assert words in an_unknown(0.0, 'settling', law=law)
    shaking = SimpleNamespace(view='delta_y', frequency=0.076, visible=0.02)
    assert words in next_test.for_residual(SimpleNamespace(shapes=AFTER.shapes, fast=shaking), law)


def test_a_test_at_another_elevation_is_not_proposed_where_two_were_recorded():
    """A bent bracket was to be confirmed by a test that the bags held already."""
    variants = ({'probe': 1.0}, {'probe': 4.0})
    cause = SimpleNamespace(
        effect='probe_bracket', group=('probe_bracket',), elsewhere=(),
        definition=SimpleNamespace(variants=variants),
        parameters={'probe': SimpleNamespace(value=4.0)})
    labels = ('probe_bracket:0', 'probe_bracket:1', 'ring_ovalisation', 'axial_compliance')
    cosines = np.array([[1, 0, 0.9, 0], [0, 1, 0, 0.7], [0.9, 0, 1, 0], [0, 0.7, 0, 1]])
    found = SimpleNamespace(
        verdict='named', causes=[cause], held_out_evidence=(), separations=(), remainder=(),
        observability=SimpleNamespace(labels=labels, cosines=cosines))
    one, other, fast = (SimpleNamespace(test=test, elevation=math.radians(degrees))
                        for test, degrees in (('static', 38), ('static', 62), ('dynamic', 62)))
    told = next_test.next_test(found, [one, fast], [], default_rig())
    assert 'Repeat the static test at another elevation.' in told
    assert 'ovalisation' not in told  # that of probe 1 alone looks alike
    told = next_test.next_test(found, [one, other], [], default_rig())
    assert told.startswith('To confirm probe bracket bends with load: Swapped probes')
    found.remainder = (SimpleNamespace(run='static_62', along='time'),
                       SimpleNamespace(run='static_70', along=''))
    told = next_test.next_test(found, [one, other], [], default_rig())
    assert told.startswith('Fit static_70 too, which the model does not predict. To confirm ')


def told_titles(group) -> str:
    return ' or '.join(lowered(title_of(name)) for name in group)


def test_a_test_that_cannot_be_simulated_comes_before_a_simulated_one_that_separates_little():
    group = ['radial_clearance', 'radial_compliance']
    low = next_test.for_group(group, simulated('second_rate', 0.1))
    assert low == next_test.between(group)
    assert 'simulated' in next_test.for_group(group, simulated('second_rate', 0.6))


def test_tests_that_never_leave_one_cause_alone_are_not_recommended_by_their_share():
    group = ['radial_friction', 'settling']
    assert next_test.for_group(group, simulated('second_rate', 0.0)) == (
        f'{next_test.between(group)} None of 1 simulated tests leaves one of these causes alone: '
        'compare the size of each with the rig.')


def test_every_proposed_test_is_of_a_known_kind_and_has_a_name_of_its_own():
    tests = proposed()
    assert {item.kind for item in tests} <= {test.id for test in RIG_TESTS}
    assert len({item.run.name for item in tests}) == len(tests)
    assert all('to 25 t ' in item.sentence for item in tests if 'ramp' in item.sentence)
    assert 'Repeat the static test at 30 deg.' in [item.sentence for item in tests]


def test_swapped_probes_carry_a_bad_gain_with_them_and_leave_a_bent_bracket():
    point = Point(np.zeros(6), {'probe_gain': {'probe': 2.0, 'gain': 0.01},
                                'probe_bracket': {'probe': 2.0, 'compliance': 1e-11}})
    swapped = with_swapped_probes(point).effects
    assert swapped['probe_gain'] == {'probe': 4.0, 'gain': 0.01}
    assert swapped['probe_bracket'] == point.effects['probe_bracket']


def test_a_slewed_ring_turns_an_oval_round_and_moves_a_worn_arc():
    oval = {'amplitude': 1e-6, 'angle': 0.1}
    point = Point(np.zeros(6), {'out_of_round': oval,
                                'axial_flatness': {**oval, 'third': 0.3},
                                'worn_sector_axial': {'wear': 0.2, 'centre': 3.0}})
    slewed = on_slewed_ring(point).effects
    assert slewed['out_of_round'] == {'amplitude': -1e-6, 'angle': 0.1}
    # A wave of three maxima is then odd: its two halves cancel.
    assert slewed['axial_flatness'] == {'amplitude': -1e-6, 'angle': 0.1, 'third': 0.0}
    assert slewed['worn_sector_axial']['centre'] == pytest.approx(1.5 * math.pi - 3.0)


def test_a_law_that_repeats_an_effect_of_the_catalogue_is_reported_as_such():
    cosines = {'own_law:': {'probe_bracket:1': 0.991, 'probe_gain:1': 0.9},
               'probe_bracket:1': {'own_law:': 0.991}}
    (sentence,) = next_test.repeated_laws(['own_law'], cosines)
    assert sentence.startswith('own_law changes these data in the same way as an effect of the '
                               'catalogue (probe bracket bends with load): ')
    assert next_test.repeated_laws(['own_law'], {'own_law:': {'probe_gain:1': 0.9}}) == []


def test_a_sound_ring_is_told_which_causes_these_data_could_not_show():
    sentence = next_test.for_unseen(['load_gain'])
    assert 'load gain error' in sentence
    assert 'calibrated load cell' in sentence
    assert next_test.for_unseen([]) is None
    sentence = next_test.for_unseen(['axial_clearance', 'load_gain', 'unequal_rows'])
    assert sentence.startswith(
        'These data cannot show wrong axial clearance or load gain error or unequal axial rows, '
        'because contact parameters imitate them.')
    assert 'To see wrong axial clearance or unequal axial rows: Pull and push' in sentence


def test_what_nothing_explains_gets_a_test_of_its_own_channel():
    shape = SimpleNamespace(view='gamma', coordinate='load', p_value=1e-9, visible=0.01)
    for share, words in ((0.0, 'probes 2 and 4'), (0.005, 'probes 2 and 4'), (0.02, '12 Hz')):
        fast = SimpleNamespace(view='gamma', frequency=12.0, visible=share)
        assert words in next_test.for_residual(SimpleNamespace(shapes=[shape], fast=fast))


def test_a_wrong_dimension_is_told_with_the_entry_as_it_is_and_as_it_should_be():
    cause = SimpleNamespace(effect='rig_axial_span', group=('rig_axial_span', 'film_creep'),
                            parameters={'change': SimpleNamespace(value=-0.05)})
    assert entries_of(default_rig(), [cause]) == [
        'rig.probes.axial_span (1.3 m in the file, 1.25 m by these data)']


def test_a_size_is_said_with_its_place_its_sign_and_its_unit():
    cause = {'effect': 'probe_gain', 'parameters': {
        'probe': {'value': 2.0, 'std': 0.0, 'unit': ''},
        'gain': {'value': 0.03, 'std': 0.002, 'unit': '1'}}}
    assert size_of(cause) == 'probe 2 gain +3.00 ± 0.20 %'
    elsewhere = [{'probe': 4.0, 'gain': -0.029}]
    assert size_of({**cause, 'elsewhere': elsewhere}).endswith(' or probe 4 gain -2.90 %')


@pytest.mark.parametrize(('effect', 'sizes', 'words'), [
    ('tilt_friction', {'moment': (100.0, 26.0, 'N m'), 'force': (4370.0, 110.0, 'N'),
                       'force_y': (3000.0, 1600.0, 'N')}, 'force 4.37 ± 0.11 kN'),
    ('film_creep', {'share': (0.087, 0.01, '1'), 'share_axial': (0.1087, 0.0015, '1')},
     'share 8.7 ± 1.0 %, share_axial 10.87 ± 0.15 %'),
    ('tilt_friction', {'moment': (100.0, 60.0, 'N m'), 'force': (30.0, 40.0, 'N')},
     'moment 100 ± 60 N m'),
    # The rate of probe 1 alone would not tell what probe 3 does.
    ('probe_drift', {'rate': (3.35e-8, 1.8e-9, 'm/s'), 'sum': (2e-10, 6e-10, 'm/s')},
     'rate 33.5 ± 1.8 nm/s, sum 0.20 ± 0.60 nm/s')])
def test_the_sizes_that_move_most_are_said(effect, sizes, words):
    """A radial force of 4.4 kN was hidden behind a moment of 100 N m."""
    assert size_of({'effect': effect, 'parameters': {
        name: {'value': value, 'std': std, 'unit': unit}
        for name, (value, std, unit) in sizes.items()}}) == words


def a_line(cosine: float, sine: float, frequency: float) -> dict:
    sizes = {'cosine': (cosine, 'm'), 'sine': (sine, 'm'), 'frequency': (frequency, 'Hz'),
             'probe': (2.0, '')}
    return {'effect': 'mains_pickup', 'group': ['mains_pickup'], 'parameters': {
        name: {'value': value, 'std': 0.0, 'unit': unit} for name, (value, unit) in sizes.items()}}


def test_lines_are_told_in_one_phrase_and_waves_of_the_raceways_in_another():
    causes = [a_line(1.2e-6, 1.6e-6, 50.0), a_line(-3.58e-7, 0.0, 100.0)]
    assert headline({'verdict': 'named', 'causes': causes}) == (
        'The simulation lacks mains pickup (probe 2 amplitude 2.00 µm at 50.0 Hz and '
        'probe 2 amplitude 358 nm at 100 Hz).')
    assert headline({
        'verdict': 'named', 'causes': causes[1:],
        'raceways': {'upper': 2e-5, 'lower': 1.2e-5, 'radial': 8e-6}}) == (
        'The simulation lacks mains pickup (probe 2 amplitude 358 nm at 100 Hz). The model has '
        'waves of the raceways (rms 20 µm in the upper row, 12 µm in the lower row and 8.0 µm in '
        'the radial row), too.')
    assert ring_wording.parameter_words(causes[0]) == (
        'probe 2, amplitude 2.00 µm, frequency 50.0 Hz')


def sound(**channels: tuple[float, float, float]) -> dict:
    """A verdict `none` with misfit, noise and small errors of each channel of its run."""
    return {'verdict': 'none', 'causes': [], 'notes': [], 'next_test': None,
            'gain': {'fit': 0.0, 'held_out': None, 'how': 'none'},
            'parameters': {'before': {}, 'after': {}},
            'runs': [{'bag': 'dynamic_70', 'held_out': False, 'channels': {
                name: {'nrmse_before': misfit, 'noise_floor': floor, 'sound': small}
                for name, (misfit, floor, small) in channels.items()}}]}


def test_none_states_what_noise_and_a_sound_ring_leave_where_the_misfit_is_more_than_noise():
    said = headline(sound(delta_y=(0.015, 0.0045, 0.018), gamma=(0.004, 0.001, 0.004)))
    assert '(1.5 % of range in delta_y, where noise and these leave 1.9 % rms)' in said


def test_none_states_the_size_of_a_cause_that_more_misfit_may_hide():
    said = headline(sound(delta_y=(0.022, 0.004, 0.0066), gamma=(0.04, 0.001, 0.03)))
    assert ('(2.2 % of range in delta_y, although noise and these leave only 0.77 % rms: a cause '
            'of up to 2.2 % of range may be hidden there)') in said


def test_none_states_the_errors_of_the_rig_file_that_these_data_may_not_show():
    limits = [{'effect': 'radial_clearance', 'limit': 4.28e-5, 'unit': 'm', 'testable': True},
              {'effect': 'axial_clearance', 'limit': None, 'unit': 'm', 'testable': False},
              {'effect': 'film_creep', 'limit': 0.01, 'unit': '1', 'testable': True}]
    words = ('Errors of the rig file below these sizes may not show: rig.middle_row.clearance '
             '43 µm.')
    document = {**sound(delta_y=(0.001, 0.001, 0.001)), 'detection_limits': limits}
    assert words in document_text(document).splitlines()
    assert words not in document_text({**document, 'verdict': 'unknown'})


def test_evidence_beyond_what_a_cause_needs_is_said_to_be_too_small_to_matter():
    words = almost_a_cause_words('wrong radial clearance', 1.06, 0.0008)
    assert words == ('wrong radial clearance has the evidence that a cause needs, but changes '
                     'only 0.080 % of range, which is too small to matter')
    assert '80 % of the evidence' in almost_a_cause_words('wrong radial clearance', 0.8, 0.01)


SWAP = 'Swap probes 2 and 4'
STILL = SimpleNamespace(visible=0.0)
AFTER = SimpleNamespace(fast=STILL, shapes=[
    SimpleNamespace(view='delta_y', coordinate='load', p_value=0.0, visible=0.01)])


@pytest.mark.parametrize(('verdict', 'rig_hash', 'is_first'), [
    ('unknown', '', True), ('unknown', 'f' * 64, True), ('unknown', default_rig().digest, False),
    ('named', '', False), ('none', '', False)])
def test_the_rig_file_comes_before_the_probes_unless_a_hash_vouches_for_it(
        verdict, rig_hash, is_first):
    unseen = SimpleNamespace(limits=[SimpleNamespace(effect='film_creep', testable=False)],
                             labels=(), cosines=())
    cause = SimpleNamespace(effect='radial_friction', group=('radial_friction',), elsewhere=(),
                            definition=SimpleNamespace(variants=({},)))
    found = SimpleNamespace(
        verdict=verdict, causes=[cause], residual_after=AFTER, observability=unseen,
        held_out_evidence=(), remainder=(), explained=0.0, law=None)
    run = SimpleNamespace(rig_hash=rig_hash, test='static', elevation=0.0)
    sentence = next_test.next_test(found, [run], [], default_rig())
    assert (SWAP in sentence) == (verdict == 'unknown')
    assert sentence.startswith('First compare the rig file') == is_first


@pytest.mark.slow
def test_a_large_group_of_one_elevation_is_told_the_run_that_parts_it(campaign, monkeypatch):
    """The free one first, and then to record one at another elevation; refits change no words."""
    monkeypatch.setattr('saddlering_ros.discrepancy.next_step.MAX_REFITS', 0)
    fitted, held_out = (read_run(bag) for bag in campaign(
        'moment_arm', 0.06, 'offset', runs=('static_50', 'static_70')))
    with few_effects(*KNOWN_GROUPS[0], 'load_offset', 'probe_bracket', 'probe_gain'):
        found = diagnose_ring([fitted], [held_out], rig=default_rig())
    assert len(found.diagnosis.causes[0].group) >= 5
    record = found.diagnosis.separations[0].proposal.sentence
    assert record.endswith((' 30 deg.', ' 70 deg.'))
    assert found.next_test.startswith('Fit static_70 too: ')
    assert record in found.next_test


@pytest.mark.parametrize('remain', [('moment_arm', 'load_gain'), ('moment_arm',)])
def test_held_out_runs_state_the_best_alternative_and_those_that_they_exclude(remain):
    evidence = [HeldOutEvidence(name, lowered(title_of(name)), ('static_70',), 0.0, share,
                                name in remain)
                for name, share in (('moment_arm', 0.7), ('moment_arm', 0.2), ('load_gain', 0.1))]
    words = ('the model with wrong moment arm predicts static_70 best (90 % of the probability of '
             'the alternatives)')
    assert free_test_words(evidence) == (
        f'Held-out static_70 cannot separate the alternatives: {words}.' if len(remain) == 2 else
        f'Fit static_70 too: {words}, and this excludes load gain error.')


def test_a_moment_arm_with_five_alternatives_is_told_the_tests_that_need_no_record_first():
    group = ('moment_arm', 'elevation_error', 'load_gain', 'load_offset', 'rig_trunnion_x',
             'rig_weight_x')
    cause = SimpleNamespace(effect='moment_arm', group=group, elsewhere=())
    evidence = [HeldOutEvidence(name, lowered(title_of(name)), ('static_70',), 0.0,
                                float(name == 'moment_arm'), name == 'moment_arm')
                for name in group]
    found = SimpleNamespace(
        verdict='ambiguous', causes=[cause], held_out_evidence=evidence, separations=(),
        remainder=())
    sentence = next_test.next_test(found, [], [], default_rig())
    free, drawing, record = (sentence.index(words) for words in (
        'Fit static_70 too: the model with wrong moment arm predicts static_70 best (over 99 %',
        'First compare the rig file with the drawing and the ring: ', ' means '))
    assert free < drawing < record
    assert 'rig.trunnion.x, rig.carriage.weight_x' in sentence
