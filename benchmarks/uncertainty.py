"""Do stated 95 % intervals hold the truth? Coverage over virtual rigs drawn from the whole box.

Each rig: static and dynamic run at 50 deg, static run at 70 deg, on the virtual rig (roller by
roller, its own integrator), noise 0.1 to 1 um. Target: 90 to 99 % for every parameter. The
rollers are equal, so that the intervals judged are those of noise alone (of the parameter file).
    python benchmarks/uncertainty.py [--rigs 200] [--quick] [--json FILE]
"""

from __future__ import annotations

import argparse
import json
from pathlib import Path
import time

import numpy as np
from rigs import drawn_contact, RIG, virtual_run

from saddlering_ros.estimation.identifiability import WIDTH_95
from saddlering_ros.identification import IdentificationSettings, identify
from saddlering_ros.rig import PARAMETER_NAMES

LOGARITHMIC = np.array([name[0] in 'KD' for name in PARAMETER_NAMES])


def one_rig(number: int) -> dict[str, object]:
    random = np.random.default_rng([2020, number])
    contact = drawn_contact(random)
    noise = 1e-6 * 10.0 ** random.uniform(-1.0, 0.0)
    seeds = random.integers(0, 2**31, 3)
    plan = (('static', 50.0), ('dynamic', 50.0), ('static', 70.0))
    runs = [
        virtual_run(test, elevation, contact, seed=int(seed), noise=noise)
        for (test, elevation), seed in zip(plan, seeds, strict=True)
    ]
    started = time.perf_counter()
    found = identify(runs, RIG, IdentificationSettings(seed=number))
    truth, value = contact.to_array(), found.parameters.contact.to_array()
    off = np.where(LOGARITHMIC, value * np.log(value / truth), value - truth)
    score = off / np.sqrt(np.diag(found.parameters.source.covariance))
    return {
        'rig': number, 'noise': noise, 'score': score.tolist(),
        'determined': [found.determined[name] for name in PARAMETER_NAMES],
        'reduced_chi_square': found.reduced_chi_square, 'seconds': time.perf_counter() - started,
    }


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument('--rigs', type=int, default=200)
    parser.add_argument('--quick', action='store_true', help='10 rigs')
    parser.add_argument('--json', type=Path)
    args = parser.parse_args()
    rigs = []
    for number in range(10 if args.quick else args.rigs):
        rigs.append(one_rig(number))
        if args.json is not None:
            args.json.write_text(json.dumps(rigs))
    report(rigs)


def report(rigs: list[dict[str, object]]) -> None:
    score = np.array([rig['score'] for rig in rigs])
    determined = np.array([rig['determined'] for rig in rigs])
    print(f'{len(rigs)} virtual rigs, {np.mean([rig["seconds"] for rig in rigs]):.2f} s each')
    print(f'{"parameter":10s} {"determined":>8s} {"95 % holds":>11s} {"rms z":>8s}')
    for column, name in enumerate(PARAMETER_NAMES):
        own = score[determined[:, column], column]
        held = 100.0 * np.mean(np.abs(own) <= WIDTH_95)
        print(f'{name:10s} {len(own):8d} {held:10.1f}% {np.sqrt(np.mean(own**2)):8.2f}')


if __name__ == '__main__':
    main()
