"""Machines whose rest is not perfect: is the main cause established, and only the true one?

    python benchmarks/real_faults.py [--machines NAME ...] [--seeds N ...] [--out FILE.jsonl]
    python benchmarks/real_faults.py --draws FIRST COUNT [--kinds KIND ...] --out FILE.jsonl
    python benchmarks/real_faults.py --table FILE.jsonl ... [--picture FILE.svg]

The records come from richer simulators than the model that is diagnosed, or from a real machine.
Each effect is hidden in turn, then hidden while it is not in the catalogue, and once nothing is
hidden. Three runs are fitted, a fourth is held out. A cause is over the limit if it makes the
misfit of the base three times that of the same machine with nothing hidden. --draws takes one
trial of one machine for each number and appends what is not in the file yet: a quarter has the
true law taken out, 15 % nothing hidden. Numbers drawn with --kinds hidden and again with --kinds
removed are the same records, with and without the true law in the catalogue.
"""

import os

os.environ.setdefault('SADDLERING_THREADS', '1')

from collections.abc import Callable, Sequence
from functools import partial
import importlib
from pathlib import Path
import time
from typing import Any

from any_simulator import Case, cases
import frame
from machines.examples import ALSO_HIDDEN
from machines.examples import machine as example
from machines.machine import Machine, Records, Trial, without
import numpy as np
from reliability import report

from saddlering_ros.discrepancy import diagnose, Diagnosis

RICH = ('oscillator', 'drive', 'motor', 'tank')
"""Machines with a richer simulator, written for this benchmark."""

EXACT = ('predator_prey', 'pendulum', 'cart_pole', *ALSO_HIDDEN)
"""Machines of other people whose records follow the model itself."""

OVER = 3.0
"""Misfit, over that with nothing hidden, of a cause over the limit: it is 89 % of the power."""

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


def drawn(name: str, draw: int, kinds: Sequence[str] = tuple(SHARES)) -> Trial:
    """The trial of a machine that a number stands for, of one of these kinds."""
    random = np.random.default_rng([draw, 9])
    shares = np.array([SHARES[kind] for kind in kinds])
    kind = random.choice(list(kinds), p=shares / shares.sum())
    pool = [trial for trial in trials(name, draw) if trial.kind == kind]
    return pool[int(random.integers(len(pool)))]


def misfit(found: Diagnosis) -> float:
    """Rms of the residual of the base over range, of all runs and channels.

    Beside effects and a learnt model error the published base is no fit of least squares.
    """
    shares = [
        np.nanmean((pair.before - pair.run.channels) ** 2, axis=1)
        / np.ptp(pair.run.channels, axis=1) ** 2 for pair in found.runs]
    return float(np.sqrt(np.mean(shares)))


def base_misfit(trial: Trial) -> float:
    """The misfit of the base, fitted without any effect, to the fitted runs of a trial."""
    return misfit(diagnose(without(trial.model, [*trial.model.effects]), trial.records()[0]))


def own_misfit(trial: Trial) -> float | None:
    """That of the same machine with nothing hidden, if there is such a trial."""
    every = trials(trial.machine, trial.seed) if trial.kind == 'hidden' else ()
    return next((base_misfit(sound) for sound in every if sound.kind == 'sound'), None)


def row_of(trial: Trial) -> dict[str, Any]:
    """The verdict on a trial."""
    runs, held = trial.records()
    began = time.process_time()
    found = diagnose(trial.model, runs, hold_out=held)
    return {
        'machine': trial.machine, 'seed': trial.seed, 'trial': trial.name, 'kind': trial.kind,
        'truth': trial.truth, 'exact': trial.machine in EXACT,
        'seconds': time.process_time() - began, **answer_of(found),
        'misfit': base_misfit(trial), 'own_misfit': own_misfit(trial),
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


def is_named(row: dict[str, Any]) -> bool:
    """Whether a cause is established."""
    return row['verdict'] in ('named', 'ambiguous')


def is_right(row: dict[str, Any]) -> bool:
    """Whether what is hidden is the first cause, in its group, or contained in its law."""
    first = [*row['groups'][0], *row['contains'][0]] if row['groups'] else []
    return bool(set(row['truth']) & set(first))


COLUMNS: dict[str, tuple[str, Callable[[dict[str, Any]], bool]]] = {
    'over the limit: established, right': ('over', lambda row: is_named(row) and is_right(row)),
    'hidden: first cause right': ('hidden', is_right),
    'established, right': ('hidden', lambda row: is_named(row) and is_right(row)),
    'established, wrong': ('hidden', lambda row: is_named(row) and not is_right(row)),
    'true law removed: established': ('removed', is_named),
    'sound: named': ('sound', is_named),
    'a second name': ('all', lambda row: is_named(row) and len(row['groups']) > 1),
}
"""Which rows a column is about, and what is counted of them."""


def table(rows: Sequence[dict[str, Any]]) -> None:
    """The figures of docs/benchmarks, by machine and in all."""
    shown = []
    for name in (*sorted({row['machine'] for row in rows}), 'all'):
        own = [row for row in rows if name in (row['machine'], 'all')]
        kinds = {'all': own, **{
            kind: [row for row in own if row['kind'] == kind] for kind in SHARES}}
        kinds['over'] = [row for row in kinds['hidden']
                         if row['misfit'] >= OVER * (row.get('own_misfit') or np.inf)]
        shown.append([name, *(
            f'{sum(map(counts, kinds[kind]))}/{len(kinds[kind])}'
            for kind, counts in COLUMNS.values()),
            float(np.median([row['seconds'] for row in own]))])
    frame.table('Verdicts', ['machine', *COLUMNS, 'median [s]'], shown)


def main() -> None:
    args = frame.arguments(
        __doc__, {'machines': ['oscillator'], 'seeds': [1]}, machines=(), seeds=(1, 2, 3),
        draws=(0, 0), kinds=tuple(SHARES), out=Path, table=(), picture=Path)
    if args.table:
        rows = [row for path in args.table for row in frame.kept_rows(Path(path))]
        table(rows)
        report(rows, args.picture)
        return
    first, count = args.draws
    names = args.machines or [*RICH, *(EXACT if count else ())]
    there = {row['seed'] for row in (frame.kept_rows(args.out) if args.out else ())}
    drawings = (drawn(names[draw % len(names)], draw, args.kinds)
                for draw in range(first, first + count) if draw not in there)
    every = (trial for name in names for seed in args.seeds for trial in trials(name, seed))
    rows = []
    for trial in drawings if count else every:
        rows.append(row_of(trial))
        say(rows[-1])
        if args.out:
            frame.keep(args.out, rows[-1])
    table(rows)


if __name__ == '__main__':
    main()
