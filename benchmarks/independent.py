"""Verdicts on rings of an independent simulator: right, and are laws proposed for nameless faults?

    python benchmarks/independent.py [--seed 440000] [--kinds outside clean single axial]
                                     [--clean 5] [--only NAME 440203] [--out FILE.jsonl] [--table]

Rings of benchmarks/independent_ring.py: sound ones, every effect of the catalogue once, every law
of independent_faults.OUTSIDE once. For a law outside the catalogue the proposal is compared with
the truth, its file is put into the catalogue, and fresh tests of the same ring are diagnosed with
it. The kind removed is the single ones with their laws taken out of the catalogue. --only takes
names and seeds; --table prints the table of FILE.
"""

import os

os.environ.setdefault('SADDLERING_THREADS', '1')

from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
import sys
import tempfile
import time
from typing import Any

from blind import size_over_limit, without
from examiner import score
from frame import arguments, keep, kept_rows, share
from independent_faults import EFFECTS, fault_of, OUTSIDE
import independent_ring
from independent_ring import Course, Fault, Noise, Record, record, Ring, Sliders, usual_courses
import numpy as np
from rigs import RIG

from saddlering_ros import diagnose
from saddlering_ros.bags.write import write_bag
from saddlering_ros.diagnosis import Verdict
from saddlering_ros.diagnosis.proposed_law import write_effect_files
from saddlering_ros.effects import FOLDER_VARIABLE, use_folder
from saddlering_ros.record.record import TestMetadata

BEGIN = 1_800_000_000_000_000_000
"""Stamp [ns] of the first record."""

AXIAL, AXIAL_TRAVEL, AXIAL_DRAWS = 1.0, 3e-6, 3
"""The choice of axial friction in the catalogue, its mean travel [m] here, and how many draws."""

TWICE = 2.0
MIN_REDUCTION = 0.8
"""Share of the reduction by the true law that a proposal should reach on a held-out run."""


@dataclass(frozen=True)
class Case:
    """One ring: what was hidden, the verdict and its score.

    For laws outside the catalogue: law of the proposal, whether channel and coordinate are right,
    held-out reductions by the proposal and by the truth, doubts, and the verdict on fresh
    data with the proposal in the catalogue.
    """

    kind: str
    seed: int
    hidden: str
    verdict: str
    groups: list[list[str]]
    score: str
    ratio: float | None = None
    seconds: float = 0.0
    law: str = ''
    is_right: bool = False
    reduction: float | None = None
    true_reduction: float | None = None
    doubts: Sequence[str] = ()
    round_trip: str = ''
    round_trip_groups: Sequence[Sequence[str]] = ()
    is_named: bool = False


def draw_ring(seed: int) -> tuple[Ring, Noise]:
    """Contact and instruments of one rig."""
    draw = np.random.default_rng([seed, 11])
    stiff = np.exp(draw.uniform(-0.25, 0.25, 2)) * 1.29e8
    bent = draw.uniform(1.06, 1.16, 2)
    damping = np.exp(draw.uniform(-0.7, 0.7, 2)) * 3e6
    ring = Ring(stiff[0], bent[0], damping[0], stiff[1], bent[1], damping[1],
                float(draw.uniform(0.0, 0.015)), seed)
    noise = Noise(float(draw.uniform(20.0, 60.0)), float(draw.uniform(0.6e-7, 1.6e-7)),
                  float(draw.uniform(1e-8, 4e-8)), float(draw.uniform(0.1, 0.8)))
    return ring, noise


def write(own: Record, number: int, folder: Path) -> Path:
    """One run as a bag."""
    course = own.course
    begin = BEGIN + 900_000_000_000 * number

    def stamps(seconds: np.ndarray) -> np.ndarray:
        return begin + np.round(1e9 * seconds).astype(np.int64)

    gaps = [1e-3 + own.d[:, probe] for probe in range(4)]
    facts = TestMetadata(course.test, course.degrees, 'independent', course.name,
                      details={'rig_hash': RIG.digest})
    return write_bag(folder / course.name, facts, stamps(own.time), own.load,
                     [stamps(item) for item in own.probe_times], gaps, RIG.probes,
                     log_delay=300_000, overwrite=True)


def verdict_on(ring: Ring, noise: Noise, fault: Fault, courses: Sequence[Course], seed: int,
               folder: Path) -> Verdict:
    """Write every course and diagnose; the last is held out."""
    bags = [write(record(ring, fault, course, seed + 31 * number, noise), number, folder)
            for number, course in enumerate(courses)]
    return diagnose(bags[:-1], hold_out=bags[-1:], seed=seed).found


