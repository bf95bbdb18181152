"""Machines whose rest is not perfect: is the main cause established, and only the true one?

    python benchmarks/real_faults.py [--machines NAME ...] [--seeds N ...] [--out FILE.jsonl]
    python benchmarks/real_faults.py --table FILE.jsonl ...

The records of each machine come from a richer simulator than the model that is diagnosed: every
one has errors that are in no catalogue. Each effect is hidden in turn, then hidden while it is not
in the catalogue, and once nothing is hidden. Three runs are fitted, a fourth is held out. A cause
is over the limit if it makes the misfit of the base three times that of the sound twin. Counted is
a name for a cause that is established; the seeds 1 to 9 are for development, 11 to 19 are sealed.
"""

from __future__ import annotations

import os

os.environ.setdefault('SADDLERING_THREADS', '1')

import argparse
from collections import Counter
from collections.abc import Sequence
import importlib
import json
from pathlib import Path
import time
from typing import Any

from any_simulator import Case, cases
from machines.machine import Machine
import numpy as np

from saddlering_ros.discrepancy import diagnose, Diagnosis

MACHINES = ('oscillator', 'drive', 'motor', 'tank')
OVER = 3.0
"""Misfit of the base over that of the sound twin above which a cause is over the limit."""

BINS = 10
"""Bins of the expected calibration error."""


def misfit(found: Diagnosis) -> float:
    """Rms of the residual of the base over range, of all runs and channels."""
    shares = [
        np.mean((pair.before - pair.run.channels) ** 2, axis=1)
        / np.ptp(pair.run.channels, axis=1) ** 2 for pair in found.runs]
    return float(np.sqrt(np.mean(shares)))


def one(machine: Machine, case: Case, seed: int, sound: float) -> dict[str, Any]:
    """The verdict on one case; sound: misfit of the base without anything hidden."""
    runs = [machine.record(number, seed, case.hidden) for number in (1, 2, 3, 4)]
    began = time.process_time()
    found = diagnose(case.model, runs[:3], hold_out=runs[3:])
    groups = [list(cause.group) for cause in found.causes]
    return {
        'machine': machine.name, 'seed': seed, 'case': case.name, 'effect': case.effect,
        'removed': case.removed, 'verdict': found.verdict, 'groups': groups,
        'complete': found.complete, 'stability': found.stability,
        'probabilities': dict(found.probabilities), 'misfit': misfit(found), 'sound': sound,
        'held_out': found.gain.held_out, 'warnings': list(found.warnings),
        'contains': [list(cause.definition.contains) for cause in found.causes],
        'seconds': time.process_time() - began,
    }


def machine_rows(name: str, seeds: Sequence[int]) -> list[dict[str, Any]]:
    """Every case of a machine."""
    machine: Machine = importlib.import_module(f'machines.{name}').MACHINE
    rows = []
    for seed in seeds:
        sound = 0.0
        for case in cases(machine, seed):
            row = one(machine, case, seed, sound)
            sound = sound or row['misfit']
            rows.append(row)
            print(f'{name} {seed} {case.name}: {row["verdict"]} {row["groups"]}, '
                  f'{row["misfit"] / sound:.1f} times the sound misfit, held out '
                  f'{row["held_out"]}, stability {row["stability"]:.2f}, '
                  f'{row["seconds"]:.0f} s', flush=True)
    return rows


def is_named(row: dict[str, Any]) -> bool:
    """Whether a cause is established."""
    return row['verdict'] in ('named', 'ambiguous')


def is_right(row: dict[str, Any]) -> bool:
    """Whether the hidden effect is the first cause, in its group, or contained in its law."""
    truth = row['effect'] or row['removed']
    first = [*row['groups'][0], *row['contains'][0]] if row['groups'] else []
    return bool(truth) and truth in first


def scores(rows: Sequence[dict[str, Any]]) -> tuple[float, float, float]:
    """Brier score, log score and expected calibration error of the told probabilities."""
    told, true = [], []
    for row in rows:
        truth = row['effect'] or ('unknown' if row['removed'] else '')
        answers = row['probabilities']
        for name, chance in answers.items():
            told.append(chance)
            sound = not truth and name in ('none', 'unknown')
            true.append(float(truth in name.split(' or ') or sound))
    chances, hits = np.array(told), np.array(true)
    places = np.minimum((chances * BINS).astype(int), BINS - 1)
    error = sum(
        abs(float(np.mean(chances[places == place] - hits[places == place])))
        * float(np.mean(places == place)) for place in np.unique(places))
    kept = np.clip(np.where(hits > 0.0, chances, 1.0 - chances), 1e-3, 1.0)
    return float(np.mean((chances - hits) ** 2)), float(-np.mean(np.log(kept))), error


def table(rows: Sequence[dict[str, Any]]) -> None:
    """The figures of docs/benchmarks, by machine and in all."""
    for name in (*sorted({row['machine'] for row in rows}), 'all'):
        own = [row for row in rows if name in (row['machine'], 'all')]
        count: Counter[str] = Counter()
        for row in own:
            named, right = is_named(row), is_right(row)
            if row['effect']:
                over = row['misfit'] >= OVER * row['sound']
                count['over'] += over
                count['over, right and established'] += over and named and right
                count['over, first cause right'] += over and right
                count['under'] += not over
                count['under, right and established'] += not over and named and right
                count['wrong name'] += named and not right
                count['more than one name'] += named and right and len(row['groups']) > 1
            elif row['removed']:
                count['removed'] += 1
                count['removed, established'] += named and not right
                count['removed, contained in another law'] += named and right
            else:
                count['sound'] += 1
                count['sound, named'] += named
        brier, log, error = scores(own)
        print(f'{name}: ' + ', '.join(f'{key} {value}' for key, value in count.items())
              + f'; Brier {brier:.3f}, log {log:.3f}, calibration error {error:.3f}; median '
              f'{np.median([row["seconds"] for row in own]):.1f} s')


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument('--machines', nargs='*', default=list(MACHINES))
    parser.add_argument('--seeds', nargs='*', type=int, default=[1, 2, 3])
    parser.add_argument('--out', type=Path)
    parser.add_argument('--table', nargs='*', type=Path)
    args = parser.parse_args()
    if args.table:
        table([json.loads(line) for path in args.table for line in path.read_text().splitlines()])
        return
    rows = [row for name in args.machines for row in machine_rows(name, args.seeds)]
    if args.out:
        args.out.write_text(''.join(f'{json.dumps(row)}\n' for row in rows))
    table(rows)


if __name__ == '__main__':
    main()
