"""Verdicts before and after a change that must not alter them: the same bags, two programs.

python benchmarks/unchanged.py draw BAGS [--draws N] [--seed N]   write blind rigs' bags, once
python benchmarks/unchanged.py collect BAGS OUT                    one verdict document a rig
python benchmarks/unchanged.py compare BEFORE AFTER                table of what differs

`collect` runs the `saddlering` command beside the running Python, so that an older checkout can be
measured with this file. A rig whose document is in OUT already is skipped.
"""

from __future__ import annotations

import argparse
from concurrent.futures import ThreadPoolExecutor
import json
import math
import os
from pathlib import Path
import subprocess
import sys
from typing import Any

KINDS = ('clean', 'single', 'pair', 'outside')
SHARES = (0.2, 0.5, 0.15, 0.15)
HELD_OUT = 'dynamic_70'
SHIPPED = Path(__file__).resolve().parent.parent / 'bags'
MAX_SHIFT = 0.1
"""Largest shift of a number that counts as unchanged, in its standard deviations."""


def one_thread() -> dict[str, str]:
    """The environment of a measured process."""
    names = ('OPENBLAS_NUM_THREADS', 'OMP_NUM_THREADS', 'MKL_NUM_THREADS', 'SADDLERING_THREADS')
    return {**os.environ, **dict.fromkeys(names, '1')}


def draw(bags: Path, draws: int, seed: int) -> None:
    """Bags of blind rigs under `bags`, one folder a rig; those that are there stay."""
    for kind, share in zip(KINDS, SHARES, strict=True):
        for number in range(round(draws * share)):
            folder = bags / f'{kind}_{seed + number}'
            if folder.exists():
                continue
            command = [sys.executable, '-m', 'saddlering_ros.virtual_rig.blind', '--kind', kind]
            command += ['--seed', str(seed + number), '--out', str(folder)]
            subprocess.run(command, check=True, stdout=subprocess.DEVNULL, env=one_thread())


def collect(bags: Path, out: Path, jobs: int) -> None:
    """Verdict documents of every rig under `bags`, and of the shipped bags."""
    out.mkdir(parents=True, exist_ok=True)
    rigs = [*sorted(path for path in bags.iterdir() if path.is_dir()), SHIPPED]
    with ThreadPoolExecutor(jobs) as pool:
        for line in pool.map(lambda rig: _verdict(rig, out), rigs):
            if line:
                print(line, flush=True)


def _verdict(rig: Path, out: Path) -> str:
    document = out / f'{rig.name}.json'
    if document.exists():
        return ''
    runs = sorted(path for path in rig.iterdir() if (path / 'metadata.yaml').exists())
    fitted = [str(path) for path in runs if path.name != HELD_OUT]
    held_out = [str(path) for path in runs if path.name == HELD_OUT]
    command = [str(Path(sys.executable).with_name('saddlering')), 'diagnose', *fitted]
    command += ['--hold-out', *held_out, '--seed', '0', '--json', str(document)]
    done = subprocess.run(command, capture_output=True, text=True, env=one_thread())
    return '' if done.returncode == 0 else f'{rig.name}: {done.stderr.strip()}'


def compare(before: Path, after: Path) -> int:
    """Print what differs between two folders of documents; the number of rigs that differ."""
    names = sorted({path.name for path in before.glob('*.json')})
    differing, largest = 0, 0.0
    for name in names:
        if not (after / name).exists():
            print(f'{name}: not in {after}')
            differing += 1
            continue
        old, new = (json.loads((folder / name).read_text()) for folder in (before, after))
        notes, shift = differences(old, new)
        largest = max(largest, shift)
        differing += bool(notes)
        if notes:
            print(f'{name}: ' + '; '.join(notes))
    print(f'{len(names)} rigs, {differing} differ; largest shift of a number {largest:.3g} '
          'standard deviations')
    return differing


def differences(old: dict[str, Any], new: dict[str, Any]) -> tuple[list[str], float]:
    """Sentences on what differs, and the largest shift in standard deviations."""
    notes = []
    if old['verdict'] != new['verdict']:
        notes.append(f'verdict {old["verdict"]} -> {new["verdict"]}')
    groups = [[tuple(cause.get('group', ())) for cause in item['causes']] for item in (old, new)]
    if sorted(groups[0]) != sorted(groups[1]):
        notes.append(f'causes {groups[0]} -> {groups[1]}')
    shifts = []
    matching = {cause.get('effect'): cause for cause in new['causes']}
    for cause in old['causes']:
        other = matching.get(cause.get('effect'))
        for name, number in (cause.get('parameters') or {}).items():
            if other and name in other['parameters'] and number['std']:
                apart = abs(number['value'] - other['parameters'][name]['value'])
                shifts.append((apart / number['std'], f'{cause["effect"]}.{name}'))
    base_old, base_new = (item['parameters']['after'] for item in (old, new))
    for name in base_old:
        std = base_old.get(f'{name}_std')
        if std:
            shifts.append((abs(base_old[name] - base_new[name]) / std, name))
    notes += [f'{name} moved by {shift:.2f} standard deviations'
              for shift, name in shifts if shift > MAX_SHIFT or math.isnan(shift)]
    return notes, max((shift for shift, _ in shifts), default=0.0)


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    steps = parser.add_subparsers(dest='step', required=True)
    own = steps.add_parser('draw')
    own.add_argument('bags', type=Path)
    own.add_argument('--draws', type=int, default=60)
    own.add_argument('--seed', type=int, default=150_000)
    own = steps.add_parser('collect')
    own.add_argument('bags', type=Path)
    own.add_argument('out', type=Path)
    own.add_argument('--jobs', type=int, default=len(os.sched_getaffinity(0)))
    own = steps.add_parser('compare')
    own.add_argument('before', type=Path)
    own.add_argument('after', type=Path)
    args = parser.parse_args()
    if args.step == 'draw':
        draw(args.bags, args.draws, args.seed)
    elif args.step == 'collect':
        collect(args.bags, args.out, args.jobs)
    else:
        return min(compare(args.before, args.after), 1)
    return 0


if __name__ == '__main__':
    sys.exit(main())
