"""Error of the solver after a jump of the load, for dampings from 1e3 to 1e7 N s/m and rigs of
other sizes, compared with steps of 10 us.

    python benchmarks/small_damping.py

The jump is from 20 to 60 % of full scale within one sample of 1 ms. The error is the largest of
the three channels, each as a share of its own motion. Dampings of other rigs are scaled with
their rollers' load. The last columns show the steps taken per sample, after the jump and in a
ramp with the noise of a load cell (0.02 % of full scale).
"""

from __future__ import annotations

from dataclasses import replace
import sys

import numpy as np
from rigs import sized_rig

from saddlering_ros.rig import ContactParameters, default_rig, Rig, TRUE_TO_SCALE
from saddlering_ros.ring import dynamic_batch
from saddlering_ros.ring.sensitivity import steps_taken

DAMPINGS = (1e3, 3e3, 1e4, 3e4, 1e5, 3e5, 1e6, 3e6, 1e7)
RIGS = {'shipped (25 t)': default_rig(), '1 t, 24 rollers': sized_rig(1.0, 24, 0.1),
        '400 t, 400 rollers': sized_rig(400.0, 400, 2.5)}
ELEVATION = float(np.deg2rad(50.0))
SAMPLE, PARTS = 1e-3, 100
MAX_ERROR = 0.01


def contact_of(rig: Rig, damping: float) -> ContactParameters:
    """The contact law true to scale, as stiff for the rig's load per roller, with a damping."""
    usual = default_rig()
    scale = (rig.full_scale_load / rig.axial_rows.rollers
             / (usual.full_scale_load / usual.axial_rows.rollers))
    law = TRUE_TO_SCALE
    return replace(law, K1=law.K1 * scale, K2=law.K2 * scale, D1=damping * scale,
                   D2=damping * scale)


def error_after_jump(rig: Rig, law: ContactParameters) -> tuple[float, float]:
    """Largest error as a share of the motion, and steps per sample."""
    contact = law.to_array()
    time = np.arange(250) * SAMPLE
    load = np.where(time < 0.02, 0.2, 0.6) * rig.full_scale_load
    fine = np.arange((len(time) - 1) * PARTS + 1) * (SAMPLE / PARTS)
    truth = dynamic_batch(rig, contact, ELEVATION, fine, np.interp(fine, time, load),
                          SAMPLE / PARTS)[0][:, ::PARTS]
    found = dynamic_batch(rig, contact, ELEVATION, time, load)[0]
    moved = np.abs(truth - truth[:, :1]).max(axis=1)
    steps = len(steps_taken(rig, contact, ELEVATION, time, load)[0])
    return float((np.abs(found - truth).max(axis=1) / moved).max()), steps / len(time)


def steps_in_noise(rig: Rig, law: ContactParameters) -> float:
    """Steps per sample over a ramp of 2 s with the noise of a load cell."""
    time = np.arange(2000) * SAMPLE
    load = np.linspace(0.02, 1.0, len(time)) + np.random.default_rng(0).normal(0, 2e-4, len(time))
    return len(steps_taken(rig, law.to_array(), ELEVATION, time, load * rig.full_scale_load)[0]
               ) / len(time)


def main() -> int:
    print('| rig | D [N s/m] | largest error | steps per sample | in noise |')
    print('|---|---|---|---|---|')
    worst = 0.0
    for name, rig in RIGS.items():
        for damping in DAMPINGS:
            law = contact_of(rig, damping)
            error, steps = error_after_jump(rig, law)
            worst = max(worst, error)
            print(f'| {name} | {damping:.0e} | {error:.2%} | {steps:.1f} | '
                  f'{steps_in_noise(rig, law):.1f} |', flush=True)
    return int(worst > MAX_ERROR)


if __name__ == '__main__':
    sys.exit(main())
