"""Processor seconds of an identification and a diagnosis of bags, beside another version.

    python benchmarks/cost.py [--before DIR] [--rounds N] [BAG ...] [--what identify diagnose]

DIR is another checkout of the repository. Both versions run in turn, each in a process of its
own on one thread; the first call of each process, which reads compiled code, does not count. The
least of the rounds is compared, since other programs can only add to it.
"""

from __future__ import annotations

import argparse
import json
import os
from pathlib import Path
import subprocess
import sys
import time

ROOT = Path(__file__).resolve().parents[1]
BAGS = [ROOT / 'bags' / name for name in (
    'static_50', 'dynamic_50', 'static_70', 'dynamic_70', 'dynamic_50_fast')]
TASKS = ('identify', 'diagnose')
ONE_THREAD = {'SADDLERING_THREADS': '1', 'OPENBLAS_NUM_THREADS': '1', 'OMP_NUM_THREADS': '1'}


def measure(what: str, bags: list[Path]) -> dict[str, object]:
    """Seconds of the second of two calls, and the numbers found, by the package on sys.path."""
    from saddlering_ros.bags import read_run
    from saddlering_ros.diagnosis import diagnose
    from saddlering_ros.identification import identify
    from saddlering_ros.rig import default_rig

    rig = default_rig()
    runs = [read_run(bag, rig=rig) for bag in bags]
    for _ in range(2):
        began = time.process_time()
        found = identify(runs, rig) if what == 'identify' else diagnose(runs, rig=rig)
        seconds = time.process_time() - began
    if what == 'identify':
        contact = found.parameters.contact.to_array().tolist()
        return {'seconds': seconds, 'chi_square': found.chi_square, 'parameters': contact}
    return {'seconds': seconds, 'verdict': found.diagnosis.verdict,
            'causes': {one.effect: one.misfit if hasattr(one, 'misfit') else one.visible
                       for one in found.diagnosis.causes}}


def in_child(tree: Path, what: str, bags: list[Path]) -> dict[str, object]:
    """`measure` in a new process with the package of a checkout."""
    words = [sys.executable, str(Path(__file__).resolve()), *map(str, bags), '--child', str(tree),
             '--what', what]
    done = subprocess.run(words, env={**os.environ, **ONE_THREAD}, check=True,
                          capture_output=True, text=True)
    answer: dict[str, object] = json.loads(done.stdout.splitlines()[-1])
    return answer


def compare(before: Path | None, what: str, rounds: int, bags: list[Path]) -> None:
    trees = {'now': ROOT} if before is None else {'before': before, 'now': ROOT}
    least: dict[str, float] = {}
    for _ in range(rounds):
        for name, tree in trees.items():
            found = in_child(tree, what, bags)
            seconds = float(found.pop('seconds'))  # type: ignore[arg-type]
            least[name] = min(seconds, least.get(name, seconds))
            print(f'{what:9s} {name:7s} {seconds:7.2f} s  {json.dumps(found)}', flush=True)
    if before is not None:
        print(f'{what}: {least["before"]:.2f} s before, {least["now"]:.2f} s now: '
              f'{least["before"] / least["now"]:.2f} times as fast')


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.partition('\n')[0])
    parser.add_argument('--before', type=Path, help='another checkout, to be compared with')
    parser.add_argument('--rounds', type=int, default=2, help='processes of each version')
    parser.add_argument('--what', nargs='+', choices=TASKS, default=list(TASKS))
    parser.add_argument('--child', type=Path, help=argparse.SUPPRESS)
    parser.add_argument('bags', nargs='*', type=Path, default=BAGS)
    args = parser.parse_args()
    if args.child is not None:
        sys.path.insert(0, str(args.child))
        print(json.dumps(measure(args.what[0], args.bags)))
        return 0
    for what in args.what:
        compare(args.before, what, args.rounds, args.bags)
    return 0


if __name__ == '__main__':
    raise SystemExit(main())
