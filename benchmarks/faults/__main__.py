"""Faults put into running nodes, and whether they keep their promises; real processes, real DDS.

python -m benchmarks.faults [--rounds 3] [--seed 1] [--only NAME ...] [--hours 24] [--json FILE]

A driver publishes the five raw topics of a ring whose true motion is known, or a bag is replayed
in lockstep; one fault after the other is put in at random moments. After each it is asked:

- numbers: has a displacement, simulated displacement or residual gone out that differs from the
  truth by more than TOLERANCE, without a warning or error on /diagnostics within two seconds?
- others: do the processes that were left alone still run, and publish?
- back: is a node that was started again in step, or does it say what it waits for, within a second
  of its first sign of life?
- clean: has every process ended, and does nothing in /dev/shm stay locked or break a next start?

Prints faults put in and faults survived; status 1 if a promise was broken.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable
import json
import os
from pathlib import Path
import random
import sys

from .beside_driver import beside_a_driver, DRIVEN
from .processes import clean, MARK
from .replays import a_day, lose_replay_nodes, two_replays
from .servers import kill_action_servers
from .stage import Outcome


def campaign(rounds: int, seed: int, hours: float, only: set[str]) -> dict[str, Outcome]:
    """Every scenario; what came of it by name."""
    chance = random.Random(seed)
    scenarios: dict[str, Callable[[], Outcome]] = {
        'driver': lambda: beside_a_driver(chance, rounds, only),
        'replay': lambda: lose_replay_nodes(chance),
        'two_replays': lambda: two_replays(chance),
        'servers': lambda: kill_action_servers(chance),
        'day': lambda: a_day(hours),
    }
    outcomes = {}
    for name, scenario in scenarios.items():
        if only and name not in only and not (name == 'driver' and only & set(DRIVEN)):
            continue
        print(name, flush=True)
        outcome = scenario()
        outcome.faults += clean()
        outcomes[name] = outcome
        for what, value in outcome.figures.items():
            print(f'  {what:44} {value:10.2f}', flush=True)
        for fault in outcome.faults:
            print(f'  BROKEN: {fault}', flush=True)
    return outcomes


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument('--rounds', type=int, default=3, help='of the faults beside a driver')
    parser.add_argument('--seed', type=int, default=1)
    parser.add_argument('--hours', type=float, default=24.0, help='of recorded time in one replay')
    parser.add_argument('--only', nargs='+', default=[], metavar='NAME')
    parser.add_argument('--quick', action='store_true', help='one round, a quarter of an hour')
    parser.add_argument('--json', type=Path)
    args = parser.parse_args()
    if args.quick:
        args.rounds, args.hours = 1, 0.25
    os.environ[MARK] = str(os.getpid())
    outcomes = campaign(args.rounds, args.seed, args.hours, set(args.only))
    put_in = sum(outcome.put_in for outcome in outcomes.values())
    broken = sum(len(outcome.faults) for outcome in outcomes.values())
    print(f'\n{put_in} faults put in, {broken} promises broken')
    if args.json:
        figures = {name: vars(outcome) for name, outcome in outcomes.items()}
        args.json.write_text(json.dumps(figures, indent=2) + '\n')
    return 1 if broken else 0


if __name__ == '__main__':
    sys.exit(main())
