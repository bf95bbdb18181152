"""Rigs of 1 t and 24 rollers a row, and of 400 t and 400 rollers, are judged by their own size."""

from dataclasses import replace
import math
from pathlib import Path

import numpy as np
import pytest

from benchmarks.rigs import sized_rig
from saddlering_ros.diagnosis.records import build_record, check_set
from saddlering_ros.doubts.readings import check_load_unit
from saddlering_ros.errors import BagError
from saddlering_ros.identification import IdentificationError, identify
from saddlering_ros.identification.uncertainty import reason_wide
from saddlering_ros.record import LOAD_TOPIC, PROBE_TOPICS, Record
from saddlering_ros.record.batches import align, seconds_array
from saddlering_ros.record.quality import topic_quality
from saddlering_ros.rig import default_rig, FULL_SCALE_LOAD, TONNE, TRUE_TO_SCALE
from saddlering_ros.virtual_rig.experiment import (
    dynamic_schedule,
    Instruments,
    PhysicalRig,
    record_test,
    static_schedule,
    TestPlan,
)
from saddlering_ros.virtual_rig.integrator import Scatter

RIGS = {'1 t': sized_rig(1.0, 24, 0.15), '400 t': sized_rig(400.0, 400, 2.0)}


def virtual_run(rig, test, elevation=50.0, *, seed=1, contact=TRUE_TO_SCALE, **schedule):
    """A run of the virtual rig, of equal rollers, with instruments that suit its size."""
    scale = rig.full_scale_load / FULL_SCALE_LOAD
    make = static_schedule if test == 'static' else dynamic_schedule
    plan = TestPlan(
        PhysicalRig(rig, contact, math.radians(elevation), (), Scatter(gap=0.0, stiffness=0.0), 1),
        make(rig, **schedule), seed, Instruments(load_noise=50.0 * scale),
        rate=50.0 if test == 'static' else 500.0)
    record = record_test(plan)
    gaps = np.stack([align(record.load_stamps, stamps, values)
                     for stamps, values in zip(record.probe_stamps, record.gaps, strict=True)])
    name = f'{test}_{elevation:g}'
    return Record(
        name=name, path=Path(name), test=test, elevation=math.radians(elevation), rig='other',
        run='', stamps=record.load_stamps,
        time=seconds_array(record.load_stamps, int(record.load_stamps[0])), load=record.load,
        gaps=gaps)


@pytest.fixture(name='runs', scope='module', params=RIGS)
def runs_fixture(request):
    rig = RIGS[request.param]
    return rig, [
        virtual_run(rig, 'static', elevation, hold=2.0, step=rig.full_scale_load / 12.0)
        for elevation in (50.0, 70.0)
    ] + [virtual_run(rig, 'dynamic', 50.0, duration=6.0)]


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
    found = identify([
        virtual_run(rig, 'static', elevation, hold=2.0, step=rig.full_scale_load / 12.0)
        for elevation in (50.0, 70.0)], rig)
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
        with pytest.raises(IdentificationError, match=f'never exceeds {words}'):
            identify([weak], replace(rig, force_unit=unit))


def test_a_load_in_tonnes_or_kilonewtons_is_refused_on_a_rig_of_any_size(runs):
    rig, tests = runs
    load = tests[0].load
    check_load_unit('bag', load, rig.limits)
    for factor, unit in ((1.0 / TONNE, 'tonnes'), (1e-3, 'newtons')):
        with pytest.raises(BagError, match=unit):
            check_load_unit('bag', factor * load, rig.limits)
    with pytest.raises(BagError, match='far beyond'):
        check_load_unit('bag', np.array([0.0, 30.0 * rig.full_scale_load]), rig.limits)


@pytest.fixture(name='usual', scope='module')
def usual_fixture():
    rig = default_rig()
    return [virtual_run(rig, 'static', hold=2.0, step=rig.full_scale_load / 12.0),
            virtual_run(rig, 'dynamic', duration=6.0)]


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
