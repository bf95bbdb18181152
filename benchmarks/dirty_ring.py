"""A dirty ring: many small errors at once, drawn, on the ring of independent_ring.py.

    python benchmarks/dirty_ring.py [--seeds 1 2 ...] [--effects NAME NAME none] [--without]
                                    [--out FILE.jsonl]

Of a sound real ring nothing is exact: load cell, elevation, trunnion, probes, friction, raceways,
structure and temperature each have a small error. One cause of the catalogue, about ten times as
large, is hidden beside them. Each effect has one ring, of the seeds in turn; --without takes it
out of the catalogue. The rows are those of real_faults.py.
"""

from __future__ import annotations

import os

os.environ.setdefault('SADDLERING_THREADS', '1')

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
from independent_ring import Array, Fault, Motion, Sliders, usual_courses
import numpy as np
from real_faults import answer_of, misfit, say, table

FULL = RIG.full_scale_load
MAIN = ('load_offset', 'load_nonlinearity', 'cylinder_friction', 'elevation_error', 'bracket_play',
        'moment_arm', 'radial_friction', 'tilt_friction', 'tilt_compliance', 'axial_compliance',
        'ring_ovalisation', 'unequal_rows', 'film_creep', 'probe_gain', 'probe_nonlinearity')
"""Causes that are hidden."""


def dirty(fault: Fault, draw: np.random.Generator) -> Fault:
    """`fault` and every small error of a real ring beside it."""
    gain, bend = 3e-3 * draw.standard_normal(), 1e-3 * draw.standard_normal()
    offset, cylinder = 150.0 * draw.standard_normal(), 300.0 * abs(draw.standard_normal())
    angle, arm = math.radians(0.03) * draw.standard_normal(), 2e-3 * draw.standard_normal()
    radial, tilt = 350.0 * abs(draw.standard_normal()), 300.0 * abs(draw.standard_normal())
    gains, bends = 2e-3 * draw.standard_normal(4), 8.0 * draw.standard_normal(4)
    heights, warms = 2e-3 * draw.standard_normal(2), 3e-9 * draw.standard_normal(4)
    curves, phases = 0.15e-6 * draw.standard_normal(4), draw.uniform(0.5, 1.5, 4)
    # Waviness of orders 2 to 8 with 0.5 um each: amplitudes and phases of both raceways.
    axial, middle = ((0.5e-6 * draw.standard_normal(7), draw.uniform(0.0, 2.0 * np.pi, 7))
                     for _ in range(2))

    def load(time: Array, measured: Array) -> Array:
        at = measured if fault.ring_load is None else fault.ring_load(time, measured)
        return at * (1.0 + gain) + offset + bend * FULL * np.sin(np.pi * measured / FULL) - (
            cylinder * slider_state(measured, 500.0))

    def turn(time: Array, at: Array) -> Array:
        own = np.zeros(at.size) if fault.turn is None else fault.turn(time, at)
        return np.asarray(own + angle)

    def readings(motion: Motion) -> Array:
        d = motion.d
        added = d * gains + bends * d**2 + np.outer(motion.time - motion.time[0], warms)
        added += curves * np.sin(np.pi * phases * motion.load[:, None] / FULL)
        added[:, 0] += heights[0] * motion.motion[:, 2]
        added[:, 2] -= heights[1] * motion.motion[:, 2]
        return np.asarray(added)

    def gap(own: tuple[Array, Array], more: object) -> object:
        return lambda phi: own[0] @ np.cos(np.arange(2, 9)[:, None] * phi + own[1][:, None]) + (
            more(phi) if callable(more) else 0.0)

    def beside(own: Sliders, force: float) -> Sliders:
        return own if own.total > 0.0 else Sliders(force, 2e-6)

    return replace(
        fault, ring_load=load, turn=turn, arm=fault.arm + arm,
        gap_axial=gap(axial, fault.gap_axial), gap_radial=gap(middle, fault.gap_radial),
        friction_x=beside(fault.friction_x, radial),
        friction_tilt=beside(fault.friction_tilt, tilt),
        readings=(*fault.readings, readings))


def hidden_in(effect: str, seed: int, share: float = 1.0) -> Hidden:
    """The cause that the ring of a seed hides, at a share of its size; '' for none."""
    if not effect:
        return Hidden('', {}, Fault())
    return fault_of(effect, np.random.default_rng([seed, 12]), share)


def dirty_fault(hidden: Hidden, seed: int) -> Fault:
    """What is hidden, with the dirt of the ring of a seed."""
    return dirty(hidden.fault, np.random.default_rng([seed, 13]))


def row_of(effect: str, seed: int, folder: Path, *, is_removed: bool) -> dict[str, object]:
    """The verdict on one dirty ring with one cause, or none, as real_faults.py tables it."""
    began = clock.process_time()
    ring, noise = draw_ring(seed)
    whole = dirty_fault(hidden_in(effect, seed), seed)
    with without(*[effect] * is_removed):
        found = verdict_on(ring, noise, whole, usual_courses(RIG), seed, folder).diagnosis
    kind = 'removed' if is_removed else 'hidden'
    return {
        'machine': 'dirty ring', 'seed': seed, 'trial': effect or 'none', 'exact': False,
        'kind': kind if effect else 'sound', 'truth': [effect] if effect else [],
        'misfit': misfit(found), 'seconds': clock.process_time() - began, **answer_of(found),
    }


def main() -> None:
    args = arguments(__doc__, {'effects': ['none']}, seeds=(1,), effects=(*MAIN, 'none'),
                     without=False, out=Path)
    rows = []
    with tempfile.TemporaryDirectory() as folder:
        for name, seed in zip(args.effects, cycle(args.seeds), strict=False):
            hidden = '' if name == 'none' else name
            rows.append(row_of(hidden, seed, Path(folder), is_removed=args.without))
            say(rows[-1])
            if args.out:
                keep(args.out, rows[-1])
    table(rows)


if __name__ == '__main__':
    main()
