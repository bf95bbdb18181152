"""Runs of the virtual rig with ideal instruments, so that an effect stands alone."""

import functools
import math

import numpy as np
import pytest

from saddlering_ros.rig import default_rig, TONNE, TRUE_TO_SCALE
from saddlering_ros.virtual_rig import experiment
from saddlering_ros.virtual_rig.effects import request
from saddlering_ros.virtual_rig.experiment import Instruments, PhysicalRig, record_test, TestPlan
from saddlering_ros.virtual_rig.integrator import Scatter

IDEAL = Instruments(noise=0.0, load_noise=0.0, jitter=0.0, gap_scatter=0.0, quantised=False)
EQUAL = Scatter(gap=0.0, stiffness=0.0)


@functools.cache
def ideal_record(effect=None, form=None, test='dynamic', elevation=60.0):
    """A short record without noise: 5 t steps held for a second, or a ramp within 3 s."""
    effects = (request(effect, None, form),) if effect else ()
    rig = default_rig()
    physical = PhysicalRig(rig, TRUE_TO_SCALE, math.radians(elevation), effects, EQUAL)
    if test == 'static':
        schedule = experiment.static_schedule(rig, hold=1.0, step=5.0 * TONNE)
    else:
        schedule = experiment.dynamic_schedule(rig, duration=3.0)
    return record_test(TestPlan(physical, schedule, seed=5, instruments=IDEAL, rate=100.0,
                                probe_rate=500.0, step=4e-3))


def channels(record, reference):
    """Displacement channels of a record at the reference's load stamps, zeroed at the start."""
    begin = reference.load_stamps[0]
    where = (reference.load_stamps - begin) * 1e-9
    probes = []
    for stamps, gaps in zip(record.probe_stamps, record.gaps, strict=True):
        gap = np.interp(where, (stamps - begin) * 1e-9, gaps)
        probes.append(gap - gap[:20].mean())
    first, second, third, fourth = probes
    return {'delta_x': (first - third) / 2.0, 'delta_y': (second + fourth) / 2.0,
            'gamma': (second - fourth) / 1.3, 'parity': (first + third) / 2.0}


@pytest.fixture(name='ideal_record')
def ideal_record_fixture():
    return ideal_record


@pytest.fixture(name='channels')
def channels_fixture():
    return channels
