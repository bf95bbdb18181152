"""Verdicts on other tests and another ring than the shipped ones.

python benchmarks/other_tests.py [--seed N] [--conditions A,B] [--singles N] [--out FILE.jsonl]
draws virtual rigs under each condition (elevations, plateaus, rates, load courses, a missing
probe, a small ring): a sound one, some with one effect of the catalogue, and one with a cause that
is in no catalogue. Every bag is written, read and diagnosed; --table prints the table of FILE.
"""

from __future__ import annotations

import os

os.environ.setdefault('SADDLERING_THREADS', '1')

import argparse
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
import json
import math
from pathlib import Path
import sys
import tempfile
import time
from typing import Any

from blind import size_over_limit
import numpy as np
from rigs import sized_rig

from saddlering_ros import diagnose
from saddlering_ros.bags import write_bag
from saddlering_ros.record import TestMetadata
from saddlering_ros.rig import default_rig, FULL_SCALE_LOAD, Rig
from saddlering_ros.virtual_rig import dynamic_schedule, PhysicalRig, record_test, static_schedule
from saddlering_ros.virtual_rig.blind import score
from saddlering_ros.virtual_rig.campaign import draw_truth, DrawSettings, Truth
from saddlering_ros.virtual_rig.effects import EffectRequest, find_effect
from saddlering_ros.virtual_rig.recording import EPOCH, TestPlan
from saddlering_ros.virtual_rig.schedule import Schedule

TWICE = 2.0
WAVE_CORNERS = 240
"""Straight pieces of a sinusoidal load."""


@dataclass(frozen=True)
class Wave(Schedule):
    """A dynamic test whose load swings between lowest and peak as a sine; `ramp` is half a period.
    """

    def corners(self) -> tuple[np.ndarray, np.ndarray]:
        """Times [s] and loads [N] of many corners on the sine, rests before and after."""
        length = 2.0 * self.ramp * self.cycles
        swing = np.linspace(0.0, length, WAVE_CORNERS * self.cycles)
        share = 0.5 * (1.0 - np.cos(np.pi * swing / self.ramp))
        time = np.concatenate([[0.0], self.rest + swing, [2.0 * self.rest + length]])
        ends = np.concatenate([[0.0], share, [0.0]])
        return time, self.lowest + (self.peak - self.lowest) * ends


@dataclass(frozen=True)
class Run:
    """One run: name, elevation [deg], schedule of a rig, rate [Hz]."""

    name: str
    elevation_deg: float
    schedule: Callable[[Rig], Schedule]
    rate: float
    is_held_out: bool = False


def static(degrees: float, plateaus: int = 25, hold: float = 5.0, rate: float = 25.0) -> Run:
    """A static test with so many plateaus up to full scale."""
    return Run(f'static_{degrees:g}', degrees,
               lambda rig: static_schedule(rig, hold=hold, step=rig.full_scale_load / plateaus),
               rate)


def dynamic(degrees: float, speed: float = 1.0, rate: float = 1000.0, *,
            held_out: bool = False) -> Run:
    """A ramp up and down."""
    return Run(f'dynamic_{degrees:g}_{speed:g}', degrees,
               lambda rig: dynamic_schedule(rig, speed=speed), rate, held_out)


def triangle(degrees: float, cycles: int, duration: float, *, held_out: bool = False) -> Run:
    """Several ramps up and down without a stay between them."""
    return Run(f'triangle_{degrees:g}_{duration:g}', degrees,
               lambda rig: dynamic_schedule(rig, duration=duration, cycles=cycles), 1000.0,
               held_out)


def sine(degrees: float, period: float, cycles: int, *, held_out: bool = False) -> Run:
    """A load that swings as a sine."""
    def schedule(rig: Rig) -> Schedule:
        usual = dynamic_schedule(rig, cycles=cycles)
        values = {**asdict(usual), 'ramp': 0.5 * period, 'rest': 1.5}
        return Wave(**values)

    return Run(f'sine_{degrees:g}_{period:g}', degrees, schedule, 1000.0, held_out)


def usual(plateaus: int = 25, hold: float = 5.0, rate: float = 1000.0) -> tuple[Run, ...]:
    """The runs of the shipped bags with something changed."""
    return (static(50.0, plateaus, hold), dynamic(50.0, rate=rate), dynamic(50.0, 4.0, rate),
            static(70.0, plateaus, hold), dynamic(70.0, rate=rate, held_out=True))


