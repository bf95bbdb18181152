"""Simulated next tests against full diagnoses with the test made.

python benchmarks/next_test.py [--seeds N,N] [--kind single|pair] [--out FILE.jsonl] draws virtual
rigs, diagnoses them, and where the verdict is `ambiguous` makes the best proposed test that the
virtual rig can make (a ramp, two cycles, or a static test at another elevation). All bags are then
diagnosed again: the true cause should be alone, as often as the verdict stated.
"""

from __future__ import annotations

import os

os.environ.setdefault('SADDLERING_THREADS', '1')

import argparse
from dataclasses import asdict, dataclass
import json
import math
from pathlib import Path
import re
import sys
import tempfile

from saddlering_ros.diagnosis import diagnose_bags, Verdict
from saddlering_ros.rig import default_rig, TONNE
from saddlering_ros.virtual_rig import PhysicalRig, record_test, static_schedule, write_record
from saddlering_ros.virtual_rig.campaign import draw_truth, Truth, write_campaign
from saddlering_ros.virtual_rig.recording import EPOCH, TestPlan
from saddlering_ros.virtual_rig.schedule import Schedule

HELD_OUT = 'dynamic_70'
RIG = default_rig()


@dataclass(frozen=True)
class Check:
    """One group: what was hidden, the test, the stated shares, and the group after the test.

    share_alone: over all members of the group as the truth; share_of_truth: with the hidden
    effects as the truth, if they are a member.
    """

    seed: int
    hidden: list[str]
    group: list[list[str]]
    test: str
    share_alone: float
    share_of_truth: float | None
    after: str
    group_after: list[list[str]]

    @property
    def is_alone(self) -> bool:
        """Whether the true causes alone are left."""
        return sorted(name for own in self.group_after for name in own) == sorted(self.hidden)


def schedule_of(test: str) -> Schedule | None:
    """The course of a proposed test; None for a test that the virtual rig cannot make."""
    full, low = RIG.full_scale_load, RIG.preload
    if 'slow ramp' in test:
        return Schedule('dynamic', full, low, TONNE, 0.0, 30.0, 2.0, 1, 0.0)
    if 'fast ramp' in test:
        return Schedule('dynamic', full, low, TONNE, 0.0, 1.5, 2.0, 1, 0.0)
    if 'two cycles' in test:
        return Schedule('dynamic', full, low, TONNE, 30.0, 5.0, 2.0, 2, 0.0)
    if test.startswith('Repeat the static test at '):
        return static_schedule(RIG)
    return None


def made(truth: Truth, test: str, folder: Path) -> Path:
    """The bag of a proposed test on the rig of `truth`."""
    schedule = schedule_of(test)
    found = re.search(r'at ([0-9.]+) deg', test)
    if schedule is None or found is None:
        raise ValueError(f'{test}: the virtual rig cannot make this test')
    angle = math.radians(float(found.group(1).rstrip('.')))
    physical = PhysicalRig(RIG, truth.contact, angle, truth.effects, truth.scatter, truth.seed)
    rate = 25.0 if schedule.test == 'static' else 1000.0 if schedule.duration < 20.0 else 100.0
    plan = TestPlan(physical, schedule, truth.seed + 1, truth.instruments, rate,
                    begin=EPOCH + 50_000, run_name='next')
    return write_record(folder / 'next', record_test(plan), RIG)


def check(kind: str, seed: int, folder: Path) -> Check | None:
    """One draw; None if its verdict is not `ambiguous`."""
    truth = draw_truth(seed, kind)
    bags = write_campaign(truth, folder)
    held = [bag for bag in bags if bag.name == HELD_OUT]
    fitted = [bag for bag in bags if bag not in held]
    first = diagnose_bags(fitted, held, seed=seed)
    if first.verdict != 'ambiguous':
        return None
    possible = [item for item in first.diagnosis.separations
                if schedule_of(item.proposal.sentence) is not None]
    best = possible[0]
    again = diagnose_bags([*fitted, made(truth, best.proposal.sentence, folder)], held, seed=seed)
    hidden = [item.effect.id for item in truth.effects]
    of_truth = [share for names, share in best.by_truth.items() if set(names) == set(hidden)]
    return Check(seed, hidden, _groups(first), best.proposal.sentence, best.share,
                 of_truth[0] if of_truth else None, again.verdict, _groups(again))


def _groups(verdict: Verdict) -> list[list[str]]:
    return [list(cause.group) for cause in verdict.diagnosis.causes]


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument('--seeds', default='340000,340001,340002,340003')
    parser.add_argument('--kind', default='single')
    parser.add_argument('--out', type=Path, default=Path('out/next_test.jsonl'))
    args = parser.parse_args()
    args.out.parent.mkdir(parents=True, exist_ok=True)
    stated = alone = count = 0.0
    for seed in map(int, args.seeds.split(',')):
        with tempfile.TemporaryDirectory(prefix='next_') as folder:
            found = check(args.kind, seed, Path(folder))
        if found is None:
            print(f'{seed}: not ambiguous', flush=True)
            continue
        with args.out.open('a') as kept:
            kept.write(json.dumps(asdict(found)) + '\n')
        print(f'{seed}: {found}: alone {found.is_alone}', flush=True)
        stated, alone, count = stated + found.share_alone, alone + found.is_alone, count + 1
    print(f'{count:g} groups: stated {stated:.1f}, left alone {alone:g}')
    return 0


if __name__ == '__main__':
    sys.exit(main())
