"""How often is a verdict on a blind rig right: one process draws and seals, another diagnoses?

    python benchmarks/blind.py [--draws 300] [--count single=20 pair=5] [--seed 20000]
                               [--jobs 2] [--minutes M] [--out FILE.jsonl] [--table]

Every trial is a row of FILE, so that a campaign that was cut off goes on where it stopped; --table
prints the table of what is there. One run is held out of every trial. The status is 1 if a
promised rate is broken (benchmarks/examiner.py).
"""

import os

os.environ.setdefault('SADDLERING_THREADS', '1')

from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from concurrent.futures import as_completed, ProcessPoolExecutor
from dataclasses import asdict, dataclass
from itertools import pairwise
import json
import math
from pathlib import Path
import sys
import tempfile
import time
from typing import Any
from unittest.mock import patch

from examiner import broken_promises, open_seal, score, SEALED
from frame import arguments, keep, kept_rows, ROOT, run, share
import numpy as np

from saddlering_ros import diagnose, effects
from saddlering_ros.effects import effect as catalogued
from saddlering_ros.quantities import WIDTH_95
from saddlering_ros.virtual_rig.effects import find_effect

SHARES = {'clean': 0.2, 'single': 0.5, 'pair': 0.15, 'outside': 0.15, 'removed': 0.0}
"""Kinds of rigs, and their shares of all draws; removed: single, its law not in the catalogue."""

EXAMINER = ROOT / 'benchmarks' / 'examiner.py'
HELD_OUT = 'dynamic_70'
TWICE = 2.0
"""Targets are for effects of so many times their detection limit."""


@dataclass(frozen=True)
class Trial:
    """One blind trial: what was hidden, what was said, how it counts.

    ratios: sizes of hidden effects over the limits stated for where they act; error and within: of
    the size of a single effect relative error, and whether its 95 % interval holds the truth.
    """

    kind: str
    seed: int
    hidden: list[dict[str, Any]]
    verdict: str
    groups: list[list[str]]
    score: str
    ratios: list[float | None]
    error: float | None
    within: bool | None
    seconds: float

    def exceeds(self, least: float) -> bool:
        """Whether every hidden effect is of so many times its limit."""
        return bool(self.ratios) and all((ratio or 0.0) >= least for ratio in self.ratios)


def without(*removed: str) -> Any:
    """A context in which the catalogue lacks these effects."""
    listed = {name: one for name, one in effects.catalogue().items() if name not in removed}
    return patch.object(effects, 'catalogue', lambda: listed)


def trial(kind: str, seed: int) -> Trial:
    """Draw, seal, open, diagnose, score."""
    with tempfile.TemporaryDirectory(prefix='blind_') as folder:
        drawn = run([str(EXAMINER), '--seed', str(seed), '--out', f'{folder}/rig',
                     '--kind', 'single' if kind == 'removed' else kind])
        told = json.loads(drawn.said.strip().splitlines()[-1])
        fitted = [bag for bag in told['bags'] if Path(bag).name != HELD_OUT]
        held_out = [bag for bag in told['bags'] if Path(bag).name == HELD_OUT]
        # Before the diagnosis, which sees bags only: `removed` needs the name.
        hidden = open_seal(Path(folder) / 'rig' / SEALED, told['seal'])['effects']
        names = [item['effect'] for item in hidden]
        began = time.monotonic()
        with without(*names if kind == 'removed' else ()):
            verdict = diagnose(fitted, hold_out=held_out, seed=seed).found
        seconds = time.monotonic() - began
    answer: dict[str, Any] = {**verdict.to_json()}
    causes = [cause for cause in answer['causes'] if 'effect' in cause]
    groups = [cause['group'] for cause in causes]
    counted, _ = score(kind, names, answer['verdict'], groups)
    ratios = [size_over_limit(item, answer['detection_limits']) for item in hidden
              if kind in ('single', 'pair')]
    error, within = size_error(hidden[0], causes) if kind == 'single' else (None, None)
    return Trial(kind, seed, hidden, answer['verdict'], groups, counted, ratios, error, within,
                 seconds)


