"""Blind trials: another process draws and seals, the diagnosis sees bags, then the seal opens.

python benchmarks/blind.py [--draws N] [--out FILE.jsonl] [--jobs N] [--minutes M] runs the
campaign of docs/diagnosis.md and prints its table. Every trial is a line of FILE, so a campaign
that was cut off goes on where it stopped; --table prints the table of what is there. One run is
held out of every trial. The status is 1 if a promised rate is broken (virtual_rig/scoring.py).
"""

from __future__ import annotations

import os

os.environ.setdefault('SADDLERING_THREADS', '1')

import argparse
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, ProcessPoolExecutor, wait
from dataclasses import asdict, dataclass
from itertools import pairwise
import json
import math
from pathlib import Path
import shutil
import subprocess
import sys
import tempfile
import time
from typing import Any

import numpy as np

from saddlering_ros import diagnose
from saddlering_ros.diagnosis import Verdict
from saddlering_ros.discrepancy.problem.fits import held_out_gain, refit, run_refits
from saddlering_ros.discrepancy.search.signatures import effect_starts
from saddlering_ros.effects import effect as catalogued
from saddlering_ros.virtual_rig.blind import broken_promises, open_seal, score, SEALED
from saddlering_ros.virtual_rig.effects import find_effect

KINDS = ('clean', 'single', 'pair', 'outside')
SHARES = {'clean': 0.2, 'single': 0.5, 'pair': 0.15, 'outside': 0.15}
HELD_OUT = 'dynamic_70'
TWICE = 2.0
"""Targets are for effects of so many times their detection limit."""


@dataclass(frozen=True)
class Trial:
    """One blind trial: what was hidden, what was said, how it counts.

    ratio: size of a single effect over the limit stated for where it acts; ratios: those of
    a pair; within: whether the 95 % interval of the size holds the truth; best_gain: held-out gain
    of the true effect.
    """

    kind: str
    seed: int
    hidden: list[dict[str, Any]]
    verdict: str
    groups: list[list[str]]
    score: str
    found: int
    ratio: float | None
    error: float | None
    within: bool | None
    gain: float | None
    best_gain: float | None
    seconds: float
    ratios: Sequence[float | None] = ()


def trial(
    kind: str, seed: int, extra: tuple[str, ...] = (), *, with_best_gain: bool = True
) -> Trial:
    """Draw, seal, diagnose, open, score."""
    folder = Path(tempfile.mkdtemp(prefix='blind_'))
    command = [sys.executable, '-m', 'saddlering_ros.virtual_rig.blind', '--seed', str(seed)]
    command += ['--kind', kind, '--out', str(folder / 'rig'), *extra]
    try:
        drawn = subprocess.run(command, check=True, capture_output=True, text=True)
        told = json.loads(drawn.stdout.strip().splitlines()[-1])
        fitted = [bag for bag in told['bags'] if Path(bag).name != HELD_OUT]
        sealed = [bag for bag in told['bags'] if Path(bag).name == HELD_OUT]
        began = time.monotonic()
        verdict = diagnose(fitted, hold_out=sealed, seed=seed).found
        seconds = time.monotonic() - began
        truth = open_seal(folder / 'rig' / SEALED, told['seal'])
    finally:
        shutil.rmtree(folder, ignore_errors=True)
    answer = verdict.to_json()
    causes = [cause for cause in answer['causes'] if 'effect' in cause]
    groups = [cause['group'] for cause in causes]  # type: ignore[typeddict-item]
    names = [item['effect'] for item in truth['effects']]
    counted, found = score(kind, names, answer['verdict'], groups)
    ratio = error = within = None
    ratios = [size_over_limit(item, answer['detection_limits']) for item in truth['effects']
              if kind in ('single', 'pair')]
    if kind == 'single':
        ratio = ratios[0]
        error, within = size_error(truth['effects'][0], causes)
    return Trial(
        kind, seed, truth['effects'], answer['verdict'], groups, counted, found, ratio, error,
        within, answer['gain']['held_out'] if causes else None,
        best_gain(verdict, names) if with_best_gain and kind != 'outside' else None, seconds,
        ratios if kind == 'pair' else (),
    )


