"""How fast is the ring simulator: beside peers, and how does its cost grow?

    python benchmarks/simulator.py [--stretch 1] [--rounds 20]

Times are processor seconds of one thread. --stretch is the time [s] of a dynamic run that is timed
of the slow peers.
"""

from collections.abc import Callable
from dataclasses import replace
import os
from pathlib import Path
import sys

from frame import arguments, side_by_side, table
import numpy as np
from rigs import RIG
from scipy.integrate import solve_ivp

sys.path.insert(0, str(Path(__file__).resolve().parent.parent / 'test' / 'ring'))

import readable_ring as reference

from saddlering_ros.effects.extension import RingExtension
from saddlering_ros.rig import FULL_SCALE_LOAD, Rig, TONNE, TRUE_TO_SCALE
from saddlering_ros.ring.simulator import dynamic_batch, probe_batch, static_batch

ELEVATION = float(np.deg2rad(50.0))
PLATEAUS = np.concatenate([np.arange(26), np.arange(24, -1, -1)]) * TONNE
SECONDS, RATE = 10.0, 1000.0
CORNERS = ([0.0, 0.1, 0.5, 0.9, 1.0],
           [RIG.preload, RIG.preload, FULL_SCALE_LOAD, RIG.preload, RIG.preload])
Task = Callable[[], object]


def dynamic_record(seconds: float = SECONDS) -> tuple[np.ndarray, np.ndarray]:
    """Ramp 0.5 t to 25 t and back with a noisy load cell: time [s], load [N]."""
    time_s = np.arange(round(seconds * RATE) + 1) / RATE
    load = np.interp(time_s / seconds, *CORNERS)
    return time_s, load + np.random.default_rng(0).normal(0.0, 50.0, time_s.size)


def static_task(particles: int = 1) -> Task:
    contacts = np.repeat(TRUE_TO_SCALE.to_array()[None], particles, axis=0)
    return lambda: static_batch(RIG, contacts, ELEVATION, PLATEAUS)


def dynamic_task(rig: Rig = RIG, particles: int = 1, seconds: float = SECONDS) -> Task:
    contacts = np.repeat(TRUE_TO_SCALE.to_array()[None], particles, axis=0)
    time_s, load = dynamic_record(seconds)
    return lambda: dynamic_batch(rig, contacts, ELEVATION, time_s, load)


def damped_task(extension: RingExtension) -> Task:
    time_s, load = dynamic_record()
    return lambda: probe_batch(RIG, [(TRUE_TO_SCALE.to_array(), extension)], ELEVATION, time_s,
                               load)


def plain_static() -> None:
    """The static run over 304 rollers with a root finder of scipy."""
    q = None
    for load in PLATEAUS:
        q = reference.static_equilibrium(RIG, TRUE_TO_SCALE, load, ELEVATION, start=q)


def plain_dynamic(seconds: float) -> Task:
    """The beginning of the dynamic run over 304 rollers by the same steps."""
    time_s, load = dynamic_record()
    part = time_s <= seconds
    return lambda: reference.simulate_dynamic(RIG, TRUE_TO_SCALE, ELEVATION, time_s[part],
                                              load[part])


def by_scipy(seconds: float, *, noisy: bool) -> Task:
    """A stretch with rising load by solve_ivp: noise is stepped through sample by sample."""
    time_s, load = dynamic_record()
    force = load if noisy else np.interp(time_s / SECONDS, *CORNERS)
    start, longest = 2.0, 1e-3 if noisy else 0.1

    def task() -> None:
        first = float(np.interp(start, time_s, force))
        q = reference.static_equilibrium(RIG, TRUE_TO_SCALE, first, ELEVATION)
        rate = reference.rate_of_state(RIG, TRUE_TO_SCALE, ELEVATION,
                                       lambda t: float(np.interp(t, time_s, force)))
        found = solve_ivp(rate, (start, start + seconds), np.concatenate([q, np.zeros(3)]),
                          method='BDF', t_eval=np.arange(start, start + seconds, 1e-3),
                          max_step=longest, rtol=1e-6, atol=[1e-9] * 3 + [1e-6] * 3)
        assert found.success
    return task


def show(title: str, spent: dict[str, float]) -> None:
    """Print times beside that of the first task."""
    first = next(iter(spent.values()))
    table(title, ('task', 'time [ms]', 'ratio'),
          [(name, 1e3 * seconds, seconds / first) for name, seconds in spent.items()])


def main() -> None:
    args = arguments(__doc__, {'stretch': 0.2, 'rounds': 5}, stretch=1.0, rounds=20)
    os.environ['SADDLERING_THREADS'] = '1'
    show('Static run, 51 plateaus', side_by_side(
        {'ours': static_task(), 'numpy over 304 rollers, scipy.optimize.root': plain_static},
        args.rounds))
    slow = side_by_side({
        'ours': dynamic_task(),
        'numpy over 304 rollers, same steps': plain_dynamic(args.stretch),
        'solve_ivp BDF, noisy load': by_scipy(args.stretch, noisy=True),
        'solve_ivp BDF, smooth load': by_scipy(args.stretch, noisy=False)}, args.rounds)
    show(f'Dynamic run, 10 s at 1 kHz; of the peers {args.stretch:g} s, scaled', {
        name: seconds if name == 'ours' else seconds * SECONDS / args.stretch
        for name, seconds in slow.items()})
    growing = RingExtension(damping_penetration_share=0.5, damping_penetration_exponent=0.5)
    wide = replace(RIG, axial_rows=replace(RIG.axial_rows, rollers=194),
                   radial_row=replace(RIG.radial_row, rollers=220))
    show('How the cost of the dynamic run grows', side_by_side({
        '10 s, 304 rollers, one particle': dynamic_task(),
        '100 s': dynamic_task(seconds=100.0), '608 rollers': dynamic_task(wide),
        'a damping law that grows': damped_task(growing),
        '20 particles': dynamic_task(particles=20)}, args.rounds))


if __name__ == '__main__':
    main()
