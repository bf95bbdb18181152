"""Changes of dirty rings between two sessions: is what changed named, and nothing else?

    python benchmarks/changes.py [--seeds 1 2 ...] [--effects NAME,NAME | none] [--near] [--alone]

The ring is that of dirty_ring.py. Its many small errors are the same in both sessions, and the
noise of the instruments is new. One cause of the catalogue, or none, appears in the later one, at
a third of the size that one session names. --near: at 0.8 to 1.5 times the smallest change that an
unchanged pair of the ring could show instead. The errors of the sizes are stated in standard
deviations, positive if a size is too large. --alone: the verdict by the later session alone stands
beside that of the comparison.
"""

from __future__ import annotations

import os

os.environ.setdefault('SADDLERING_THREADS', '1')

import argparse
from collections import Counter
from dataclasses import dataclass, field
from functools import cache
from pathlib import Path
import tempfile
import time as clock

from dirty_ring import dirty, MAIN
from independent import draw_ring, RIG, write
from independent_faults import fault_of
from independent_ring import Fault, Noise, record, Ring, usual_courses
import numpy as np

from saddlering_ros import compare, diagnose, read_bag

TESTS = ('static_50', 'dynamic_50', 'static_70')
LATER = 40
"""Number of the first bag of the later session: a quarter of an hour each."""


@dataclass
class Scores:
    """Numbers of verdicts, and the errors of sizes in standard deviations."""

    counts: Counter[str] = field(default_factory=Counter)
    errors: list[float] = field(default_factory=list)


def session(ring: Ring, noise: Noise, fault: Fault, seed: int, first: int, folder: Path) -> list:
    """The bags of one session, read."""
    courses = [course for course in usual_courses(RIG) if course.name in TESTS]
    paths = [write(record(ring, fault, course, 1000 * seed + first + number, noise),
                   first + number, folder) for number, course in enumerate(courses)]
    return [read_bag(path, rig=RIG) for path in paths]


def dirt_of(fault: Fault, seed: int) -> Fault:
    """The fault on the dirty ring of a seed."""
    return dirty(fault, np.random.default_rng([seed, 13]))


@cache
def limits(seed: int) -> dict[str, float]:
    """The smallest change of each cause that is named, from an unchanged pair of a ring."""
    ring, noise = draw_ring(seed)
    with tempfile.TemporaryDirectory() as folder:
        own = dirt_of(Fault(), seed)
        pair = [session(ring, noise, own, seed, first, Path(folder) / str(first))
                for first in (0, 10 * LATER)]
        found = compare(*pair, rig=RIG).change.diagnosis
    return {item.effect: max(item.limit, item.material_limit)
            for item in found.observability.limits}


def share_of(effect: str, seed: int, near: bool) -> float:
    """Share of the size that one session names at which the cause is hidden."""
    if not near:
        return 1.0 / 3.0
    whole = next(iter(fault_of(effect, np.random.default_rng([seed, 12])).parameters.values()))
    times = np.random.default_rng([seed, 21, MAIN.index(effect)]).uniform(0.8, 1.5)
    return float(times * limits(seed)[effect] / abs(whole))


def trial(effect: str, seed: int, folder: Path, scores: Scores, args: argparse.Namespace) -> None:
    """One ring, with one change or none, counted and printed."""
    began = clock.process_time()
    ring, noise = draw_ring(seed)
    hidden = fault_of(effect, np.random.default_rng([seed, 12]),
                      share_of(effect, seed, args.near)) if effect else None
    before = session(ring, noise, dirt_of(Fault(), seed), seed, 0, folder / 'before')
    after = session(ring, noise, dirt_of(hidden.fault if hidden else Fault(), seed), seed, LATER,
                    folder / 'after')
    document = compare(before, after, rig=RIG).to_json()
    groups = [cause['group'] for cause in document['causes']]
    established = document['verdict'] in ('named', 'ambiguous')
    right = bool(effect) and any(effect in group for group in groups)
    stray = any(effect not in group for group in groups)
    kind, counts = 'changed' if effect else 'unchanged', scores.counts
    counts[kind] += 1
    counts[f'{kind}: {document["verdict"]}'] += 1
    counts['right'] += established and right and not stray
    counts['wrong name'] += established and (stray or not right)
    said = ''
    if hidden and established and document['causes'][0]['effect'] == effect:
        true = next(iter(hidden.parameters.values()))
        size = next(iter(document['causes'][0]['parameters'].values()))
        scores.errors.append((size['value'] - true) * np.sign(true) / size['std'])
        said = f', found {size["value"] / true:.3f} of the size, {scores.errors[-1]:+.2f} std'
    ratios = [one['one_session'] / one['limit'] for one in document['detection_limits']
              if one['one_session'] and one['limit']]
    single = diagnose(after, rig=RIG).to_json()['verdict'] if args.alone else 'not run'
    print(f'{seed} {effect or "none"}: {document["verdict"]} {groups}{said}, alone {single}, '
          f'limits lower by {np.median(ratios):.1f}, {clock.process_time() - began:.0f} s',
          flush=True)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument('--seeds', nargs='*', type=int, default=[1])
    parser.add_argument('--effects', default=','.join(MAIN))
    parser.add_argument('--alone', action='store_true', help='diagnose the later session too')
    parser.add_argument('--near', action='store_true', help='sizes near the detection limit')
    args = parser.parse_args()
    scores = Scores()
    with tempfile.TemporaryDirectory() as folder:
        for seed in args.seeds:
            for effect in args.effects.split(','):
                trial('' if effect == 'none' else effect, seed, Path(folder), scores, args)
    print(', '.join(f'{name} {count}' for name, count in sorted(scores.counts.items())))
    if scores.errors:
        errors = np.array(scores.errors)
        print(f'{errors.size} sizes: median error {np.median(errors):+.2f} std, rms '
              f'{np.sqrt(np.mean(errors**2)):.2f}, beyond two {np.mean(np.abs(errors) > 2.0):.0%}')


if __name__ == '__main__':
    main()