@dataclass(frozen=True)
class Condition:
    """How tests are made: runs, and the ring."""

    words: str
    runs: tuple[Run, ...]
    rig: Rig


DEFAULT = default_rig()
CONDITIONS: Mapping[str, Condition] = {
    'three_elevations': Condition(
        '0, 30 and 60 deg fitted at once',
        (static(0.0), dynamic(0.0), static(30.0), dynamic(30.0, 4.0), static(60.0),
         dynamic(60.0, held_out=True)), DEFAULT),
    'horizontal': Condition(
        '0 deg alone', (static(0.0), dynamic(0.0), dynamic(0.0, 4.0, held_out=True)), DEFAULT),
    'plateaus_5': Condition('5 plateaus', usual(5), DEFAULT),
    'plateaus_50': Condition('50 plateaus', usual(50, 3.0), DEFAULT),
    'rate_100': Condition('100 Hz', usual(rate=100.0), DEFAULT),
    'rate_5000': Condition('5 kHz', usual(rate=5000.0), DEFAULT),
    'triangular': Condition(
        'triangular loads, three cycles',
        (static(50.0), triangle(50.0, 3, 18.0), triangle(50.0, 3, 6.0), static(70.0),
         triangle(70.0, 3, 18.0, held_out=True)), DEFAULT),
    'sinusoidal': Condition(
        'sinusoidal loads, no static test',
        (sine(50.0, 8.0, 2), sine(50.0, 2.0, 4), sine(70.0, 8.0, 2),
         sine(70.0, 2.0, 4, held_out=True)), DEFAULT),
    'probe_missing': Condition(
        'probe 3 missing, and the rig file states it', usual(),
        replace(DEFAULT, probes=replace(DEFAULT.probes, absent=3))),
    'small_ring': Condition('48 rollers, 10 t, radius 0.4 m', usual(), sized_rig(10.0, 48, 0.4)),
}


@dataclass(frozen=True)
class Case:
    """A verdict under a condition: what was hidden, the answer and its score."""

    condition: str
    kind: str
    seed: int
    hidden: list[dict[str, object]]
    verdict: str
    groups: list[list[str]]
    score: str
    ratio: float | None
    seconds: float
    problem: str = ''


def judge(name: str, kind: str, seed: int, folder: Path) -> Case:
    """Draw a rig, write its bags, diagnose them and compare."""
    condition = CONDITIONS[name]
    rig = condition.rig
    truth = _sized(draw_truth(seed, kind, DrawSettings(sizes=(0.5, 1.0))), rig)
    hidden = truth.to_json()['effects']
    bags = [_write(truth, condition, number, folder) for number in range(len(condition.runs))]
    held = [bag for bag, run in zip(bags, condition.runs, strict=True) if run.is_held_out]
    began = time.process_time()
    try:
        fitted = [bag for bag in bags if bag not in held]
        verdict = diagnose(fitted, hold_out=held, rig=rig, seed=seed).found
    except Exception as problem:
        return Case(name, kind, seed, hidden, '', [], 'error', None,
                    time.process_time() - began, f'{type(problem).__name__}: {problem}')
    answer: dict[str, Any] = {**verdict.to_json()}
    groups = [cause['group'] for cause in answer['causes'] if 'effect' in cause]
    names = [str(item['effect']) for item in hidden]
    counted, _ = score(kind, names, answer['verdict'], groups)
    ratio = None
    if kind == 'single':
        ratio = size_over_limit(hidden[0], answer['detection_limits'])
    return Case(name, kind, seed, hidden, answer['verdict'], groups, counted, ratio,
                time.process_time() - began)


def _sized(truth: Truth, rig: Rig) -> Truth:
    """The same with forces and compliances of a rig of this full scale."""
    share = rig.full_scale_load / FULL_SCALE_LOAD
    powers = {'N': 1.0, 'N m': 1.0, 'm/N': -1.0, 'rad/(N m)': -1.0, 'rad/Nm': -1.0, 'rad/N': -1.0}
    requests = []
    for item in truth.effects:
        units = {parameter.name: parameter.unit for parameter in item.effect.parameters}
        values = {key: value * share ** powers.get(units[key], 0.0)
                  for key, value in item.values.items()}
        requests.append(EffectRequest(find_effect(item.effect.id), values, item.form))
    instruments = replace(truth.instruments, load_noise=truth.instruments.load_noise * share)
    return replace(truth, effects=tuple(requests), instruments=instruments)


