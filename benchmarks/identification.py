"""Time of an identification over the number of bags, and what its fit grid costs.

The fit simulates dynamic runs with loads averaged to 250 Hz and compares blocks of 20 ms; the
second table shows the parameters' shift against a fit with every millisecond simulated.
    python benchmarks/identification.py [--quick]
"""

from __future__ import annotations

import argparse
import time
from unittest import mock

import numpy as np
from rigs import RIG, virtual_run

from saddlering_ros.identification import IdentificationSettings, identify, objective, observation
from saddlering_ros.rig import ContactParameters, PARAMETER_NAMES, TRUE_TO_SCALE

CONTACTS = {
    'true to scale': TRUE_TO_SCALE,
    'little D1, much D2': ContactParameters(8e7, 1.2, 1e5, 3e8, 1.15, 1e7),
    'stiff axial, soft middle': ContactParameters(8e8, 1.1, 2e6, 6e7, 1.2, 2e5),
}


def times(quick: bool) -> None:
    plan = [('static', 50.0, 1.0), ('dynamic', 50.0, 1.0), ('static', 70.0, 1.0),
            ('dynamic', 70.0, 1.0), ('dynamic', 50.0, 4.0)]
    runs = [
        virtual_run(test, elevation, TRUE_TO_SCALE, seed=place, speed=speed)
        for place, (test, elevation, speed) in enumerate(plan)
    ]
    identify(runs[:2], RIG)  # compiled code is read from its cache here
    print(f'{"bags":>4s} {"method":>8s} {"seconds":>8s} {"evaluations":>12s} {"chi2/dof":>9s}')
    for count in (2,) if quick else (1, 2, 4, 5):
        for method in ('default', 'paper'):
            started = time.perf_counter()
            found = identify(runs[:count], RIG, IdentificationSettings(method=method))
            took = time.perf_counter() - started
            print(f'{count:4d} {method:>8s} {took:8.2f} {found.evaluations:12d} '
                  f'{found.reduced_chi_square:9.3g}')


def fit_grid(quick: bool) -> None:
    print('shift of the parameters by the fit grid, in percent')
    print(f'{"ring":26s}' + ''.join(f'{name:>9s}' for name in PARAMETER_NAMES))
    for name, contact in list(CONTACTS.items())[: 1 if quick else None]:
        runs = [virtual_run('static', 50.0, contact, seed=1),
                virtual_run('dynamic', 50.0, contact, seed=2)]
        usual = identify(runs, RIG).parameters.contact.to_array()
        with (mock.patch.object(observation, 'SIMULATION_RATE', 1000.0),
              mock.patch.object(objective, 'LONGEST_STEP', 1e-3)):
            fine = identify(runs, RIG).parameters.contact.to_array()
        shift = 100.0 * (usual / fine - 1.0)
        print(f'{name:26s}' + ''.join(f'{value:9.3f}' for value in np.round(shift, 3) + 0.0))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument('--quick', action='store_true', help='two bags, one ring')
    args = parser.parse_args()
    times(args.quick)
    fit_grid(args.quick)


if __name__ == '__main__':
    main()