def size_over_limit(hidden: dict[str, Any], limits: Sequence[dict[str, Any]]) -> float | None:
    """Hidden size over the larger of detection and materiality limit at its place, if known.

    0 where it cannot be found at all.
    """
    own = next((item for item in limits if item['effect'] == hidden['effect']), None)
    if own is None:
        return None
    size = next(item for item in catalogued(hidden['effect']).parameters if item.amplitude)
    given = hidden['parameters'].get(size.name)
    if given is None or size.neutral != 0.0:
        return None
    if not own['testable']:
        return 0.0
    place = nearest_place(hidden, own['places']) if own['places'] else own
    if place['limit'] is None or place['material_limit'] is None:
        return 0.0
    return float(abs(given) / max(place['limit'], place['material_limit']))


def nearest_place(hidden: dict[str, Any], places: Sequence[dict[str, Any]]) -> dict[str, Any]:
    """Where the hidden effect acts, of the places tried; the one that shows best of equals."""
    spans = {item.name: item.high - item.low for item in catalogued(hidden['effect']).parameters}

    def distance(place: dict[str, Any]) -> tuple[float, float]:
        apart = 0.0
        for name, value in place['values'].items():
            if name in hidden['parameters']:
                difference = abs(value - hidden['parameters'][name])
                apart += difference / spans[name] if name in spans else difference > 0.5
        return apart, math.inf if place['limit'] is None else place['limit']

    return min(places, key=distance)


def size_error(
    hidden: dict[str, Any], causes: Sequence[dict[str, Any]]
) -> tuple[float | None, bool | None]:
    """Relative error of the size found, and whether its 95 % interval holds the truth."""
    name = find_effect(hidden['effect']).parameters[0].name
    for cause in causes:
        if cause['effect'] == hidden['effect'] and name in cause['parameters']:
            true, told = hidden['parameters'][name], cause['parameters'][name]
            value = told['value']
            if catalogued(hidden['effect']).line:  # of a line's phase nothing is promised
                true = math.hypot(true, hidden['parameters']['sine'])
                value = math.hypot(value, cause['parameters']['sine']['value'])
            apart = abs(value - true)
            return float(apart / abs(true)), bool(apart <= WIDTH_95 * told['std'])
    return None, None


def plan(counts: Mapping[str, int], seed: int) -> list[tuple[str, int]]:
    """(kind, seed) of every trial, the kinds mixed so that a part of them is a fair sample."""
    places = [((number + 0.5) / count, kind, seed + number)
              for kind, count in counts.items() for number in range(count)]
    return [(kind, own) for _, kind, own in sorted(places)]


def campaign(wanted: Sequence[tuple[str, int]], path: Path, jobs: int, minutes: float) -> None:
    """Run what is not kept yet, and keep each trial as soon as it is done."""
    done = {(row['kind'], row['seed']) for row in kept_rows(path)}
    waiting = [item for item in wanted if item not in done]
    end = time.monotonic() + 60.0 * minutes
    with ProcessPoolExecutor(jobs) as pool:
        while waiting and time.monotonic() < end:
            batch, waiting = waiting[:2 * jobs], waiting[2 * jobs:]
            running = {pool.submit(trial, *item): item for item in batch}
            for future in as_completed(running):
                try:
                    found = future.result()
                except Exception as problem:
                    print(f'{running[future]}: no verdict: {problem!r}', flush=True)
                    continue
                keep(path, asdict(found))
                print(line_of(found), flush=True)


def line_of(item: Trial) -> str:
    """One trial in one line."""
    hidden = ' + '.join(f'{effect["effect"]}({effect["form"]}, ' + ', '.join(
        f'{key} {value:.3g}' for key, value in effect['parameters'].items()) + ')'
        for effect in item.hidden)
    ratios = ', '.join(f'{ratio:.1f} x limit' for ratio in item.ratios if ratio is not None)
    return (f'{item.kind} {item.seed}: {item.score}: {hidden or "-"} {ratios} -> {item.verdict} '
            f'{" + ".join("|".join(group) for group in item.groups)} {item.seconds:.0f} s')