def _write(truth: Truth, condition: Condition, number: int, folder: Path) -> Path:
    """Write the bag of one run."""
    run, rig = condition.runs[number], condition.rig
    physical = PhysicalRig(rig, truth.contact, math.radians(run.elevation_deg), truth.effects,
                           truth.scatter, truth.seed)
    seed = int(np.random.SeedSequence([truth.seed, number]).generate_state(1)[0])
    plan = TestPlan(physical, run.schedule(rig), seed, truth.instruments, run.rate,
                    begin=EPOCH + 900 * number)
    record = record_test(plan)
    facts = TestMetadata(record.facts.test, record.facts.elevation_deg, record.facts.rig,
                      record.facts.run, details={'rig_hash': rig.digest})
    return Path(write_bag(folder / run.name, facts, record.load_stamps, record.load,
                          record.probe_stamps, record.gaps, rig.probes,
                          log_delay=record.log_delay, overwrite=True))


def line_of(case: Case) -> str:
    """One case in one line."""
    hidden = ' + '.join(str(item['effect']) for item in case.hidden) or '-'
    ratio = '' if case.ratio is None else f' ({case.ratio:.1f} x limit)'
    answer = ' + '.join('|'.join(group) for group in case.groups)
    return (f'{case.condition} {case.kind} {case.seed}: {case.score}: {hidden}{ratio} -> '
            f'{case.verdict} {answer} {case.problem} {case.seconds:.0f} s')


def table(cases: Sequence[Case]) -> str:
    """One row a condition."""
    lines = ['| condition | sound rings `none` | effects of twice their limit right | other '
             'effects right | outside the catalogue `unknown` | wrong names | errors |',
             '|---|---|---|---|---|---|---|']
    for name, condition in CONDITIONS.items():
        own = [case for case in cases if case.condition == name]
        if not own:
            continue
        clean = [case for case in own if case.kind == 'clean']
        large = [case for case in own if case.kind == 'single' and (case.ratio or 0) >= TWICE]
        small = [case for case in own if case.kind == 'single' and case not in large]
        outside = [case for case in own if case.kind == 'outside']
        shares = ' | '.join(f'{sum(case.score == "right" for case in part)}/{len(part)}'
                            for part in (clean, large, small, outside))
        wrong = sum(case.score == 'wrong' for case in own)
        errors = sum(case.score == 'error' for case in own)
        lines.append(f'| {condition.words} | {shares} | {wrong} | {errors} |')
    return '\n'.join(lines)


def read_cases(path: Path) -> list[Case]:
    """Cases kept so far."""
    if not path.exists():
        return []
    return [Case(**json.loads(line)) for line in path.read_text().splitlines() if line]


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument('--seed', type=int, default=400_000)
    parser.add_argument('--conditions', default=','.join(CONDITIONS))
    parser.add_argument('--singles', type=int, default=3)
    parser.add_argument('--kinds', default='clean,single,outside')
    parser.add_argument('--out', type=Path, default=Path('out/other_tests.jsonl'))
    parser.add_argument('--table', action='store_true', help='print the table of --out only')
    args = parser.parse_args()
    args.out.parent.mkdir(parents=True, exist_ok=True)
    counts = {'clean': 1, 'single': args.singles, 'outside': 1}
    known = {(case.condition, case.kind, case.seed) for case in read_cases(args.out)}
    for name in [] if args.table else args.conditions.split(','):
        place = list(CONDITIONS).index(name)
        for kind in args.kinds.split(','):
            for number in range(counts[kind]):
                seed = args.seed + 100 * place + number
                if (name, kind, seed) in known:
                    continue
                with tempfile.TemporaryDirectory(prefix='other_') as folder:
                    case = judge(name, kind, seed, Path(folder))
                with args.out.open('a') as kept:
                    kept.write(json.dumps(asdict(case)) + '\n')
                print(line_of(case), flush=True)
    cases = read_cases(args.out)
    print(table(cases))
    return 1 if any(case.score in ('error', 'false', 'wrong') for case in cases) else 0


if __name__ == '__main__':
    sys.exit(main())
