"""Prediction at 70 deg from parameters identified at 50 deg, over the whole box and its noise.

Each rig is identified from a static and a dynamic run at 50 deg and predicts a static and a
dynamic run at 70 deg. Target: nrmse within 1.1 times the noise floor when no effect is hidden.
What the true parameters of the rig reach stands beside it: no identification can do better.
    python benchmarks/recovery.py [--rigs 40] [--quick] [--scatter]
"""

from __future__ import annotations

import argparse

import numpy as np
from rigs import drawn_contact, NO_SCATTER, RIG, virtual_run

from saddlering_ros.identification import IdentificationSettings, identify, validate
from saddlering_ros.rig import ParameterSet
from saddlering_ros.virtual_rig import Scatter


def ratios(number: int, scatter: Scatter) -> dict[tuple[str, str], tuple[float, float]]:
    """Nrmse over noise floor of each run and channel, as identified and with the truth."""
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
    best = validate(runs[2:], RIG, ParameterSet(contact))
    return {
        (run.test, channel): (figures.nrmse / figures.noise_floor,
                              true.channels[channel].nrmse / true.channels[channel].noise_floor)
        for run, true in zip(predicted.runs, best.runs, strict=True)
        for channel, figures in run.channels.items() if channel != 'parity'
    }


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument('--rigs', type=int, default=40)
    parser.add_argument('--quick', action='store_true', help='5 rigs')
    parser.add_argument('--scatter', action='store_true', help='rollers differ as made ones do')
    args = parser.parse_args()
    scatter = Scatter() if args.scatter else NO_SCATTER
    table: list[dict[tuple[str, str], tuple[float, float]]] = []
    for number in range(5 if args.quick else args.rigs):
        table.append(ratios(number, scatter))
        largest, true = max(table[-1].values())
        print(f'rig {number}: largest ratio {largest:.3f}, there with the truth {true:.3f}',
              flush=True)
    print(f'nrmse over noise floor at 70 deg, {len(table)} rigs')
    print(f'{"run":8s} {"channel":8s} {"median":>8s} {"95 %":>8s} {"worst":>8s} {"<= 1.1":>8s} '
          f'{"truth, worst":>13s}')
    for key in table[0]:
        own, true = np.array([row[key] for row in table]).T
        print(f'{key[0]:8s} {key[1]:8s} {np.median(own):8.3f} {np.quantile(own, 0.95):8.3f} '
              f'{own.max():8.3f} {100.0 * np.mean(own <= 1.1):7.0f}% {true.max():13.3f}')


if __name__ == '__main__':
    main()
