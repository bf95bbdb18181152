"""How fast the ring simulator is: beside peers, and how its cost grows.

    python benchmarks/simulator.py [--quick]

Times are CPU seconds of one thread (the least of several runs, so that other programs on the
machine matter little), except where two threads run: those are seconds by the clock.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable
from dataclasses import replace
import os
from pathlib import Path
import sys
import time

import numpy as np
from scipy.integrate import solve_ivp

sys.path.insert(0, str(Path(__file__).resolve().parent.parent / 'test' / 'ring'))

import readable_ring as reference

from saddlering_ros.effects.extension import RingExtension
from saddlering_ros.rig import default_rig, FULL_SCALE_LOAD, Rig, TONNE, TRUE_TO_SCALE
from saddlering_ros.ring import dynamic_batch, probe_batch, static_batch

ELEVATION = float(np.deg2rad(50.0))
PLATEAUS = np.concatenate([np.arange(26), np.arange(24, -1, -1)]) * TONNE
CONTACT = TRUE_TO_SCALE.to_array()
RIG = default_rig()


def least(task: Callable[[], object], runs: int,
          clock: Callable[[], float] = time.thread_time) -> float:
    """Seconds of the fastest of `runs` calls, the first (compiling) not counted."""
    task()
    spent = []
    for _ in range(runs):
        began = clock()
        task()
        spent.append(clock() - began)
    return min(spent)


def dynamic_record(seconds: float = 10.0, rate: float = 1000.0) -> tuple[np.ndarray, np.ndarray]:
    """Ramp 0.5 t to 25 t and back with a noisy load cell: time [s], load [N]."""
    time_s = np.arange(round(seconds * rate) + 1) / rate
    load = np.interp(time_s / seconds, [0.0, 0.1, 0.5, 0.9, 1.0],
                     [RIG.preload, RIG.preload, FULL_SCALE_LOAD, RIG.preload, RIG.preload])
    return time_s, load + np.random.default_rng(0).normal(0.0, 50.0, time_s.size)


def static_task(rig: Rig = RIG, particles: int = 1) -> Callable[[], object]:
    contacts = np.repeat(CONTACT[None], particles, axis=0)
    return lambda: static_batch(rig, contacts, ELEVATION, PLATEAUS)


def dynamic_task(rig: Rig = RIG, particles: int = 1,
                 seconds: float = 10.0) -> Callable[[], object]:
    contacts = np.repeat(CONTACT[None], particles, axis=0)
    time_s, load = dynamic_record(seconds)
    return lambda: dynamic_batch(rig, contacts, ELEVATION, time_s, load)


def probes_task(extension: RingExtension) -> Callable[[], object]:
    time_s, load = dynamic_record()
    return lambda: probe_batch(RIG, [(CONTACT, extension)], ELEVATION, time_s, load)


def row(words: str, seconds: float, than: float | None = None, note: str = '') -> None:
    ratio = '' if than is None else f'{seconds / than:10.3g} x'
    print(f'| {words:<58} | {seconds * 1e3:12.3f} ms | {ratio:>12} | {note} |')


def header(title: str) -> None:
    print(f'\n{title}\n')
    print(f'| {"what":<58} | {"CPU time":>15} | {"to ours":>12} | note |')
    print(f'|{"-" * 60}|{"-" * 16}:|{"-" * 13}:|---|')


def peers(quick: bool) -> None:
    """Ours, the plain reference, and scipy on the vectorised 304-roller model; one law."""
    header('Static run, 51 plateaus')
    static = least(static_task(), 50)
    row('static_batch', static, static)

    def plain_static() -> None:
        q = None
        for load in PLATEAUS:
            q = reference.static_equilibrium(RIG, TRUE_TO_SCALE, load, ELEVATION, start=q)

    row('numpy over 304 rollers, scipy.optimize.root', least(plain_static, 1 if quick else 3),
        static)
    header('Dynamic run, 10 s at 1 kHz')
    dynamic = least(dynamic_task(), 100)
    row('dynamic_batch', dynamic, dynamic)
    seconds = 0.2 if quick else 1.0
    time_s, load = dynamic_record()
    part = time_s <= seconds
    scale = (time_s.size - 1) / (np.count_nonzero(part) - 1)
    spent = least(lambda: reference.simulate_dynamic(RIG, TRUE_TO_SCALE, ELEVATION, time_s[part],
                                                     load[part]), 1)
    row('numpy over 304 rollers, same steps', spent * scale, dynamic,
        f'{seconds:g} s timed, times {scale:.0f}')
    smooth = np.interp(time_s / 10.0, [0.0, 0.1, 0.5, 0.9, 1.0],
                       [RIG.preload, RIG.preload, FULL_SCALE_LOAD, RIG.preload, RIG.preload])
    # Noise has to be stepped through sample by sample; a smooth load may be stepped over.
    for words, force, longest in (('noisy load', load, 1e-3), ('smooth load', smooth, 0.1)):
        spent, calls = scipy_run(time_s, force, seconds, longest)
        row(f'numpy over 304 rollers, solve_ivp BDF, {words}', spent * 10.0 / seconds, dynamic,
            f'{seconds:g} s timed, times {10.0 / seconds:.0f}; {calls} calls')


def scipy_run(time_s: np.ndarray, load: np.ndarray, seconds: float,
              longest: float) -> tuple[float, int]:
    """CPU seconds and calls of solve_ivp over a stretch of the record in which the load rises."""
    start = 2.0
    first = float(np.interp(start, time_s, load))
    q = reference.static_equilibrium(RIG, TRUE_TO_SCALE, first, ELEVATION)
    rate = reference.rate_of_state(RIG, TRUE_TO_SCALE, ELEVATION,
                                   lambda t: float(np.interp(t, time_s, load)))
    began = time.thread_time()
    found = solve_ivp(rate, (start, start + seconds), np.concatenate([q, np.zeros(3)]),
                      method='BDF', t_eval=np.arange(start, start + seconds, 1e-3),
                      max_step=longest, rtol=1e-6, atol=[1e-9] * 3 + [1e-6] * 3)
    assert found.success
    return time.thread_time() - began, int(found.nfev)


def growth(quick: bool) -> None:
    """Cost with samples, rollers, particles and threads."""
    header('Dynamic run: how cost grows (ratio is to the first line)')
    runs = 20 if quick else 60
    base = least(dynamic_task(), runs)
    row('10 s at 1 kHz, 304 rollers, 1 particle', base, base)
    for seconds in (1.0, 100.0):
        row(f'{seconds:g} s at 1 kHz', least(dynamic_task(seconds=seconds), 3), base)
    for factor in (2, 4):
        wide = replace(
            RIG, axial_rows=replace(RIG.axial_rows, rollers=97 * factor),
            radial_row=replace(RIG.radial_row, rollers=110 * factor))
        row(f'10 s at 1 kHz, {304 * factor} rollers', least(dynamic_task(wide), runs), base)
    growing = RingExtension(damping_penetration_share=0.5, damping_penetration_exponent=0.5)
    saturating = replace(growing, damping_penetration_saturation=5e4)
    for words, extension in (('none', RingExtension()), ('that grows', growing),
                             ('that grows and levels off', saturating)):
        row(f'10 s at 1 kHz, damping law: {words}', least(probes_task(extension), runs), base)
    for particles, threads in ((20, 1), (20, 2), (100, 2)):
        os.environ['SADDLERING_THREADS'] = str(threads)
        spent = least(dynamic_task(particles=particles), 3, time.perf_counter)
        row(f'10 s at 1 kHz, {particles} particles, {threads} thread(s), by the clock', spent,
            base)
        spent = least(static_task(particles=particles), 10, time.perf_counter)
        row(f'static run, {particles} particles, {threads} thread(s), by the clock', spent)
    os.environ['SADDLERING_THREADS'] = '1'


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.partition('\n')[0])
    parser.add_argument('--quick', action='store_true', help='shorter stretches of the slow peers')
    args = parser.parse_args()
    os.environ['SADDLERING_THREADS'] = '1'
    peers(args.quick)
    growth(args.quick)
    return 0


if __name__ == '__main__':
    raise SystemExit(main())
