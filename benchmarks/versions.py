"""What differs between two versions: verdicts, parameters and processor time of the same bags?

    python benchmarks/versions.py --before DIR [--draws 60] [--seed 150000] [--rounds 1]

DIR is another checkout of the repository. Blind rigs are drawn once into out/versions. Both
versions identify and diagnose the bags of each, and the shipped ones, in turn and each in a
process of its own on one thread; the least of the rounds counts. Start and reading are part of
the time. Without --before the times of this version alone are printed. A number is unchanged if it
moves by less than a tenth of its standard deviation. The second table states what an `unknown`
verdict takes beside a name. Status 1 if anything differs.
"""

import json
import math
from pathlib import Path
import shutil
import statistics
import sys
from typing import Any

from frame import arguments, ONE_THREAD, ROOT, run, table

SHARES = {'clean': 0.2, 'single': 0.5, 'pair': 0.15, 'outside': 0.15}
HELD_OUT = 'dynamic_70'
MAX_SHIFT = 0.1
"""Largest shift of a number that counts as unchanged, in its standard deviations."""

START = ('import sys; sys.path.insert(0, sys.argv.pop(1)); '
         'from saddlering_ros.cli.main import main; sys.exit(main(sys.argv[1:]))')
OUT = ROOT / 'out' / 'versions'


def drawn_rigs(draws: int, seed: int) -> list[Path]:
    """Folders with the bags of blind rigs; those that are there stay."""
    folders = []
    for kind, share in SHARES.items():
        for number in range(round(draws * share)):
            folders.append(OUT / 'bags' / f'{kind}_{seed + number}')
            if not folders[-1].exists():
                run([str(ROOT / 'benchmarks' / 'examiner.py'), '--kind', kind, '--seed',
                     str(seed + number), '--out', str(folders[-1])], **ONE_THREAD)
    return folders


def answers(tree: Path, rig: Path, out: Path) -> tuple[dict[str, float], dict[str, Any]]:
    """Processor seconds by command, and the verdict, of one version on one rig."""
    bags = sorted(path for path in rig.iterdir() if (path / 'metadata.yaml').exists())
    fitted = [str(bag) for bag in bags if bag.name != HELD_OUT]
    held_out = [str(bag) for bag in bags if bag.name == HELD_OUT]
    commands = {
        'identify': [*fitted, '--seed', '0', '--out', str(out / 'parameters.yaml')],
        'diagnose': [*fitted, '--hold-out', *held_out, '--seed', '0', '--json',
                     str(out / 'verdict.json')]}
    seconds = {name: run(['-c', START, str(tree), name, *words], **ONE_THREAD).processor
               for name, words in commands.items()}
    return seconds, json.loads((out / 'verdict.json').read_text())


def differences(old: dict[str, Any], new: dict[str, Any]) -> list[str]:
    """What differs between two verdicts."""
    notes = []
    if old['verdict'] != new['verdict']:
        notes.append(f'verdict {old["verdict"]} -> {new["verdict"]}')
    groups = [sorted(tuple(cause.get('group', ())) for cause in item['causes'])
              for item in (old, new)]
    if groups[0] != groups[1]:
        notes.append(f'causes {groups[0]} -> {groups[1]}')
    shifts = []
    matching = {cause.get('effect'): cause for cause in new['causes']}
    for cause in old['causes']:
        other = matching.get(cause.get('effect'))
        for name, number in (cause.get('parameters') or {}).items():
            if other and name in other['parameters'] and number['std']:
                apart = abs(number['value'] - other['parameters'][name]['value'])
                shifts.append((f'{cause["effect"]}.{name}', apart / number['std']))
    before, after = (item['parameters']['after'] for item in (old, new))
    shifts += [(name, abs(value - after[name]) / before[f'{name}_std'])
               for name, value in before.items() if before.get(f'{name}_std')]
    return notes + [f'{name} moved by {shift:.2f} standard deviations'
                    for name, shift in shifts if shift > MAX_SHIFT or math.isnan(shift)]


def main() -> int:
    args = arguments(__doc__, {'draws': 0}, before=Path, draws=60, seed=150_000, rounds=1)
    trees = {'now': ROOT} if args.before is None else {'before': args.before, 'now': ROOT}
    total: dict[tuple[str, str], float] = {}
    by_verdict: dict[tuple[str, str], list[float]] = {}
    rigs, differing = [*drawn_rigs(args.draws, args.seed), ROOT / 'bags'], 0
    for rig in rigs:
        least: dict[tuple[str, str], float] = {}
        verdicts = {}
        for _ in range(args.rounds):
            for version, tree in trees.items():
                out = OUT / version
                shutil.rmtree(out, ignore_errors=True)
                out.mkdir(parents=True)
                seconds, verdicts[version] = answers(tree.resolve(), rig, out)
                for command, spent in seconds.items():
                    key = (command, version)
                    least[key] = min(spent, least.get(key, math.inf))
        notes = differences(verdicts['before'], verdicts['now']) if args.before else []
        differing += bool(notes)
        print(f'{rig.name}: {verdicts["now"]["verdict"]}; {"; ".join(notes) or "alike"}',
              flush=True)
        for version, verdict in verdicts.items():
            by_verdict.setdefault((version, verdict['verdict']), []).append(
                least['diagnose', version])
        for key, spent in least.items():
            total[key] = total.get(key, 0.0) + spent
    table(f'{len(rigs)} rigs, {differing} differ; processor time with start and reading',
          ('command', 'version', 'time [s]', 'ratio'),
          [(command, version, seconds, seconds / total[command, next(iter(trees))])
           for (command, version), seconds in total.items()])
    medians = {key: statistics.median(times) for key, times in by_verdict.items()}
    table('diagnose by verdict', ('version', 'verdict', 'rigs', 'median [s]', 'over a name'),
          [(version, verdict, len(times), medians[version, verdict],
            medians[version, verdict] / medians.get((version, 'named'), math.nan))
           for (version, verdict), times in by_verdict.items()])
    return 1 if differing else 0


if __name__ == '__main__':
    sys.exit(main())
