"""Rigs of 1 t and 24 rollers a row, and of 400 t and 400 rollers, are judged by their own size."""

from dataclasses import replace

import numpy as np
import pytest

from benchmarks.rigs import sized_rig, virtual_run
from saddlering_ros.diagnosis.records import build_record, check_set
from saddlering_ros.doubts.units import check_load_unit
from saddlering_ros.errors import BagError
from saddlering_ros.identification.methods import identify
from saddlering_ros.identification.settings import IdentificationError
from saddlering_ros.identification.uncertainty import reason_wide
from saddlering_ros.record.quality import topic_quality
from saddlering_ros.record.topics import LOAD_TOPIC, PROBE_TOPICS
from saddlering_ros.rig import default_rig, TONNE, TRUE_TO_SCALE

RIGS = {'1 t': sized_rig(1.0, 24, 0.15), '400 t': sized_rig(400.0, 400, 2.0)}


def static_run(rig, elevation=50.0):
    return virtual_run('static', elevation, TRUE_TO_SCALE, seed=1, rig=rig, hold=2.0,
                       step=rig.full_scale_load / 12.0)


def dynamic_run(rig):
    return virtual_run('dynamic', 50.0, TRUE_TO_SCALE, seed=1, rig=rig, rate=500.0, duration=6.0)


@pytest.fixture(name='runs', scope='module', params=RIGS)
def runs_fixture(request):
    rig = RIGS[request.param]
    return rig, [static_run(rig), static_run(rig, 70.0), dynamic_run(rig)]


def test_the_stiffnesses_of_a_rig_of_any_size_are_identified(runs):
    """Judged by noise alone: these rollers are equal, and 1.5 um is much to a ring of 1 t."""
    rig, tests = runs
    found = identify(tests, rig)
    truth = TRUE_TO_SCALE.to_array()
    got = found.parameters.contact.to_array()
    std = np.sqrt(np.diag(found.parameters.source.covariance))
    for index, name in enumerate(('K1', 'n1', 'D1', 'K2', 'n2', 'D2')):
        if name in ('K1', 'K2', 'D1'):
            assert reason_wide(name, std[index] / got[index], 2) is None
        assert abs(got[index] - truth[index]) < 4.0 * std[index], name


def test_unequal_rollers_leave_a_small_ring_open_and_the_reason_says_so():
    rig = RIGS['1 t']
    found = identify([static_run(rig), static_run(rig, 70.0)], rig)
    assert not found.determined['K1']
    assert 'rollers' in found.reasons['K1']


def test_a_sound_run_of_a_rig_of_any_size_gets_no_note_about_its_peak(runs):
    rig, tests = runs
    records = [build_record(rig, run, held_out=False) for run in tests]
    assert not [note for note in check_set(records, rig) if 'full scale' in note]


def test_loads_are_printed_in_the_unit_of_the_rig_file(runs):
    rig, tests = runs
    weak = replace(tests[0], load=0.1 * tests[0].load)
    share = 0.2 * rig.full_scale_load
    for unit, words in (('t', f'{share / TONNE:.1f}0? t'), ('kN', f'{share / 1e3:.1f} kN')):
        with pytest.raises(IdentificationError, match=f'no load exceeds {words}'):
            identify([weak], replace(rig, force_unit=unit))


def test_a_load_in_tonnes_or_kilonewtons_is_refused_on_a_rig_of_any_size(runs):
    rig, tests = runs
    load = tests[0].load
    check_load_unit('bag', load, rig.limits)
    for factor, said in ((1.0 / TONNE, 'tonnes'), (1e-3, 'newtons'), (0.0, '0 N throughout')):
        with pytest.raises(BagError, match=said):
            check_load_unit('bag', factor * load, rig.limits)
    with pytest.raises(BagError, match='far beyond'):
        check_load_unit('bag', np.array([0.0, 30.0 * rig.full_scale_load]), rig.limits)


@pytest.fixture(name='usual', scope='module')
def usual_fixture():
    rig = default_rig()
    return [static_run(rig), dynamic_run(rig)]


def rounded(run, step):
    gaps = step * np.rint(run.gaps / step)
    quality = {name: topic_quality(run.stamps[known], row[known])
               for name, row in zip(PROBE_TOPICS, gaps, strict=True)
               for known in [np.isfinite(row)]}
    quality[LOAD_TOPIC] = topic_quality(run.stamps, run.load)
    return replace(run, gaps=gaps, quality=quality)


@pytest.mark.parametrize('step', [0.5e-6, 5e-6])
def test_the_truth_lies_in_the_intervals_at_a_resolution_of(step, usual):
    found = identify([rounded(run, step) for run in usual], default_rig())
    error = found.parameters.contact.to_array() - TRUE_TO_SCALE.to_array()
    determined = np.array(list(found.determined.values()))
    assert found.determined['D1']
    assert (np.abs(error) < 3.0 * found.std)[determined].all()
    assert np.isfinite(found.parameters.contact.to_array()).all()
