"""Makes the bags beside this script: one virtual rig with one hidden fault, five tests.

The fault is drawn from SEED and shown by --open only, so that the diagnosis can be tried without
knowing the answer. The same SEED gives the same bags.
"""

from __future__ import annotations

import argparse
import json
from pathlib import Path
import sys

HERE = Path(__file__).resolve().parent
sys.path.insert(0, str(HERE.parent / 'benchmarks'))

from examiner import draw_truth, DrawSettings, RecordSettings, RUNS, SINGLE, Truth, write_campaign  # noqa: E402

SEED = 2080

CANDIDATES = ('bolt_opening', 'film_creep', 'probe_gain', 'probe_nonlinearity', 'radial_friction',
              'ring_ovalisation', 'settling', 'tilt_friction', 'worn_sector_radial')
"""Faults that these five tests can tell; which of them it is, chance decides."""

SETTINGS = RecordSettings(rest=2.2)
"""An alarm reads the noise from 2 s of rest; the load needs the other 0.2 s to leave it."""


def truth() -> Truth:
    return draw_truth(SEED, SINGLE, DrawSettings(effects=CANDIDATES, sizes=(0.55, 0.75),
                                                 noise=0.3e-6))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument('--out', type=Path, default=HERE, help='folder for the bags')
    parser.add_argument('--open', action='store_true', help='print the hidden truth, make nothing')
    args = parser.parse_args()
    if args.open:
        print(json.dumps(truth().to_json(), indent=2))
        return
    for bag in write_campaign(truth(), args.out, tuple(RUNS), SETTINGS, overwrite=True):
        size = sum(file.stat().st_size for file in bag.iterdir())
        print(f'{bag}: {size / 1e6:.2f} MB')


if __name__ == '__main__':
    main()
