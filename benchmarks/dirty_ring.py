"""A dirty ring: many small errors at once, drawn, on the ring of independent_ring.py.

    python benchmarks/dirty_ring.py [--seeds 1 2 ...] [--effects NAME NAME none] [--without]
                                    [--waves 0] [--out FILE.jsonl]

Of a sound real ring nothing is exact: load cell, elevation, trunnion, probes, friction, raceways,
structure and temperature each have a small error. One cause of the catalogue is hidden beside
them, about ten times as large as an error of its kind. A row states the share that it has of the
power of what all move, because the errors together can move as much. Each effect has one ring, of
the seeds in turn; --without takes it out of the catalogue. The rows are those of real_faults.py.
The truth of a row is what has most of this power: the hidden cause, or a small error of the ring.
--waves: rms [um] of the waves of each raceway beside the small errors, of 1 to 16 maxima whose
amplitudes fall as 1/m; they are no part of this power.
"""

import os

os.environ.setdefault('SADDLERING_THREADS', '1')

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from itertools import cycle
import math
from pathlib import Path
import tempfile
import time as clock

from blind import without
from frame import arguments, keep
from independent import draw_ring, RIG, verdict_on
from independent_faults import fault_of, Hidden, slider_state
import independent_ring
from independent_ring import Array, Fault, Motion, Ring, simulate, Sliders, usual_courses
import numpy as np
from real_faults import answer_of, misfit, say, table

from saddlering_ros.discrepancy import Diagnosis
from saddlering_ros.quantities import WIDTH_95

FULL = RIG.full_scale_load
MAIN = ('load_offset', 'load_nonlinearity', 'cylinder_friction', 'elevation_error', 'bracket_play',
        'moment_arm', 'radial_friction', 'tilt_friction', 'tilt_compliance', 'axial_compliance',
        'ring_ovalisation', 'unequal_rows', 'film_creep', 'probe_gain', 'probe_nonlinearity')
"""Causes that are hidden."""

COARSE = tuple(
    replace(course, rate=5.0 if course.test == 'static' else 100.0)
    for course in usual_courses(RIG) if course.name in ('static_50', 'dynamic_50', 'static_70'))
"""Tests by which sizes are compared."""

VIEWS = np.array([[0.5, 0.0, -0.5, 0.0], [0.0, 0.5, 0.0, 0.5], [0.0, 0.5, 0.0, -0.5],
                  [0.5, 0.0, 0.5, 0.0]])
"""delta_x, delta_y, tilt and parity from the increments of the probes."""

STEPS = {'K1': 1.02, 'n1': 1.005, 'D1': 1.1, 'K2': 1.02, 'n2': 1.005, 'D2': 1.1}
"""Factors of the contact law that show what it can imitate."""

OWN = {'gain': 'load_gain', 'bend': 'load_nonlinearity', 'offset': 'load_offset',
       'cylinder': 'cylinder_friction', 'angle': 'elevation_error', 'arm': 'moment_arm',
       'radial': 'radial_friction', 'tilt': 'tilt_friction', 'gains': 'probe_gain',
       'bends': 'probe_nonlinearity', 'heights': 'probe_height', 'warms': 'probe_drift'}
"""Effects of the catalogue that are small errors of the ring."""

ADDED = {'load_offset': -1.0, 'load_nonlinearity': 1.0, 'cylinder_friction': 1.0,
         'elevation_error': 1.0, 'moment_arm': 1.0, 'probe_gain': 1.0, 'probe_nonlinearity': 1.0}
"""Effects of which a ring has an error beside the hidden one, with its sign: an offset of its own
adds to the load, and a hidden one is taken from it."""

Errors = Mapping[str, Array]


def errors_of(seed: int) -> tuple[Errors, Errors]:
    """Every small error of the ring of a seed, and the phases of those that have some."""
    draw = np.random.default_rng([seed, 13])
    normal = draw.standard_normal
    errors = {
        'gain': 3e-3 * normal(1), 'bend': 1e-3 * normal(1), 'offset': 150.0 * normal(1),
        'cylinder': 300.0 * abs(normal(1)), 'angle': math.radians(0.03) * normal(1),
        'arm': 2e-3 * normal(1), 'radial': 350.0 * abs(normal(1)), 'tilt': 300.0 * abs(normal(1)),
        'gains': 2e-3 * normal(4), 'bends': 8.0 * normal(4), 'heights': 2e-3 * normal(2),
        'warms': 3e-9 * normal(4), 'curves': 0.15e-6 * normal(4)}
    phases = {'curves': draw.uniform(0.5, 1.5, 4)}
    # Waviness of orders 2 to 8 with 0.5 um each: amplitudes and phases of both raceways.
    for raceway in ('axial', 'middle'):
        errors[raceway] = 0.5e-6 * normal(7)
        phases[raceway] = draw.uniform(0.0, 2.0 * np.pi, 7)
    return errors, phases


