"""Machines whose rest is not perfect: is the main cause established, and only the true one?

    python benchmarks/real_faults.py [--machines NAME ...] [--seeds N ...] [--out FILE.jsonl]
    python benchmarks/real_faults.py --draws FIRST COUNT --out FILE.jsonl
    python benchmarks/real_faults.py --table FILE.jsonl ... [--picture FILE.svg]

The records come from richer simulators than the model that is diagnosed, or from a real machine.
Each effect is hidden in turn, then hidden while it is not in the catalogue, and once nothing is
hidden. Three runs are fitted, a fourth is held out. A cause is over the limit if it makes the
misfit of the base three times that of the sound twin. Counted is a name for a cause that is
established; seeds 1 to 9 are for development, 11 to 19 are sealed. --draws takes one trial of one
machine for each number and appends what is not in the file yet: a quarter has the true law taken
out, 15 % nothing hidden. Cranfield's records are read from the folder in the variable CRANFIELD.
"""

from __future__ import annotations

import os

os.environ.setdefault('SADDLERING_THREADS', '1')

import argparse
from collections import Counter
from collections.abc import Iterator, Sequence
from functools import partial
import importlib
import json
from pathlib import Path
import time
from typing import Any

from any_simulator import Case, cases
from machines.examples import ALSO_HIDDEN
from machines.examples import machine as example
from machines.machine import Machine, Records, Trial
import numpy as np
from reliability import report

from saddlering_ros.discrepancy import diagnose, Diagnosis

RICH = ('oscillator', 'drive', 'motor', 'tank')
"""Machines with a richer simulator, written for this benchmark."""

EXACT = ('predator_prey', 'pendulum', 'cart_pole', *ALSO_HIDDEN)
"""Machines of other people whose records follow the model itself."""

OVER = 3.0
"""Misfit of the base over that of the sound twin above which a cause is over the limit."""

SHARES = {'removed': 0.25, 'sound': 0.15, 'hidden': 0.6}
"""Shares of the kinds of trials among draws."""


def trials(name: str, seed: int) -> list[Trial]:
    """Every trial of a machine; a machine has trials of its own, or cases by its catalogue."""
    module = example(name) if name in ALSO_HIDDEN else importlib.import_module(f'machines.{name}')
    if hasattr(module, 'trials'):
        return list(module.trials(seed))
    machine: Machine = getattr(module, 'MACHINE', module)

    def records(case: Case) -> Records:
        runs = [machine.record(number, seed, case.hidden) for number in (1, 2, 3, 4)]
        return runs[:3], runs[3:]

    return [
        Trial(name, case.name, seed, case.model, partial(records, case),
              tuple(item for item in (case.effect, case.removed) if item), bool(case.removed))
        for case in cases(machine, seed)]


def drawn(name: str, draw: int) -> Trial:
    """The trial of a machine that a number stands for."""
    random = np.random.default_rng([draw, 9])
    kind = random.choice(list(SHARES), p=list(SHARES.values()))
    pool = [trial for trial in trials(name, draw) if trial.kind == kind]
    return pool[int(random.integers(len(pool)))]


def misfit(found: Diagnosis) -> float:
    """Rms of the residual of the base over range, of all runs and channels."""
    shares = [
        np.nanmean((pair.before - pair.run.channels) ** 2, axis=1)
        / np.ptp(pair.run.channels, axis=1) ** 2 for pair in found.runs]
    return float(np.sqrt(np.mean(shares)))


def row_of(trial: Trial) -> dict[str, Any]:
    """The verdict on a trial."""
    runs, held = trial.records()
    began = time.process_time()
    found = diagnose(trial.model, runs, hold_out=held)
    return {
        'machine': trial.machine, 'seed': trial.seed, 'trial': trial.name, 'kind': trial.kind,
        'truth': trial.truth, 'exact': trial.machine in EXACT, 'misfit': misfit(found),
        'seconds': time.process_time() - began, **answer_of(found),
    }


