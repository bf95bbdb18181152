"""The alarm of a running test: false alarms in simulated hours, delay of steps and drifts.

python benchmarks/alarm.py [--hours H] [--draws N] [--seed N] steps the detector itself; streams of
an hour run side by side as its channels. Theory of the delay: log(threshold) over the information
a block, shift^2 / 2.
"""

from __future__ import annotations

import argparse
import math
import sys
import time

import numpy as np

from saddlering_ros.monitoring import Detector, threshold_of

BLOCK = 0.02
CHANNELS = 3


def false_alarms(hours: int, allowed_hours: float, seed: int) -> int:
    """Streams of an hour each, of `hours`, in which a sound ring raised an alarm."""
    detector = Detector(CHANNELS * hours, math.inf)
    limit = math.log(threshold_of(allowed_hours, BLOCK) * 2 * CHANNELS)
    chance = np.random.default_rng(seed)
    alarmed = np.zeros(hours, dtype=bool)
    still = np.zeros(CHANNELS * hours)
    for _ in range(round(3600.0 / BLOCK)):
        detector.step(chance.standard_normal(CHANNELS * hours), still)
        alarmed |= (detector.evidence.max(axis=0) > limit).reshape(hours, CHANNELS).any(axis=1)
    return int(alarmed.sum())


def delays(size: float, draws: int, seed: int, *, drift: float = 0.0) -> np.ndarray:
    """Delays [s] of the alarm after a step of `size`, or a drift to it within `drift` seconds."""
    chance = np.random.default_rng(seed)
    found = []
    for _ in range(draws):
        detector = Detector(CHANNELS, threshold_of(1000.0, BLOCK))
        for block in range(60_000):
            innovations = chance.standard_normal(CHANNELS)
            passed = BLOCK * (block - 500)
            if passed >= 0.0:
                innovations[0] += size * (min(1.0, passed / drift) if drift else 1.0)
            if detector.step(innovations, np.zeros(CHANNELS)) is not None:
                found.append(passed)
                break
    return np.array(found)


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument('--hours', type=int, default=2000, help='simulated hours of a sound ring')
    parser.add_argument('--allowed', type=float, default=1000.0, help='hours a false alarm')
    parser.add_argument('--draws', type=int, default=50)
    parser.add_argument('--seed', type=int, default=0)
    args = parser.parse_args()
    began = time.monotonic()
    count = false_alarms(args.hours, args.allowed, args.seed)
    print(f'{count} of {args.hours} hours with a false alarm; one in {args.allowed:g} h is '
          f'allowed ({time.monotonic() - began:.0f} s)', flush=True)
    threshold = math.log(threshold_of(1000.0, BLOCK) * 2 * CHANNELS)
    for size in (0.5, 1.0, 3.0):
        theory = BLOCK * threshold / (0.5 * size**2)
        step, drift = delays(size, args.draws, 1), delays(size, args.draws, 2, drift=10.0)
        print(f'{size:g} sigma: step median {np.median(step):.2f} s (theory {theory:.2f} s), nine '
              f'in ten {np.quantile(step, 0.9):.2f} s; drift over 10 s median '
              f'{np.median(drift):.2f} s', flush=True)
    return 0


if __name__ == '__main__':
    sys.exit(main())
