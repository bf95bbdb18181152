"""Waves of the raceways: what they do to a comparison, and how one session shows them."""

from dataclasses import dataclass, replace
from types import SimpleNamespace

import numpy as np
import pytest
from sessions_made import RIG, session

from saddlering_ros.diagnosis.raceways import explained_by_waves, waves_beside, with_raceways
from saddlering_ros.diagnosis.records import build_record
from saddlering_ros.diagnosis.ring_diagnosis import _beside_waves
from saddlering_ros.diagnosis.ring_system import RingSystem
from saddlering_ros.discrepancy import Point
from saddlering_ros.doubts import Finding
from saddlering_ros.identification.methods import identify
from saddlering_ros.progress import Watch
from saddlering_ros.rig import TRUE_TO_SCALE

MORE = {'load_gain': {'gain': 0.02}}
TRUE = TRUE_TO_SCALE.to_array()


@pytest.fixture(scope='module')
def even():
    """Records of a sound ring, its contact law by `identify`, and its runs."""
    records = session(0, [])
    return (identify(records, RIG).parameters.contact.to_array(),
            [build_record(RIG, one, held_out=False).run for one in records])


def wavy_ring():
    """The ring with waves of 20 um rms on each raceway, of up to twelve maxima."""
    draw = np.random.default_rng(3)
    amplitudes = draw.standard_normal((3, 24)) / np.repeat(np.arange(1, 13), 2)
    amplitudes *= 20e-6 * np.sqrt(2.0) / np.linalg.norm(amplitudes, axis=1, keepdims=True)
    return RingSystem(RIG, raceways=tuple(map(tuple, amplitudes.tolist())))


def measured_by(ring, runs):
    """The runs as this ring would move in them, with noise of 30 nm."""
    draw = np.random.default_rng(4)
    moved = [ring.predict_many(run, [Point(TRUE)])[0] for run in runs]
    return [replace(run, channels=channels + 3e-8 * draw.standard_normal(channels.shape))
            for run, channels in zip(runs, moved, strict=True)]


@dataclass
class Said:
    verdict: str
    fits: SimpleNamespace
    held_out_evidence: tuple = ('a held-out run excludes the clearance',)

    def in_doubt(self):
        return replace(self, verdict='unknown')


def diagnosed(verdict, law, causes=None):
    """What a diagnosis of even raceways says of its models."""
    before, after = (SimpleNamespace(point=Point(law, more)) for more in ({}, causes or {}))
    return Said(verdict, SimpleNamespace(before=before, after=after))


def change_by_more_load(ring, run, law):
    """What 2 % more load changes in a run, about its mean."""
    less, more = ring.predict_many(run, [Point(law), Point(law, MORE)])
    return (more - less) - (more - less).mean(axis=1, keepdims=True)


def test_waves_are_found_and_the_ring_then_answers_a_change_as_it_should(even):
    """With even raceways the true contact law answers wrongly by a quarter."""
    contact, runs = even
    true = wavy_ring()
    runs = measured_by(true, runs)
    found, law = with_raceways(RingSystem(RIG), runs, contact, Watch('compare'))
    assert law[[0, 3]] == pytest.approx(TRUE[[0, 3]], rel=1.0)
    for run in runs:
        wanted = change_by_more_load(true, run, TRUE)
        wrong, right = (
            np.linalg.norm(change_by_more_load(ring, run, at) - wanted) / np.linalg.norm(wanted)
            for ring, at in ((RingSystem(RIG), TRUE), (found, law)))
        assert right < 0.02 < 0.2 < wrong


def test_a_note_tells_waves_only_if_they_explain_the_held_out_run(even):
    contact, runs = even
    static, dynamic = measured_by(wavy_ring(), runs)
    wavy, law = with_raceways(RingSystem(RIG), [static], contact, Watch('diagnose'))
    [note] = explained_by_waves(wavy, [static, replace(dynamic, held_out=True)], law, contact)
    assert note.startswith('waves of the raceways (rms ')
    assert 'compare the session with an earlier one' in note
    other = replace(dynamic, held_out=True, channels=-dynamic.channels)
    assert explained_by_waves(wavy, [static, other], law, contact) == []


def test_waves_are_fitted_beside_causes_of_an_open_diagnosis(even):
    """Where friction moves most, waves alone explain little; beside this friction they do."""
    contact, runs = even
    true, friction = wavy_ring(), {'tilt_friction': {'moment': 1.2e4}}
    draw = np.random.default_rng(5)
    moved = [true.predict_many(run, [Point(TRUE, friction)])[0] for run in runs]
    runs = [replace(run, channels=one + 3e-8 * draw.standard_normal(one.shape))
            for run, one in zip(runs, moved, strict=True)]
    system, watch = RingSystem(RIG), Watch('diagnose')
    assert with_raceways(system, runs, contact, watch)[0] is system
    wavy, law = waves_beside(system, runs, diagnosed('unknown', contact, friction), watch)
    fitted = [*law, *(parameter.start for parameter in wavy.base_parameters[law.size:])]
    assert wavy.raceways_at(np.array(fitted)) == pytest.approx(np.array(wavy.raceways))
    for run in runs:
        left = wavy.predict_many(run, [Point(np.array(fitted), friction)])[0] - run.channels
        assert np.ptp(left, axis=1).max() < 0.05 * np.ptp(run.channels, axis=1).max()