def size_over_limit(hidden: dict[str, Any], limits: Sequence[dict[str, Any]]) -> float | None:
    """Hidden size over the larger of detection and materiality limit at its place, if known.

    0 where it cannot be found at all.
    """
    size = next(item for item in catalogued(hidden['effect']).parameters if item.amplitude)
    own = next(item for item in limits if item['effect'] == hidden['effect'])
    given = hidden['parameters'].get(size.name)
    if given is None or size.neutral != 0.0:
        return None
    if not own['testable']:
        return 0.0
    place = nearest_place(hidden, own['places']) if own['places'] else own
    if place['limit'] is None or place['material_limit'] is None:
        return 0.0
    return abs(given) / max(place['limit'], place['material_limit'])


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
    """Relative error of the size found, and whether 1.96 deviations hold the truth."""
    name = find_effect(hidden['effect']).parameters[0].name
    for cause in causes:
        if cause['effect'] == hidden['effect'] and name in cause['parameters']:
            true, told = hidden['parameters'][name], cause['parameters'][name]
            value = told['value']
            if catalogued(hidden['effect']).line:  # of a line's phase nothing is promised
                true = math.hypot(true, hidden['parameters']['sine'])
                value = math.hypot(value, cause['parameters']['sine']['value'])
            apart = abs(value - true)
            return float(apart / abs(true)), bool(apart <= 1.96 * told['std'])
    return None, None


