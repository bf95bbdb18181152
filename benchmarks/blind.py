"""Blind trials: another process draws and seals, the diagnosis sees bags, then the seal opens.

python benchmarks/blind.py [--clean N] [--single N] [--pair N] [--outside N] [--seed S] prints one
line per trial and the table of rates; --json FILE keeps every trial.
"""

# ruff: noqa: E402
from __future__ import annotations

import os

for _name in ('OPENBLAS_NUM_THREADS', 'OMP_NUM_THREADS', 'MKL_NUM_THREADS'):
    os.environ.setdefault(_name, '1')

import argparse
from collections import Counter
from dataclasses import asdict, dataclass
import json
from pathlib import Path
import shutil
import subprocess
import sys
import tempfile
from typing import Any

from saddlering_ros.diagnosis import diagnose_bags
from saddlering_ros.virtual_rig.blind import open_seal, SEALED

KINDS = ('clean', 'single', 'pair', 'outside')
LARGEST_GROUP = 4


@dataclass(frozen=True)
class Trial:
    """One blind trial: what was hidden, what was said, how it counts."""

    kind: str
    seed: int
    hidden: list[dict[str, Any]]
    verdict: str
    groups: list[list[str]]
    score: str
    found: int
    estimates: list[dict[str, Any]]
    seconds: float


def score(kind: str, hidden: list[str], verdict: str, groups: list[list[str]]) -> tuple[str, int]:
    """How a verdict counts, and how many hidden effects are in its groups.

    right: every group holds a hidden effect, none is larger than four, and all effects are found;
    part: the same with some not found; wrong: a single name that is not hidden; missed: `none` for
    something; false: anything on a clean rig; vague: groups too large or that miss.
    """
    found = sum(any(name in group for group in groups) for name in hidden)
    if kind == 'clean':
        return ('right' if verdict == 'none' else 'false'), 0
    if verdict == 'none':
        return 'missed', 0
    if verdict == 'unknown':
        return ('right' if kind == 'outside' else 'unknown'), found
    if kind == 'outside':
        return 'wrong', 0
    strays = [group for group in groups if not any(name in group for name in hidden)]
    if strays:
        return ('wrong' if any(len(group) == 1 for group in strays) else 'vague'), found
    if any(len(group) > LARGEST_GROUP for group in groups):
        return 'vague', found
    return ('right' if found == len(hidden) else 'part'), found


def trial(kind: str, seed: int, extra: tuple[str, ...] = ()) -> Trial:
    """Draw, seal, diagnose, open, score."""
    folder = Path(tempfile.mkdtemp(prefix='blind_'))
    try:
        drawn = subprocess.run(
            [
                sys.executable,
                '-m',
                'saddlering_ros.virtual_rig.blind',
                '--seed',
                str(seed),
                '--kind',
                kind,
                '--out',
                str(folder / 'rig'),
                *extra,
            ],
            check=True,
            capture_output=True,
            text=True,
        )
        told = json.loads(drawn.stdout.strip().splitlines()[-1])
        answer = diagnose_bags(told['bags'], seed=seed).to_json()
        truth = open_seal(folder / 'rig' / SEALED, told['seal'])
    finally:
        shutil.rmtree(folder, ignore_errors=True)
    causes = [cause for cause in answer['causes'] if 'effect' in cause]
    groups = [cause['group'] for cause in causes]
    names = [item['effect'] for item in truth['effects']]
    verdict = answer['verdict']
    counted, found = score(kind, names, verdict, groups)
    estimates = [{cause['effect']: cause['parameters'], 'gain': cause['gain']} for cause in causes]
    return Trial(
        kind, seed, truth['effects'], verdict, groups, counted, found, estimates, answer['seconds']
    )


def table(trials: list[Trial]) -> str:
    """Rates by kind, then by effect."""
    lines = []
    for kind in KINDS:
        own = [item for item in trials if item.kind == kind]
        if own:
            counts = Counter(item.score for item in own)
            told = ', '.join(f'{name} {number}' for name, number in counts.most_common())
            lines.append(f'{kind}: {len(own)} trials: {told}')
    effects: dict[str, Counter[str]] = {}
    for item in trials:
        if item.kind == 'single':
            effects.setdefault(item.hidden[0]['effect'], Counter())[item.score] += 1
    for name, counts in sorted(effects.items()):
        lines.append(f'  {name}: ' + ', '.join(f'{key} {n}' for key, n in counts.most_common()))
    if trials:
        times = sorted(item.seconds for item in trials)
        lines.append(
            f'seconds per verdict: median {times[len(times) // 2]:.0f}, longest {times[-1]:.0f}'
        )
    return '\n'.join(lines)


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__)
    for kind, count in zip(KINDS, (60, 160, 40, 40), strict=True):
        parser.add_argument(f'--{kind}', type=int, default=count, metavar='N')
    parser.add_argument('--seed', type=int, default=1)
    parser.add_argument('--json', type=Path)
    args, extra = parser.parse_known_args()
    trials: list[Trial] = []
    for kind in KINDS:
        for number in range(getattr(args, kind)):
            done = trial(kind, args.seed + number, tuple(extra))
            trials.append(done)
            hidden = [(item['effect'], item['form'], item['parameters']) for item in done.hidden]
            print(
                f'{kind} {done.seed}: {done.score}: {hidden} -> {done.verdict} {done.groups} '
                f'{done.seconds:.0f} s',
                flush=True,
            )
            if args.json:
                args.json.write_text(json.dumps([asdict(item) for item in trials], indent=1))
    print(table(trials))
    return 0


if __name__ == '__main__':
    sys.exit(main())