def groups_of(verdict: Verdict) -> list[list[str]]:
    """Ids of each cause's group."""
    return [list(cause.group) for cause in verdict.diagnosis.causes]


def true_reduction(faulty: Verdict, sound: Verdict) -> float:
    """Reduction on the held-out run if the model knew the fault: what the sound twin leaves."""
    run = faulty.runs[-1].record.run
    after, before = (
        faulty.diagnosis.fits.metric.problem.squared_misfit(
            [run], [one.runs[-1].record.run.channels - one.diagnosis.runs[-1].before])
        for one in (sound, faulty))
    return float(1.0 - np.sqrt(after / before))


def single(effect: str, seed: int, folder: Path) -> Case:
    """One effect; no ratio if it is not in the catalogue."""
    ring, noise = draw_ring(seed)
    hidden = fault_of(effect, np.random.default_rng([seed, 12]))
    verdict = verdict_on(ring, noise, hidden.fault, usual_courses(RIG), seed, folder)
    answer: dict[str, Any] = {**verdict.to_json()}
    return judged('single', seed, effect, [effect], verdict,
                  ratio=size_over_limit(hidden.to_json(), answer['detection_limits']))


def axial(_: str, seed: int, folder: Path) -> Case:
    """Friction against axial motion alone, of twice the limit that a sound twin states."""
    ring, noise = draw_ring(seed)
    sound: dict[str, Any] = {
        **verdict_on(ring, noise, Fault(), usual_courses(RIG), seed, folder / 'sound').to_json()}
    places = next(item['places'] for item in sound['detection_limits']
                  if item['effect'] == 'tilt_friction')
    limit = next(place['limit'] for place in places if place['values'].get('coordinate') == AXIAL)
    force = TWICE * limit  # A moment at 1 m from the axis.
    fault = Fault(friction_y=Sliders(force, AXIAL_TRAVEL))
    verdict = verdict_on(ring, noise, fault, usual_courses(RIG), seed, folder / 'faulty')
    return judged('axial', seed, f'tilt_friction, axial, {force:.0f} N', ['tilt_friction'],
                  verdict, ratio=TWICE)


def clean(_: str, seed: int, folder: Path) -> Case:
    """A sound ring."""
    ring, noise = draw_ring(seed)
    verdict = verdict_on(ring, noise, Fault(), usual_courses(RIG), seed, folder)
    law = verdict.diagnosis.law
    return judged('clean', seed, '', [], verdict, law='' if law is None else law.terms[0].law)


def outside(name: str, seed: int, folder: Path) -> Case:
    """A law that the catalogue does not have: verdict, proposal, round trip."""
    law = next(law for law in OUTSIDE if law.name == name)
    ring, noise = draw_ring(seed)
    fault = law.fault(np.random.default_rng([seed, 12]))
    faulty = verdict_on(ring, noise, fault, usual_courses(RIG), seed, folder / 'faulty')
    sound = verdict_on(ring, noise, Fault(), usual_courses(RIG), seed, folder / 'sound')
    answer: dict[str, Any] = {**faulty.to_json()}
    proposal, more = answer['proposal'], {}
    if proposal:
        more = {'law': ' + '.join(f'{term["channel"]}/{term["coordinate"]}/{term["law"]}'
                                  for term in proposal['terms']),
                'is_right': proposal['channel'] in law.channels
                and proposal['coordinate'] in law.coordinates,
                'reduction': proposal['gain']['held_out'], 'doubts': proposal['doubts'],
                **round_trip(faulty, ring, noise, fault, seed, folder)}
    return judged('outside', seed, name, [], faulty, true_reduction=true_reduction(faulty, sound),
                  **more)


def judged(kind: str, seed: int, hidden: str, names: Sequence[str], verdict: Verdict,
           **more: Any) -> Case:
    """A case with its score."""
    groups = groups_of(verdict)
    counted = score('single' if names else kind, names, verdict.verdict, groups)[0]
    return Case(kind, seed, hidden, verdict.verdict, groups, counted, **more)


