"""Changes of dirty rings between two sessions: is what changed named, and nothing else?

    python benchmarks/changes.py [--seeds 1 2 ...] [--effects NAME,NAME | none]

The ring is that of dirty_ring.py. Its many small errors are the same in both sessions, and the
noise of the instruments is new. One cause of the catalogue, or none, appears in the later one. Its
verdict by the later session alone stands beside that of the comparison.
"""

from __future__ import annotations

import os

os.environ.setdefault('SADDLERING_THREADS', '1')

import argparse
from collections import Counter
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


def session(ring: Ring, noise: Noise, fault: Fault, seed: int, first: int, folder: Path) -> list:
    """The bags of one session, read."""
    courses = [course for course in usual_courses(RIG) if course.name in TESTS]
    paths = [write(record(ring, fault, course, 1000 * seed + first + number, noise),
                   first + number, folder) for number, course in enumerate(courses)]
    return [read_bag(path, rig=RIG) for path in paths]


def trial(effect: str, seed: int, folder: Path, counts: Counter[str], alone: bool) -> None:
    """One ring, with one change or none, counted and printed."""
    began = clock.process_time()
    ring, noise = draw_ring(seed)
    fault = fault_of(effect, np.random.default_rng([seed, 12])).fault if effect else Fault()
    before = session(ring, noise, dirty(Fault(), np.random.default_rng([seed, 13])), seed, 0,
                     folder / 'before')
    after = session(ring, noise, dirty(fault, np.random.default_rng([seed, 13])), seed, LATER,
                    folder / 'after')
    document = compare(before, after, rig=RIG).to_json()
    groups = [cause['group'] for cause in document['causes']]
    established = document['verdict'] in ('named', 'ambiguous')
    right = bool(effect) and any(effect in group for group in groups)
    stray = any(effect not in group for group in groups)
    kind = 'changed' if effect else 'unchanged'
    counts[kind] += 1
    counts[f'{kind}: {document["verdict"]}'] += 1
    counts['right'] += established and right and not stray
    counts['wrong name'] += established and (stray or not right)
    ratios = [one['one_session'] / one['limit'] for one in document['detection_limits']
              if one['one_session'] and one['limit']]
    single = diagnose(after, rig=RIG).to_json()['verdict'] if alone else 'not run'
    print(f'{seed} {effect or "none"}: {document["verdict"]} {groups}, alone {single}, limits '
          f'lower by {np.median(ratios):.1f}, {clock.process_time() - began:.0f} s', flush=True)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument('--seeds', nargs='*', type=int, default=[1])
    parser.add_argument('--effects', default=','.join(MAIN))
    parser.add_argument('--alone', action='store_true', help='diagnose the later session too')
    args = parser.parse_args()
    counts: Counter[str] = Counter()
    with tempfile.TemporaryDirectory() as folder:
        for seed in args.seeds:
            for effect in args.effects.split(','):
                trial('' if effect == 'none' else effect, seed, Path(folder), counts, args.alone)
    print(', '.join(f'{name} {count}' for name, count in sorted(counts.items())))


if __name__ == '__main__':
    main()