def answer_of(found: Diagnosis) -> dict[str, Any]:
    """What a diagnosis says."""
    return {
        'verdict': found.verdict, 'groups': [list(cause.group) for cause in found.causes],
        'contains': [list(cause.definition.contains) for cause in found.causes],
        'visible': [cause.visible for cause in found.causes],
        'probabilities': dict(found.probabilities), 'stability': found.stability,
        'complete': found.complete, 'held_out': found.gain.held_out,
        'warnings': list(found.warnings),
    }


def say(row: dict[str, Any]) -> None:
    print(f'{row["machine"]} {row["seed"]} {row["trial"]}: {row["verdict"]} {row["groups"]}, held '
          f'out {row["held_out"]}, {row["seconds"]:.1f} s', flush=True)


def all_rows(name: str, seed: int) -> Iterator[dict[str, Any]]:
    """Every trial of a machine; its first one is sound."""
    sound = 0.0
    for trial in trials(name, seed):
        row = row_of(trial)
        sound = sound or row['misfit']
        yield {**row, 'over': row['misfit'] >= OVER * sound}


def append_draws(names: Sequence[str], first: int, count: int, out: Path) -> None:
    """Rows of numbered draws that are not in the file yet, the machines in turn."""
    there = {json.loads(line)['seed'] for line in out.read_text().splitlines()} if (
        out.exists()) else set()
    for draw in sorted({*range(first, first + count)} - there):
        row = row_of(drawn(names[draw % len(names)], draw))
        say(row)
        with out.open('a') as file:
            file.write(f'{json.dumps(row)}\n')


def is_named(row: dict[str, Any]) -> bool:
    """Whether a cause is established."""
    return row['verdict'] in ('named', 'ambiguous')


def is_right(row: dict[str, Any]) -> bool:
    """Whether what is hidden is the first cause, in its group, or contained in its law."""
    first = [*row['groups'][0], *row['contains'][0]] if row['groups'] else []
    return bool(set(row['truth']) & set(first))


def table(rows: Sequence[dict[str, Any]]) -> None:
    """The figures of docs/benchmarks, by machine and in all."""
    for name in (*sorted({row['machine'] for row in rows}), 'all'):
        own = [row for row in rows if name in (row['machine'], 'all')]
        count: Counter[str] = Counter()
        for row in own:
            named, right, kind = is_named(row), is_right(row), row['kind']
            size = {True: ', over', False: ', under'}.get(row.get('over'), '')
            size = size if kind == 'hidden' else ''
            count[f'{kind}{size}'] += 1
            count[f'{kind}{size}: first cause right'] += right
            count[f'{kind}{size}: established, right'] += named and right
            count[f'{kind}{size}: established, wrong'] += named and not right
            count['a second name'] += named and len(row['groups']) > 1
        print(f'{name}: ' + ', '.join(
            f'{key} {value}' for key, value in sorted(count.items()) if value)
            + f'; median {np.median([row["seconds"] for row in own]):.1f} s')


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument('--machines', nargs='*', default=[])
    parser.add_argument('--seeds', nargs='*', type=int, default=[1, 2, 3])
    parser.add_argument('--draws', nargs=2, type=int)
    parser.add_argument('--out', type=Path)
    parser.add_argument('--table', nargs='*', type=Path)
    parser.add_argument('--picture', type=Path)
    args = parser.parse_args()
    if args.table:
        rows = [json.loads(line) for path in args.table for line in path.read_text().splitlines()]
        table(rows)
        report(rows, args.picture)
    elif args.draws:
        first, count = args.draws
        append_draws(args.machines or [*RICH, *EXACT], first, count, args.out)
    else:
        rows = []
        for name in args.machines or RICH:
            for seed in args.seeds:
                for row in all_rows(name, seed):
                    say(row)
                    rows.append(row)
        if args.out:
            args.out.write_text(''.join(f'{json.dumps(row)}\n' for row in rows))
        table(rows)


if __name__ == '__main__':
    main()