def dirty(fault: Fault, errors: Errors, phases: Errors) -> Fault:
    """`fault` with small errors of a real ring beside it."""
    def load(time: Array, measured: Array) -> Array:
        at = measured if fault.ring_load is None else fault.ring_load(time, measured)
        return at * (1.0 + errors['gain']) + errors['offset'] + errors['bend'] * FULL * np.sin(
            np.pi * measured / FULL) - errors['cylinder'] * slider_state(measured, 500.0)

    def turn(time: Array, at: Array) -> Array:
        hidden = np.zeros(at.size) if fault.turn is None else fault.turn(time, at)
        return np.asarray(hidden + errors['angle'])

    def readings(motion: Motion) -> Array:
        d = motion.d
        added = d * errors['gains'] + errors['bends'] * d**2
        added += np.outer(motion.time - motion.time[0], errors['warms'])
        added += errors['curves'] * np.sin(
            np.pi * phases['curves'] * motion.load[:, None] / FULL)
        added[:, 0] += errors['heights'][0] * motion.motion[:, 2]
        added[:, 2] -= errors['heights'][1] * motion.motion[:, 2]
        return np.asarray(added)

    def gap(raceway: str, more: object) -> object:
        return lambda phi: errors[raceway] @ np.cos(
            np.arange(2, 9)[:, None] * phi + phases[raceway][:, None]) + (
            more(phi) if callable(more) else 0.0)

    def beside(hidden: Sliders, force: Array) -> Sliders:
        return hidden if hidden.total > 0.0 else Sliders(float(force[0]), 2e-6)

    return replace(
        fault, ring_load=load, turn=turn, arm=fault.arm + float(errors['arm'][0]),
        gap_axial=gap('axial', fault.gap_axial), gap_radial=gap('middle', fault.gap_radial),
        friction_x=beside(fault.friction_x, errors['radial']),
        friction_tilt=beside(fault.friction_tilt, errors['tilt']),
        readings=(*fault.readings, readings))


def dirty_fault(hidden: Hidden, seed: int, waves: float = 0.0) -> Fault:
    """What is hidden, with the dirt of the ring of a seed; waves: rms [um] on each raceway."""
    fault = dirty(hidden.fault, *errors_of(seed))
    return wavy(fault, seed, waves) if waves else fault


def wavy(fault: Fault, seed: int, rms: float) -> Fault:
    """The same ring with waves of this rms [um] on each of its raceways."""
    draw = np.random.default_rng([seed, 27])
    maxima = np.arange(1, 17)

    def gap(more: Callable[[Array], Array] | None) -> Callable[[Array], Array]:
        sizes, phases = draw.standard_normal(16) / maxima, draw.uniform(0.0, 2.0 * np.pi, 16)
        sizes *= 1e-6 * rms / np.sqrt(0.5 * sizes @ sizes)
        return lambda phi: sizes @ np.cos(maxima[:, None] * phi + phases[:, None]) + (
            0.0 if more is None else more(phi))

    return replace(fault, gap_axial=gap(fault.gap_axial), gap_lower=gap(fault.gap_lower),
                   gap_radial=gap(fault.gap_radial))


NOTHING = Hidden('', {}, Fault())


def hidden_in(effect: str, seed: int, share: float = 1.0) -> Hidden:
    """The cause that the ring of a seed hides, at a share of its size; '' for none."""
    if not effect:
        return NOTHING
    return fault_of(effect, np.random.default_rng([seed, 12]), share)


def size_of(effect: str, seed: int, found: Diagnosis) -> list[float] | None:
    """Published size, its deviation and the true one; None without an established size."""
    cause = next((one for one in found.causes if one.effect == effect), None)
    if cause is None or found.verdict == 'unknown':
        return None
    parameters = hidden_in(effect, seed).parameters
    name = next(iter(parameters))
    truth, size = parameters[name], cause.parameters[name]
    if effect in ADDED:
        errors = errors_of(seed)[0][next(kind for kind, own in OWN.items() if own == effect)]
        place = int(parameters.get('probe', 1)) - 1
        truth += ADDED[effect] * float(errors[place])
    return [size.value, size.std, truth]


