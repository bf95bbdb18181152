"""Rigs of other sizes, and tests of the virtual rig on them as runs in memory."""

import math
from pathlib import Path

import numpy as np

from saddlering_ros.record import align, Record, seconds_array
from saddlering_ros.rig import FULL_SCALE_LOAD, TRUE_TO_SCALE
from saddlering_ros.virtual_rig.integrator import Scatter
from saddlering_ros.virtual_rig.physics import PhysicalRig
from saddlering_ros.virtual_rig.recording import Instruments, record_test, TestPlan
from saddlering_ros.virtual_rig.schedule import dynamic_schedule, static_schedule


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