def report(trials: Sequence[Trial]) -> None:
    """Print every rate of the campaign."""
    print(f'\n{len(trials)} trials')
    for kind in SHARES:
        counts = Counter(item.score for item in trials if item.kind == kind)
        print(f'{kind}: ' + ', '.join(f'{name} {count}' for name, count in counts.most_common()))
    for line in (*rates(trials), *by_size(trials)):
        print(line)
    if trials:
        print(f'seconds per verdict: median {np.median([item.seconds for item in trials]):.0f}, '
              f'longest {max(item.seconds for item in trials):.0f}')


def rates(trials: Sequence[Trial]) -> Iterator[str]:
    """The rates that are promised, and those beside them."""
    def scored(trials: Sequence[Trial], *scores: str) -> str:
        return share(item.score in scores for item in trials)

    kinds = {kind: [item for item in trials if item.kind == kind] for kind in SHARES}
    large = [item for item in kinds['single'] if item.exceeds(TWICE)]
    yield f'false alarms on clean rigs: {scored(kinds["clean"], "false")}'
    yield (f'single effects of {TWICE:g} times their limit or more: right '
           f'{scored(large, "right")}, unknown {scored(large, "unknown")}, missed '
           f'{scored(large, "missed")}')
    yield f'all single effects: right {scored(kinds["single"], "right")}'
    faulty = [item for item in trials if item.kind not in ('clean', 'removed')]
    yield f'wrong names, of all rigs with faults: {scored(faulty, "wrong")}'
    yield f'wrong names, of single effects: {scored(kinds["single"], "wrong")}'
    yield f'outside the catalogue, called unknown: {scored(kinds["outside"], "right")}'
    for least in (0.0, 1.0, TWICE):
        pairs = [item for item in kinds['pair'] if least == 0.0 or item.exceeds(least)]
        yield (f'pairs of effects of {least:g} times their limit or more each: both found '
               f'{scored(pairs, "right")}, both or one {scored(pairs, "right", "part")}')
    sized = [item for item in trials if item.within is not None]
    yield f'95 % intervals of the size hold the truth: {share(item.within for item in sized)}'
    errors = [item.error for item in sized if item.error is not None]
    if errors:
        yield (f'relative error of the size: median {np.median(errors):.3f}, nine in ten under '
               f'{np.quantile(errors, 0.9):.2f} ({len(errors)} sizes)')


def by_size(trials: Sequence[Trial]) -> Iterator[str]:
    """Found against size: whether the stated detection limits hold."""
    yield 'single effects by size over the limit stated for where they act: said anything, right'
    single = [item for item in trials if item.kind == 'single' and item.ratios[0] is not None]
    for low, high in pairwise((0.0, 0.5, 1.0, 2.0, 4.0, 8.0, math.inf)):
        own = [item for item in single if low <= (item.ratios[0] or 0.0) < high]
        yield (f'  {low:g} to {high:g}: {share(item.score != "missed" for item in own)}, '
               f'{share(item.score == "right" for item in own)}')


def main() -> int:
    args = arguments(
        __doc__, {'draws': 4, 'out': Path('out/blind_short.jsonl')}, draws=300, count=(),
        seed=20_000, out=Path('out/blind.jsonl'), jobs=len(os.sched_getaffinity(0)),
        minutes=math.inf, table=False)
    pairs = [item.partition('=') for item in args.count]
    counts = {kind: int(count) for kind, _, count in pairs} or {
        kind: round(args.draws * part) for kind, part in SHARES.items()}
    if not args.table:
        campaign(plan(counts, args.seed), args.out, args.jobs, args.minutes)
    trials = [Trial(**row) for row in kept_rows(args.out)]
    report(trials)
    broken = broken_promises([(item.kind, item.score) for item in trials])
    print('\n'.join(f'BROKEN: {line}' for line in broken) or 'every promised rate is kept')
    return 1 if broken else 0


if __name__ == '__main__':
    sys.exit(main())
