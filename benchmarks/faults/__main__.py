"""Do running nodes keep their promises when faults are put in; real processes, real DDS?

    python -m benchmarks.faults [--only NAME ...] [--rounds 3] [--hours 24] [--seed 1]

A driver publishes the five raw topics of a ring whose true motion is known, or a bag is replayed
in lockstep; one fault after the other is put in at random moments. After each it is asked:

- numbers: has a displacement, simulated displacement or residual gone out that differs from the
  truth by more than TOLERANCE, without a warning or error on /diagnostics within two seconds?
- others: do the processes that were left alone still run, and publish?
- back: is a node that was started again in step, or does it say what it waits for, within a second
  of its first sign of life?
- clean: has every process ended, and does nothing in /dev/shm stay locked or break a next start?

`interlock` loses a node during a slip of the probes and waits for examples/interlock.py to open.
`day` replays --hours of recorded time. NAME is a scenario or a fault beside a driver (kills,
stops, stalled, rubbish, ten_times). Status 1 if a promise was broken.
"""

from __future__ import annotations

from collections.abc import Callable
import contextlib
import os
from pathlib import Path
import random
import sys
import time

from benchmarks.frame import arguments, table
from saddlering_ros.ros.launcher import sweep

from .beside_driver import beside_a_driver, DRIVEN
from .interlock import lose_nodes_in_a_slip
from .replays import a_day, kill_action_servers, lose_replay_nodes, two_replays
from .stage import Outcome

MARK = 'SADDLERING_FAULTS'
"""The variable by which the processes of a campaign are known."""


def marked() -> list[str]:
    """Processes that carry this campaign's mark, but this one."""
    mark = f'{MARK}={os.environ[MARK]}'.encode()
    found = []
    for folder in Path('/proc').glob('[0-9]*'):
        with contextlib.suppress(OSError):
            if int(folder.name) != os.getpid() and mark in (folder / 'environ').read_bytes():
                found.append((folder / 'cmdline').read_bytes().replace(b'\0', b' ').decode())
    return found


def clean() -> list[str]:
    """What is left over: processes; files of dead processes that a start does not remove."""
    deadline = time.monotonic() + 5.0
    while marked() and time.monotonic() < deadline:
        time.sleep(0.1)
    faults = [f'still running: {line}' for line in marked()]
    time.sleep(2.1)  # younger files may belong to a process that has not locked them yet
    sweep()
    if sweep():
        faults.append('files of dead processes come back in /dev/shm')
    return faults


def main() -> int:
    args = arguments(
        __doc__, {'rounds': 1, 'hours': 0.25, 'only': ['driver', 'replay', 'two_replays',
                                                       'servers', 'day']},
        only=(), rounds=3, hours=24.0, seed=1)
    os.environ[MARK] = str(os.getpid())
    chance, only, rows, broken = random.Random(args.seed), set(args.only), [], 0
    scenarios: dict[str, Callable[[], Outcome]] = {
        'driver': lambda: beside_a_driver(chance, args.rounds, only & set(DRIVEN)),
        'replay': lambda: lose_replay_nodes(chance), 'two_replays': lambda: two_replays(chance),
        'servers': lambda: kill_action_servers(chance), 'interlock': lose_nodes_in_a_slip,
        'day': lambda: a_day(args.hours)}
    for name, scenario in scenarios.items():
        if only and name not in only and not (name == 'driver' and only & set(DRIVEN)):
            continue
        print(name, flush=True)
        outcome = scenario()
        outcome.faults += clean()
        for fault in outcome.faults:
            print(f'  BROKEN: {fault}', flush=True)
        broken += len(outcome.faults)
        rows.append((name, outcome.put_in, len(outcome.faults), '; '.join(
            f'{what} {value:.2f}' for what, value in outcome.figures.items())))
    table('Faults in running nodes', ('scenario', 'put in', 'promises broken', 'figures'), rows)
    return 1 if broken else 0


if __name__ == '__main__':
    sys.exit(main())