def held(rows: Sequence[Mapping[str, object]]) -> str:
    """How many 95 % intervals of published sizes hold the true ones."""
    sizes = np.array([row['size'] for row in rows if row['size']]).reshape(-1, 3)
    apart = (sizes[:, 0] - sizes[:, 2]) / sizes[:, 1]
    inside = int((np.abs(apart) < WIDTH_95).sum())
    rms = f', an rms of {np.sqrt(np.mean(apart**2)):.1f} deviations' if apart.size else ''
    return f'intervals of sizes hold {inside} of {apart.size}{rms}'


def motion_of(ring: Ring, fault: Fault) -> list[Array]:
    """Views (4, n) of each test, without noise and about their means: a probe's level is free."""
    views = []
    for course in COARSE:
        motion = simulate(ring, fault, course.degrees, *course.samples(), RIG)
        view = VIEWS @ independent_ring.increments(motion, fault).T
        views.append(view - view.mean(axis=1, keepdims=True))
    return views


def powers_of(effect: str, seed: int) -> tuple[float, dict[str, float]]:
    """Power of what all small errors of a ring move, and of what each effect does beside the rest.

    What the contact law can imitate does not count. A view counts in units of its range. The
    effects are the hidden one and, if it has less than half of the power, the errors of the ring.
    """
    ring, hidden, (errors, phases) = draw_ring(seed)[0], hidden_in(effect, seed), errors_of(seed)
    sound, dirt, whole = (motion_of(ring, fault) for fault in (
        Fault(), dirty(Fault(), errors, phases), dirty(hidden.fault, errors, phases)))
    spans = np.max([np.ptp(run, axis=1) for run in sound], axis=0)
    spans[3] = spans[0]  # The parity of a sound ring is zero.

    def change(before: list[Array], after: list[Array]) -> Array:
        return np.concatenate([
            (one - other) / (spans * math.sqrt(one.shape[1]))[:, None]
            for one, other in zip(after, before, strict=True)], axis=None)

    imitated = np.linalg.qr(np.column_stack([
        change(sound, motion_of(
            replace(ring, **{name: factor * getattr(ring, name)}), Fault()))
        for name, factor in STEPS.items()]))[0]

    def power(before: list[Array], after: list[Array]) -> float:
        moved = change(before, after)
        return float(moved @ moved - np.sum((imitated.T @ moved) ** 2))

    small, parts = power(sound, dirt), {effect: power(dirt, whole)}
    if effect and parts[effect] < small:
        for kind, own in OWN.items():
            less = dirty(hidden.fault, {**errors, kind: 0.0 * errors[kind]}, phases)
            parts[own] = max(parts.get(own, 0.0), power(motion_of(ring, less), whole))
    return small, parts


def row_of(
    effect: str, seed: int, folder: Path, waves: float, *, is_removed: bool,
) -> dict[str, object]:
    """The verdict on one dirty ring with one cause, or none, as real_faults.py tables it."""
    began = clock.process_time()
    ring, noise = draw_ring(seed)
    hidden = hidden_in(effect, seed)
    whole = dirty_fault(hidden, seed, waves)
    with without(*[effect] * is_removed):
        found = verdict_on(ring, noise, whole, usual_courses(RIG), seed, folder).diagnosis
    kind = 'removed' if is_removed else 'hidden'
    small, parts = powers_of(effect, seed)
    return {
        'machine': 'dirty ring', 'seed': seed, 'trial': effect or 'none', 'exact': False,
        'kind': kind if effect else 'sound', 'misfit': misfit(found),
        'truth': [max(parts, key=lambda name: parts[name])] if effect else [],
        'seconds': clock.process_time() - began, **answer_of(found),
        'waves': waves,
        'share': parts[effect] / (parts[effect] + small), 'size': size_of(effect, seed, found),
    }


def main() -> None:
    args = arguments(__doc__, {'effects': ['none']}, seeds=(1,), effects=(*MAIN, 'none'),
                     without=False, waves=0.0, out=Path)
    rows = []
    with tempfile.TemporaryDirectory() as folder:
        for name, seed in zip(args.effects, cycle(args.seeds), strict=False):
            hidden = '' if name == 'none' else name
            rows.append(row_of(
                hidden, seed, Path(folder), args.waves, is_removed=args.without))
            say(rows[-1])
            if args.out:
                keep(args.out, rows[-1])
    table(rows)
    print(held(rows))


if __name__ == '__main__':
    main()