def test_fitted_waves_leave_no_nuisance_parameter_of_the_same_kind(even):
    _, runs = even
    ring = wavy_ring()
    size = sum(map(len, ring.raceways))
    fitted = replace(ring, directions=np.eye(size)[:3].tolist())
    base = np.concatenate([TRUE, [1e-6, 2e-6, 3e-6]])
    assert [*np.ravel(fitted.raceways_at(base))[:4]] == pytest.approx(
        [1e-6, 2e-6, 3e-6, ring.raceways[0][3]])
    columns = fitted._wave_columns(runs[0], Point(base))
    assert np.abs(columns[..., :3]).max() < 1e-15 < np.abs(columns[..., 3:]).max()
    assert not {'out_of_round', 'axial_flatness'} & {one.id for one in fitted.effects}


@pytest.mark.parametrize(('verdict', 'causes', 'size', 'is_tried'), [
    ('unknown', {}, 1.0, True),
    ('named', {}, 1.0, True),
    ('unknown', {}, 0.0, False),
    ('named', {'axial_clearance': {'change': -1e-6}}, 1.0, True),
    ('named', {'axial_clearance': {'change': -1e-6}}, 0.0, False),
    ('named', {'load_gain': {'gain': 1e-3}}, 0.05, False)])
def test_waves_are_tried_where_a_diagnosis_leaves_what_they_explain(
        even, verdict, causes, size, is_tried):
    contact, runs = even
    wavy = wavy_ring()
    waves = tuple(tuple(size * one for one in row) for row in wavy.raceways)
    runs = measured_by(RingSystem(RIG, raceways=waves), runs)
    found = waves_beside(
        RingSystem(RIG), runs, diagnosed(verdict, contact, causes), Watch('diagnose'))
    assert (found is not None) == is_tried


@pytest.mark.parametrize(('even_says', 'beside_says', 'verdict', 'told'), [
    ('unknown', 'named', 'named', 'waves of the raceways are fitted beside the contact law'),
    ('named', 'ambiguous', 'ambiguous', 'an offset or a gain that does what waves do'),
    ('named', 'none', 'unknown', 'compare the session with an earlier one'),
    ('unknown', 'unknown', 'unknown', 'the best explanation is dry friction, which is not')])
def test_no_cause_of_even_raceways_is_named_where_waves_explain_more(
        even, even_says, beside_says, verdict, told):
    """A ring with waves and an ovalisation was named another axial clearance."""
    contact, runs = even
    records = [SimpleNamespace(run=run, test_run=SimpleNamespace(notes=[]))
               for run in measured_by(wavy_ring(), runs)]
    asked = []

    def diagnose(system, start):
        asked.append({parameter.name for parameter in system.base_parameters})
        friction = SimpleNamespace(definition=SimpleNamespace(title='Dry friction'))
        return SimpleNamespace(verdict=beside_says, causes=[friction][:beside_says == 'unknown'],
                               held_out_evidence=())

    answer, notes = _beside_waves(
        RingSystem(RIG), records, diagnosed(even_says, contact), diagnose, Watch('diagnose'))
    assert answer.verdict == verdict
    assert answer.held_out_evidence == ()  # A cause that was hidden was told to be excluded.
    assert told in notes[0]
    assert {'K1', 'waves 1', 'waves 9'} <= asked[0]


@pytest.mark.parametrize('even_says', ['unknown', 'named'])
def test_no_cause_is_named_nor_waves_fitted_where_readings_have_another_unit(even, even_says):
    """A load in lbf took 3.5 minutes, nearly all of them beside waves, to no end."""
    contact, runs = even
    note = Finding('the load begins at 1101 N', units='lbf')
    records = [SimpleNamespace(run=run, test_run=SimpleNamespace(notes=[note])) for run in runs]
    answer, notes = _beside_waves(
        RingSystem(RIG), records, diagnosed(even_says, contact), None, Watch('diagnose'))
    assert (answer.verdict, notes) == ('unknown', [])


def test_what_one_session_does_not_show_of_the_waves_is_a_nuisance_parameter(even):
    _, runs = even
    ring, point = wavy_ring(), Point(TRUE)
    upper, *others = ring.raceways
    other = RingSystem(RIG, raceways=((*upper[:4], upper[4] + 5e-7, *upper[5:]), *others))
    changes = np.concatenate([
        (other.predict_many(run, [point]) - ring.predict_many(run, [point])).ravel()
        for run in runs])

    def left(system):
        """Share of the changes that no nuisance parameter explains."""
        columns = np.vstack([block.reshape(-1, block.shape[-1])
                             for block in system.nuisances(runs, point)])
        fitted = columns @ np.linalg.lstsq(columns, changes, rcond=1e-10)[0]
        return np.linalg.norm(changes - fitted) / np.linalg.norm(changes)

    assert left(ring) < 0.02 < 0.1 < left(RingSystem(RIG))


@pytest.mark.parametrize('sign', [1.0, -1.0])
def test_even_raceways_stay_even_beside_a_misfit_that_no_waves_explain_too(even, sign):
    contact, runs = even
    system, runs = RingSystem(RIG), [replace(run, channels=sign * run.channels) for run in runs]
    assert with_raceways(system, runs, contact, Watch('compare'))[0] is system