def round_trip(faulty: Verdict, ring: Ring, noise: Noise, fault: Fault, seed: int,
               folder: Path) -> dict[str, Any]:
    """Fresh tests of the same ring, diagnosed with the proposed files in the catalogue."""
    law = faulty.diagnosis.law
    files = write_effect_files(law, folder / 'effects', RIG.full_scale_load) if law else []
    if not files:
        return {'round_trip': 'no file'}
    use_folder(folder / 'effects')
    try:
        fresh = verdict_on(ring, noise, fault, independent_ring.other_courses(RIG), seed + 500_000,
                           folder / 'fresh')
    finally:
        os.environ.pop(FOLDER_VARIABLE, None)
    names = [path.stem for path in files]
    groups = groups_of(fresh)
    return {'round_trip': fresh.verdict, 'round_trip_groups': groups,
            'is_named': fresh.verdict == 'named' and all(
                group[0] in names for group in groups) and bool(groups)}


def line_of(case: Case) -> str:
    """One case in one line."""
    said = ' + '.join('|'.join(group) for group in case.groups)
    ratio = '' if case.ratio is None else f' ({case.ratio:.1f} x limit)'
    line = f'{case.kind} {case.seed}: {case.score}: {case.hidden or "-"}{ratio} -> '
    line += f'{case.verdict} {said}'
    if case.kind == 'outside':
        known = '' if case.true_reduction is None else f' of {case.true_reduction:.2f}'
        found = 'none' if case.reduction is None else f'{case.reduction:.2f}'
        line += (f'; proposal {case.law or "none"} right {case.is_right}, held out {found}{known},'
                 f' {len(case.doubts)} doubts; fresh: {case.round_trip} '
                 f'{" + ".join("|".join(group) for group in case.round_trip_groups)}')
    return f'{line} {case.seconds:.0f} s'


def report(cases: Sequence[Case]) -> None:
    """Print every rate."""
    singles = [case for case in cases if case.kind in ('single', 'axial')]
    sound = [case for case in cases if case.kind == 'clean']
    laws = [case for case in cases if case.kind == 'outside']
    near = [case for case in laws if case.reduction is not None and case.true_reduction]
    print('sound rings none:', share(case.score == 'right' for case in sound),
          'with a proposal:', sum(bool(case.law) for case in sound))
    for least, words in ((1.0, 'their limit'), (TWICE, 'twice their limit')):
        print(f'effects over {words} right:', share(
            case.score == 'right' for case in singles if (case.ratio or 0.0) >= least))
    print('wrong names:', share(case.score == 'wrong' for case in [*singles, *laws]))
    print('outside the catalogue unknown:', share(case.score == 'right' for case in laws))
    print('true law taken out, established:', share(
        case.verdict in ('named', 'ambiguous') for case in cases if case.kind == 'removed'))
    print('right channel and coordinate:', share(case.is_right for case in laws))
    print(f'reduction at least {MIN_REDUCTION} of that of the truth:', share(
        (case.reduction or 0.0) >= MIN_REDUCTION * (case.true_reduction or 0.0) for case in near))
    print('named on fresh data:', share(case.is_named for case in laws if case.law))


def plan(seed: int, count: int) -> list[tuple[str, int, str]]:
    """Kind, seed and name of every case."""
    return [*(('outside', seed + i, law.name) for i, law in enumerate(OUTSIDE)),
            *(('clean', seed + 100 + i, '') for i in range(count)),
            *((kind, seed + 200 + i, name) for kind in ('single', 'removed')
              for i, name in enumerate(EFFECTS)),
            *(('axial', seed + 300 + i, '') for i in range(AXIAL_DRAWS))]


KINDS = {'outside': outside, 'clean': clean, 'single': single, 'removed': single, 'axial': axial}


def main() -> int:
    args = arguments(
        __doc__, {'kinds': ['clean'], 'clean': 1, 'out': Path('out/independent_short.jsonl')},
        seed=440_000, kinds=tuple(KINDS), clean=5, only=(),
        out=Path('out/independent.jsonl'), table=False)
    known = {(row['kind'], row['seed']) for row in kept_rows(args.out)}
    for kind, seed, name in () if args.table else plan(args.seed, args.clean):
        if kind not in args.kinds or (kind, seed) in known or (
                args.only and not {str(seed), name} & set(args.only)):
            continue
        began = time.process_time()
        absent = [name] if kind == 'removed' else []
        with tempfile.TemporaryDirectory() as folder, without(*absent):
            case = KINDS[kind](name, seed, Path(folder))
        case = replace(case, kind=kind, seconds=time.process_time() - began)
        keep(args.out, asdict(case))
        print(line_of(case), flush=True)
    cases = [Case(**row) for row in kept_rows(args.out)]
    report(cases)
    return 1 if any(case.score in ('false', 'wrong') for case in cases) else 0


if __name__ == '__main__':
    sys.exit(main())
