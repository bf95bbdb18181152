"""Cost of the record that the kernels read by name, beside a checkout with places in an array.

    git worktree add ../before 34a3997^; git worktree add ../after 34a3997
    python benchmarks/record_cost.py --before ../before --after ../after [--rounds N]

Commit 34a3997 put the record in place of the array and changed nothing else in the kernels. Both
checkouts run in turn, each in a process of its own on one thread; the least of the rounds counts,
because other programs can only add to it. At most 1.02 times the time is allowed.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable
import json
import os
from pathlib import Path
import subprocess
import sys
import time

ALLOWED = 1.02
RUNS = 40


def least(task: Callable[[], object]) -> float:
    """Least processor seconds of some calls after the first one, which may compile."""
    task()
    spent = []
    for _ in range(RUNS):
        began = time.thread_time()
        task()
        spent.append(time.thread_time() - began)
    return min(spent)


def measure() -> dict[str, float]:
    """Seconds of each task with the package on sys.path."""
    import numpy as np

    from saddlering_ros.effects.extension import NO_EXTENSION
    from saddlering_ros.rig import default_rig, ParameterSet, TRUE_TO_SCALE
    from saddlering_ros.ring.simulator import probe_batch, RingSimulator, static_batch

    rig, law = default_rig(), TRUE_TO_SCALE.to_array()
    seconds = np.arange(0.0, 10.0, 1e-3)
    load = rig.preload + (rig.full_scale_load - rig.preload) * (1.0 - np.abs(seconds / 5.0 - 1.0))
    steps = np.linspace(rig.preload, rig.full_scale_load, 51)
    laws = np.repeat(law[None, :], 20, axis=0)

    def live() -> None:
        simulator = RingSimulator(rig, ParameterSet(TRUE_TO_SCALE), 0.87)
        for at, value in zip(seconds[:2000].tolist(), load[:2000].tolist(), strict=True):
            simulator.push(at, value)

    return {
        'dynamic run, 10 s at 1 kHz': least(
            lambda: probe_batch(rig, [(law, NO_EXTENSION)], 0.87, seconds, load)),
        'static run, 20 laws at 51 loads': least(lambda: static_batch(rig, laws, 0.87, steps)),
        'live, 2000 samples': least(live)}


def in_child(tree: Path) -> dict[str, float]:
    """`measure` in a new process with the package of a checkout."""
    done = subprocess.run(
        [sys.executable, str(Path(__file__).resolve()), '--child', str(tree.resolve())],
        env={**os.environ, 'SADDLERING_THREADS': '1'}, check=True, capture_output=True, text=True)
    answer: dict[str, float] = json.loads(done.stdout.splitlines()[-1])
    return answer


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.partition('\n')[0])
    parser.add_argument('--before', type=Path, help='checkout with places in an array')
    parser.add_argument('--after', type=Path, help='checkout with the record')
    parser.add_argument('--rounds', type=int, default=3, help='processes of each checkout')
    parser.add_argument('--child', type=Path, help=argparse.SUPPRESS)
    args = parser.parse_args()
    if args.child is not None:
        sys.path.insert(0, str(args.child))
        print(json.dumps(measure()))
        return 0
    if args.before is None or args.after is None:
        parser.error('give --before and --after')
    rounds = [(in_child(args.before), in_child(args.after)) for _ in range(args.rounds)]
    worst = 0.0
    for name in rounds[0][0]:
        before, after = (min(one[place][name] for one in rounds) for place in (0, 1))
        worst = max(worst, after / before)
        print(f'{name:32s} {1e3 * before:8.2f} ms before, {1e3 * after:8.2f} ms after: '
              f'{after / before:.3f} times')
    print('met' if worst <= ALLOWED else f'MISSED: more than {ALLOWED:g} times')
    return 0 if worst <= ALLOWED else 1


if __name__ == '__main__':
    raise SystemExit(main())
