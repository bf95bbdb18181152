"""Is there a note on a sound record of any rig? There should be none.

    python benchmarks/sound_bags.py [--count 200] [--first 0]

Each seed draws a rig (1 to 400 t, 24 to 400 rollers), a contact law, an elevation, a kind of test,
sampling rates of load and probes, noise of both, and how unequal the rollers are. The record is
read as a bag's is, and every note on it is printed.
"""

from dataclasses import replace
import math

from frame import arguments
import numpy as np
from rigs import as_read, sized_rig

from saddlering_ros.doubts.on_rig import findings_on_rig
from saddlering_ros.doubts.readings import run_of_record
from saddlering_ros.record.record import TestMetadata
from saddlering_ros.rig import FULL_SCALE_LOAD, Rig, TONNE, TRUE_TO_SCALE
from saddlering_ros.virtual_rig import experiment
from saddlering_ros.virtual_rig.integrator import Scatter


def drawn(seed: int) -> tuple[Rig, TestMetadata, experiment.TestPlan]:
    """The test of a seed, and how it is recorded."""
    random = np.random.default_rng([2026, seed])
    tonnes = float(np.exp(random.uniform(0.0, math.log(400.0))))
    rollers = int(np.exp(random.uniform(math.log(24.0), math.log(400.0))))
    rig = sized_rig(tonnes, rollers, float(random.uniform(0.3, 1.5)))
    share = rig.full_scale_load / FULL_SCALE_LOAD * 97.0 / rollers
    k, d = np.exp(random.uniform(math.log(0.7), math.log(1.5), 2))
    usual = TRUE_TO_SCALE
    contact = replace(usual, K1=usual.K1 * share * k, K2=usual.K2 * share * k,
                      D1=usual.D1 * share * d, D2=usual.D2 * share * d)
    static = random.random() < 0.4
    rate = float(random.choice([20.0, 50.0, 100.0] if static else [100.0, 200.0, 500.0, 1e3]))
    probe_rate = rate * float(random.choice([1.0, 1.0, 2.0]))
    degrees = float(random.choice([0.0, 10.0, 30.0, 45.0, 50.0, 70.0]))
    instruments = experiment.Instruments(
        noise=float(np.exp(random.uniform(math.log(0.08e-6), math.log(1e-6)))),
        load_noise=float(np.exp(random.uniform(-9.7, -7.1))) * rig.full_scale_load)
    scatter = Scatter(gap=float(random.uniform(0.0, 1e-6)),
                      stiffness=float(random.uniform(0.0, 0.03)))
    speed = float(random.uniform(1.0, 4.0))
    schedule = (experiment.static_schedule(rig, hold=2.0, step=rig.full_scale_load / 6.0)
                if static else experiment.dynamic_schedule(rig, duration=6.0, speed=speed))
    physical = experiment.PhysicalRig(rig, contact, math.radians(degrees), (), scatter, seed)
    return rig, TestMetadata('static' if static else 'dynamic', degrees), experiment.TestPlan(
        physical, schedule, seed, instruments, rate, probe_rate)


def main() -> None:
    args = arguments(__doc__, {'count': 40}, count=200, first=0)
    noted = 0
    for seed in range(args.first, args.first + args.count):
        rig, facts, plan = drawn(seed)
        record = as_read(experiment.record_test(plan), rig.probes, facts, f'seed_{seed}')
        run = run_of_record(record, facts, rig)
        notes = [*run.notes, *findings_on_rig(rig, run, record)]
        noted += bool(notes)
        for note in notes:
            print(f'{seed}: {facts.test} at {facts.elevation_deg:.0f} deg, '
                  f'{rig.axial_rows.rollers} rollers, {rig.full_scale_load / TONNE:.3g} t, load '
                  f'{plan.rate:.4g} Hz, probes {plan.probe_rate:.4g} Hz, '
                  f'{plan.instruments.noise * 1e6:.2g} um: {note}', flush=True)
    print(f'{noted} of {args.count} sound records with a note')


if __name__ == '__main__':
    main()
