"""Waves of the raceways: what they do to a comparison, and how one session shows them."""

from dataclasses import replace

import numpy as np
import pytest
from sessions_made import RIG, session

from saddlering_ros.diagnosis.raceways import explained_by_waves, with_raceways
from saddlering_ros.diagnosis.records import build_record
from saddlering_ros.diagnosis.ring_system import RingSystem
from saddlering_ros.discrepancy import Point
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
    held = replace(dynamic, held_out=True)
    [note] = explained_by_waves(RingSystem(RIG), [static, held], contact, Watch('diagnose'))
    assert note.startswith('waves of the raceways of ')
    assert 'compare the session with an earlier one' in note
    held = replace(held, channels=-held.channels)
    assert explained_by_waves(
        RingSystem(RIG), [static, held], contact, Watch('diagnose')) == []


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


def test_even_raceways_stay_even(even):
    contact, runs = even
    system = RingSystem(RIG)
    assert with_raceways(system, runs, contact, Watch('compare'))[0] is system
    assert explained_by_waves(system, runs, contact, Watch('diagnose')) == []


def test_a_misfit_that_waves_do_not_explain_is_none_of_waves(even):
    contact, runs = even
    system = RingSystem(RIG)
    swapped = [replace(run, channels=-run.channels) for run in runs]
    assert with_raceways(system, swapped, contact, Watch('compare'))[0] is system
