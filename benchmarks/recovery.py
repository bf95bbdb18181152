"""Prediction at 70 deg from parameters identified at 50 deg, over the whole box and its noise.

Each rig is identified from a static and a dynamic run at 50 deg and predicts a static and a
dynamic run at 70 deg. Target: nrmse within 1.1 times the noise floor when no effect is hidden.
    python benchmarks/recovery.py [--rigs 40] [--quick] [--scatter]
"""

from __future__ import annotations

import argparse

import numpy as np
from rigs import drawn_contact, NO_SCATTER, RIG, virtual_run

from saddlering_ros.identification import IdentificationSettings, identify, validate
from saddlering_ros.virtual_rig import Scatter


def ratios(number: int, scatter: Scatter) -> dict[tuple[str, str], float]:
    random = np.random.default_rng([70, number])
    contact = drawn_contact(random)
    noise = 1e-6 * 10.0 ** random.uniform(-1.0, 0.0)
    runs = [
        virtual_run(test, elevation, contact, seed=1000 * number + place, noise=noise,
                    scatter=scatter)
        for place, (test, elevation) in enumerate(
            [('static', 50.0), ('dynamic', 50.0), ('static', 70.0), ('dynamic', 70.0)])
    ]
    found = identify(runs[:2], RIG, IdentificationSettings(seed=number))
    predicted = validate(runs[2:], RIG, found.parameters)
    return {
        (run.test, channel): figures.nrmse / figures.noise_floor
        for run in predicted.runs
        for channel, figures in run.channels.items() if channel != 'parity'
    }


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument('--rigs', type=int, default=40)
    parser.add_argument('--quick', action='store_true', help='5 rigs')
    parser.add_argument('--scatter', action='store_true', help='rollers differ as made ones do')
    args = parser.parse_args()
    scatter = Scatter() if args.scatter else NO_SCATTER
    table: list[dict[tuple[str, str], float]] = []
    for number in range(5 if args.quick else args.rigs):
        table.append(ratios(number, scatter))
        print(f'rig {number}: largest ratio {max(table[-1].values()):.3f}', flush=True)
    print(f'nrmse over noise floor at 70 deg, {len(table)} rigs')
    print(f'{"run":8s} {"channel":8s} {"median":>8s} {"95 %":>8s} {"worst":>8s} {"<= 1.1":>8s}')
    for key in table[0]:
        own = np.array([row[key] for row in table])
        print(f'{key[0]:8s} {key[1]:8s} {np.median(own):8.3f} {np.quantile(own, 0.95):8.3f} '
              f'{own.max():8.3f} {100.0 * np.mean(own <= 1.1):7.0f}%')


if __name__ == '__main__':
    main()