def best_gain(verdict: Verdict, names: Sequence[str]) -> float | None:
    """Gain on the held-out run of the extension by the true effects, fitted as causes are."""
    found = verdict.diagnosis
    metric = found.fits.metric
    system = metric.problem.system
    effects = {item.id: item for item in system.effects}
    if not names or any(effects[name].line for name in names):
        return None
    held = [figures.record.run for figures in verdict.runs if figures.record.run.held_out]
    best = found.fits.before
    for name in names:
        less, effect = best, effects[name]
        starts = effect_starts(effect)
        fits = run_refits(metric, [
            refit(metric, less.candidate.plus(effect, variant),
                  np.concatenate([less.theta_unit, start]))
            for variant in range(len(effect.variants))
            for start in starts[:: max(1, len(starts) // 3)]
        ])
        best = min(fits, key=lambda fit: fit.misfit)
    return held_out_gain(metric.problem, held, found.fits.before, best)


# -- the campaign ------------------------------------------------------------------------------


def counts_of(draws: int, wanted: Sequence[str]) -> dict[str, int]:
    """Trials of each kind: those of KIND=N if any is given, else their shares of all draws."""
    if not wanted:
        return {kind: round(draws * share) for kind, share in SHARES.items()}
    pairs = [item.partition('=') for item in wanted]
    return {kind: int(count) for kind, _, count in pairs}


def plan(counts: Mapping[str, int], seed: int) -> list[tuple[str, int]]:
    """(kind, seed) of every trial, the kinds mixed so that a part of them is a fair sample."""
    places = [
        ((number + 0.5) / count, kind, seed + number)
        for kind, count in counts.items()
        for number in range(count)
    ]
    return [(kind, own) for _, kind, own in sorted(places)]


def read_trials(path: Path) -> list[Trial]:
    """Trials kept so far; a last line that was cut off does not count."""
    trials = []
    if path.exists():
        for line in path.read_text().splitlines():
            try:
                trials.append(Trial(**json.loads(line)))
            except (json.JSONDecodeError, TypeError):
                continue
    return trials


def campaign(
    wanted: Iterable[tuple[str, int]],
    path: Path,
    jobs: int,
    minutes: float,
    extra: tuple[str, ...],
    *,
    with_best_gain: bool,
) -> None:
    """Run what is not kept yet, and keep each trial as soon as it is done."""
    done = {(item.kind, item.seed) for item in read_trials(path)}
    waiting = [item for item in wanted if item not in done]
    end = time.monotonic() + 60.0 * minutes
    path.parent.mkdir(parents=True, exist_ok=True)
    with ProcessPoolExecutor(jobs) as pool, path.open('a') as kept:
        running: dict[Future[Trial], tuple[str, int]] = {}
        while running or (waiting and time.monotonic() < end):
            while waiting and len(running) < jobs and time.monotonic() < end:
                kind, seed = waiting.pop(0)
                own = pool.submit(trial, kind, seed, extra, with_best_gain=with_best_gain)
                running[own] = (kind, seed)
            finished, _ = wait(running, return_when=FIRST_COMPLETED)
            for future in finished:
                kind, seed = running.pop(future)
                try:
                    item = future.result()
                except Exception as problem:
                    print(f'{kind} {seed}: no verdict: {problem!r}', flush=True)
                    continue
                kept.write(json.dumps(asdict(item)) + '\n')
                kept.flush()
                print(line_of(item), flush=True)


def line_of(item: Trial) -> str:
    """One trial in one line."""
    hidden = [
        f'{effect["effect"]}({effect["form"]}, '
        + ', '.join(f'{key} {value:.3g}' for key, value in effect['parameters'].items())
        + ')'
        for effect in item.hidden
    ]
    said = ' + '.join('|'.join(group) for group in item.groups)
    ratio = '' if item.ratio is None else f' {item.ratio:.1f} x limit'
    return (f'{item.kind} {item.seed}: {item.score}: {" + ".join(hidden) or "-"}{ratio} -> '
            f'{item.verdict} {said} {item.seconds:.0f} s')


# -- the table ---------------------------------------------------------------------------------


def interval(count: int, total: int) -> str:
    """Share with its 95 % interval (E. B. Wilson, J. Am. Stat. Assoc. 22 (1927) 209)."""
    if total == 0:
        return 'no trials'
    z, share = 1.96, count / total
    middle = (share + z * z / (2 * total)) / (1 + z * z / total)
    half = z * math.sqrt(share * (1 - share) / total + z * z / (4 * total**2))
    half /= 1 + z * z / total
    return (f'{count}/{total} = {100 * share:.0f} % ({100 * max(0.0, middle - half):.0f} to '
            f'{100 * min(1.0, middle + half):.0f})')


def table(trials: Sequence[Trial]) -> str:
    """Every rate of the campaign in plain text."""
    lines = [f'{len(trials)} trials']
    for kind in KINDS:
        counts = Counter(item.score for item in trials if item.kind == kind)
        told = ', '.join(f'{name} {number}' for name, number in counts.most_common())
        lines.append(f'{kind}: {counts.total()}: {told}')
    lines += ['', *_rates(trials), '', *_sizes(trials), '', *_confusion(trials)]
    times = sorted(item.seconds for item in trials)
    if times:
        lines += ['', f'seconds per verdict: median {times[len(times) // 2]:.0f}, '
                      f'longest {times[-1]:.0f}']
    return '\n'.join(lines)


def _rates(trials: Sequence[Trial]) -> list[str]:
    kinds = {kind: [item for item in trials if item.kind == kind] for kind in KINDS}
    large = [item for item in kinds['single'] if (item.ratio or 0.0) >= TWICE]
    shown, plain = (_pairs_over(kinds['pair'], least) for least in (1.0, TWICE))
    faulty = [item for item in trials if item.kind != 'clean']
    inside = [item for item in kinds['single'] if item.within is not None]
    gains = [item for item in trials
             if item.score == 'right' and item.gain is not None and item.best_gain]
    close = [item for item in gains
             if (item.gain or 0.0) >= 0.9 * (item.best_gain or 0.0)]
    errors = sorted(item.error for item in inside if item.error is not None)

    def share(items: Sequence[Trial], *scores: str) -> str:
        return interval(sum(item.score in scores for item in items), len(items))

    lines = [
        f'false alarms on clean rigs: {share(kinds["clean"], "false")}',
        f'single effects of {TWICE:g} times their limit or more: right {share(large, "right")}, '
        f'unknown {share(large, "unknown")}, missed {share(large, "missed")}',
        f'all single effects: right {share(kinds["single"], "right")}',
        f'wrong names, of all rigs with faults: {share(faulty, "wrong")}',
        f'wrong names, of single effects: {share(kinds["single"], "wrong")}',
        f'outside the catalogue, called unknown: {share(kinds["outside"], "right")}, missed '
        f'{share(kinds["outside"], "missed")}',
        f'pairs: both found {share(kinds["pair"], "right")}, both or one '
        f'{share(kinds["pair"], "right", "part")}',
        f'pairs of effects over their limits: both found {share(shown, "right")}, both or one '
        f'{share(shown, "right", "part")}',
        f'pairs of effects of {TWICE:g} times their limit or more each: both found '
        f'{share(plain, "right")}, both or one {share(plain, "right", "part")}',
        '95 % intervals of the size hold the truth: '
        + interval(sum(bool(item.within) for item in inside), len(inside)),
        'held-out gain at least 0.9 of that of the true extension: '
        + interval(len(close), len(gains)),
    ]
    if errors:
        lines.append(f'relative error of the size: median {errors[len(errors) // 2]:.3f}, nine in '
                     f'ten under {errors[int(0.9 * len(errors))]:.2f} ({len(errors)} sizes)')
    return lines


def _pairs_over(pairs: Sequence[Trial], least: float) -> list[Trial]:
    """Pairs whose effects are both of so many times their limits."""
    return [item for item in pairs
            if item.ratios and all((ratio or 0.0) >= least for ratio in item.ratios)]


def _sizes(trials: Sequence[Trial]) -> list[str]:
    """Found against size: whether the stated detection limits hold."""
    lines = ['single effects by size over the limit stated for where they act: said anything, '
             'right']
    edges = (0.0, 0.5, 1.0, 2.0, 4.0, 8.0, math.inf)
    for low, high in pairwise(edges):
        own = [item for item in trials if item.ratio is not None and low <= item.ratio < high]
        said = sum(item.score != 'missed' for item in own)
        right = sum(item.score == 'right' for item in own)
        lines.append(f'  {low:g} to {high:g}: {interval(said, len(own))}, '
                     f'{interval(right, len(own))}')
    return lines


def _confusion(trials: Sequence[Trial]) -> list[str]:
    """Per hidden effect what was said: rows of single and outside effects."""
    rows: dict[str, Counter[str]] = {}
    for item in trials:
        if item.kind not in ('single', 'outside', 'clean'):
            continue
        hidden = item.hidden[0]['effect'] if item.hidden else 'clean'
        said = ' + '.join(
            group[0] if len(group) == 1 else f'{group[0]} (of {len(group)})'
            for group in item.groups
        )
        if item.verdict in ('none', 'unknown'):
            said = item.verdict
        elif hidden in {name for group in item.groups for name in group}:
            said = said.replace(hidden, 'itself', 1) if item.groups[0][0] == hidden else said
        rows.setdefault(hidden, Counter())[said] += 1
    lines = ['hidden: said (of n: the first of a group of n)']
    for hidden, counts in sorted(rows.items()):
        told = ', '.join(f'{name} {number}' for name, number in counts.most_common())
        lines.append(f'  {hidden}: {told}')
    return lines


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument('--draws', type=int, default=300)
    parser.add_argument('--count', action='append', default=[], metavar='KIND=N',
                        help='so many trials of one kind, instead of --draws')
    parser.add_argument('--seed', type=int, default=20_000, help='seed of the first of each kind')
    parser.add_argument('--out', type=Path, default=Path('out/blind.jsonl'))
    parser.add_argument('--jobs', type=int, default=len(os.sched_getaffinity(0)))
    parser.add_argument('--minutes', type=float, default=math.inf, help='begin nothing later')
    parser.add_argument('--no-best-gain', action='store_true',
                        help='leave out the fits of the true causes')
    parser.add_argument('--table', action='store_true', help='print the table of --out only')
    parser.add_argument('--quick', action='store_true', help='twenty draws')
    args, extra = parser.parse_known_args()
    if not args.table:
        draws = 20 if args.quick else args.draws
        wanted = plan(counts_of(draws, args.count), args.seed)
        campaign(wanted, args.out, args.jobs, args.minutes, tuple(extra),
                 with_best_gain=not args.no_best_gain)
    trials = read_trials(args.out)
    print(table(trials))
    broken = broken_promises([(item.kind, item.score) for item in trials])
    print('\n'.join(['', *(f'BROKEN: {line}' for line in broken)] if broken else
                    ['', 'every promised rate is kept']))
    return 1 if broken else 0


if __name__ == '__main__':
    sys.exit(main())
