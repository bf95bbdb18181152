"""The public face on machines of other people: is what is hidden named, and only that?

    python benchmarks/any_simulator.py [--machines NAME ...] [--seeds 1 2] [--units]

Every effect of every machine is hidden in turn, then hidden while it is not in the catalogue, and
once nothing is hidden. Reported are the four figures of the DX competitions (detection rate, false
alarms, isolation, unknown recall), the share of right verdicts, wrong names, coverage of 95 %
intervals, and the difference of the reported misfit reduction from that of plain least squares.
A wrong name is within noise if the hidden effect, put back, fits hardly better. Missed effects
smaller than the limit which the answer states are counted too; they do not count as right.
--units repeats every case in other units. Machines whose program is not installed are left out by
name; benchmarks/machines-requirements.txt has the programs.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass, replace
import importlib
import time
from typing import Any

from frame import arguments, table
from machines.examples import ALSO_HIDDEN
from machines.examples import machine as example
from machines.machine import Machine, without
from machines.units import in_other_units, run_in_other_units
import numpy as np
from scipy.optimize import least_squares

from saddlering_ros.discrepancy import diagnose, Diagnosis, Model, Run

OTHERS = ('pendulum', 'cart_pole', 'four_tank', 'predator_prey')
SIZES = (0.6, 2.0)
"""The true size is drawn between these shares of the one that the machine lists."""

UNITS = (1e4, 1e-2, 1e3)
"""Factors on channels, time and parameters for the repetition in other units."""

MAX_GAIN_ERROR = 0.05

MAX_BEHIND = 16.0
"""A cause is within noise of the true one if it fits worse by less: four standard deviations."""


@dataclass(frozen=True)
class Case:
    """What is hidden and what is in the catalogue; the effect whose size is drawn, or none."""

    name: str
    model: Model
    hidden: Mapping[str, float]
    effect: str = ''
    removed: str = ''


def machines(names: list[str]) -> list[Machine]:
    """The machines asked for whose simulators are installed."""
    found = []
    for name in names:
        try:
            found.append(
                example(name) if name in ALSO_HIDDEN
                else importlib.import_module(f'machines.{name}').MACHINE)
        except ImportError as error:
            print(f'left out: {name}: {error}')
    return found


def cases(machine: Machine, seed: int) -> list[Case]:
    """Every effect present, every effect removed, and nothing hidden."""
    random = np.random.default_rng([seed, 3])
    found = [Case('null', machine.model, {})]
    for effect, values in machine.hidden.items():
        parameters = machine.model.effects[effect].ordered
        size = random.uniform(*SIZES)
        item = parameters[0]
        neutral = item.neutral or 0.0
        first = neutral + (values[item.name] - neutral) * (size if neutral == 0.0 else 1.0)
        hidden = {f'{effect}.{name}': value for name, value in values.items()}
        hidden[f'{effect}.{item.name}'] = first
        found.append(Case(f'{effect} present', machine.model, hidden, effect))
        found.append(Case(f'{effect} removed', without(machine.model, [effect]), hidden,
                          removed=effect))
    return found


def residuals(model: Model, values: Mapping[str, float], runs: list[Run]) -> np.ndarray:
    """Residuals over range, samples missing left out, free constants taken off."""
    parts = []
    for name, channel in model.channels.items():
        span = max(float(np.ptp(run.outputs[name][np.isfinite(run.outputs[name])]))
                   for run in runs)
        for run in runs:
            weight = np.gradient(run.time)
            weight = np.minimum(weight, 3.0 * np.median(weight))
            left = np.asarray(model.simulate(dict(values), run)[name]) - run.outputs[name]
            there = np.isfinite(left)
            left, weight = left[there], weight[there] / weight[there].sum()
            if channel.offset == 'free':
                left = left - weight @ left
            parts.append(np.nan_to_num(left, nan=1e3) * np.sqrt(weight) / span)
    return np.concatenate(parts)


def plain_gain(model: Model, effect: str, found: Diagnosis, runs: list[Run]) -> float:
    """Misfit reduction by scipy's least squares, from the published values and from others."""
    neutral = model.neutral()
    for key, value in found.causes[0].parameters.items():
        neutral[f'{effect}.{key}'] = value.value

    def best(items: Mapping[str, Any], starts: list[dict[str, float]]) -> float:
        low = np.array([item.low - 7.0 * item.periodic for item in items.values()])
        high = np.array([item.high + 7.0 * item.periodic for item in items.values()])

        def residual(theta: np.ndarray) -> np.ndarray:
            values = dict(zip(items, map(float, low + theta * (high - low)), strict=True))
            return residuals(model, {**neutral, **values, **fixed}, runs)

        costs = []
        for start in starts:
            theta = (np.array([start[name] for name in items]) - low) / (high - low)
            answer = least_squares(
                residual, np.clip(theta, 1e-6, 1 - 1e-6), bounds=(0.0, 1.0), diff_step=1e-5)
            costs.append(answer.cost)
        return float(np.sqrt(min(costs)))

    base = dict(model.base)
    middle = {name: item.from_unit(item.first_guess) for name, item in base.items()}
    alone = {name: item.value for name, item in found.base_alone.items()}
    fixed: dict[str, float] = model.neutral()
    before = best(base, [alone, middle])
    fixed = {}
    own = {f'{effect}.{name}': item for name, item in model.effects[effect].parameters.items()}
    full = {**neutral, **{name: item.value for name, item in found.base.items()}}
    after = best({**base, **own}, [full])
    return 1.0 - after / before


def judged(case: Case, found: Diagnosis) -> bool:
    """Whether the verdict is the right one."""
    if not case.effect:
        return found.verdict == ('unknown' if case.hidden else 'none')
    return found.verdict in ('named', 'ambiguous') and len(found.causes) == 1 and (
        case.effect in found.causes[0].group)


def behind_truth(machine: Machine, effect: str, found: Diagnosis, runs: list[Run]) -> float:
    """By how much the hidden effect alone would fit better than the cause that was named.

    In misfit: the square of the standard deviations by which the two predictions differ.
    """
    others = {name: value for name, value in machine.model.neutral().items()
              if not name.startswith(f'{effect}.')}
    only = replace(
        machine.model, effects={effect: machine.model.effects[effect]},
        simulate=lambda values, run: machine.model.simulate({**others, **values}, run))
    true, metric = diagnose(only, runs).fits.after, found.fits.metric
    left = metric.whiten(true.prediction - metric.problem.measured)
    return found.fits.after.misfit - float(left @ left)


def under_its_limit(machine: Machine, case: Case, runs: list[Run]) -> bool:
    """Whether what is hidden is smaller than the whole catalogue's answer says it could find."""
    effect = case.effect or case.removed
    size = machine.model.effects[effect].size.name
    limit = next(item for item in diagnose(machine.model, runs).observability.limits
                 if item.effect == effect)
    return abs(case.hidden[f'{effect}.{size}']) < max(limit.limit, limit.material_limit)


def count_numbers(
    case: Case, found: Diagnosis, truth: Mapping[str, float], runs: list[Run],
    counts: Counter[str],
) -> None:
    """Intervals and gain of a cause that was named rightly."""
    cause = found.causes[0]
    counts['isolation'] += 1.0 / len(cause.group)  # type: ignore[assignment]
    if cause.effect != case.effect:
        return
    numbers = {name: (item, truth[name]) for name, item in found.base.items()}
    for name, item in cause.parameters.items():
        if f'{case.effect}.{name}' in case.hidden:
            numbers[name] = item, case.hidden[f'{case.effect}.{name}']
    periods = {name: item.high - item.low if item.periodic else np.inf
               for name, item in case.model.effects[case.effect].parameters.items()}
    for name, (item, true) in numbers.items():
        away = abs(item.value - true)
        away = min(away, abs(periods.get(name, np.inf) - away))
        inside = away <= 1.96 * item.std
        counts['intervals'] += 1
        counts['intervals that hold'] += inside
        if not inside:
            print(f'    {case.name}: {name} {item.value:.5g} +/- {item.std:.2g}, true {true:.5g}')
    apart = found.gain.fit - plain_gain(case.model, case.effect, found, runs)
    counts['gains'] += 1
    counts['gains within 0.05'] += abs(apart) <= MAX_GAIN_ERROR
    if abs(apart) > MAX_GAIN_ERROR:
        print(f'    {case.name}: gain {found.gain.fit:.3f}, {apart:+.3f} from plain least squares')


def trial(machine: Machine, case: Case, seed: int, units: bool, counts: Counter[str]) -> None:
    """One case of one machine, counted."""
    runs = [machine.record(number, seed, case.hidden) for number in (1, 2, 3)]
    began = time.process_time()
    found = diagnose(case.model, runs[:2], hold_out=runs[2:])
    used = time.process_time() - began
    kind = 'present' if case.effect else 'removed' if case.hidden else 'null'
    right = judged(case, found)
    names = [cause.effect for cause in found.causes]
    counts[kind] += 1
    counts['cases'] += 1
    counts['right'] += right
    counts[f'{kind} right'] += right
    counts['alarms, ' + kind] += found.verdict != 'none'
    counts['not converged'] += not found.converged
    if found.verdict in ('named', 'ambiguous') and not right:
        truth_in = case.effect and any(case.effect in cause.group for cause in found.causes)
        counts['truth and more'] += bool(truth_in)
        counts['wrong names'] += not truth_in
        if case.removed:
            behind = behind_truth(machine, case.removed, found, runs[:2])
            counts['wrong names within noise'] += behind < MAX_BEHIND
            print(f'      the hidden effect would fit better by {behind:.1f} of misfit')
    if found.verdict == 'none' and case.hidden and under_its_limit(machine, case, runs[:2]):
        counts['under the stated limit'] += 1
        print('      hidden is less than the stated limit')
    if not right or used > 20.0:
        size = {name: round(value, 5) for name, value in case.hidden.items()}
        print(f'  {machine.name} {seed}: {case.name} {size}: {found.verdict} {names}, '
              f'{used:.0f} s')
        for warning in found.warnings:
            print(f'      {warning}')
    if case.effect and right:
        count_numbers(case, found, machine.truth(seed), runs[:2], counts)
    if units:
        channel, clock, parameter = UNITS
        other = in_other_units(case.model, channel, clock, parameter)
        seen = [run_in_other_units(run, channel, clock) for run in runs]
        again = diagnose(other, seen[:2], hold_out=seen[2:])
        same = again.verdict == found.verdict and names == [item.effect for item in again.causes]
        counts['in other units'] += 1
        counts['the same in other units'] += same
        if not same:
            print(f'  {machine.name} {seed}: {case.name}: {found.verdict} {names}, in other '
                  f'units {again.verdict} {[item.effect for item in again.causes]}')


COLUMNS = {
    'right': ('right', 'cases'), 'detection': ('alarms, present', 'present'),
    'false alarms': ('alarms, null', 'null'), 'isolation': ('isolation', 'present'),
    'unknown recall': ('removed right', 'removed'), 'wrong names': ('wrong names', 'cases'),
    'of them within noise': ('wrong names within noise', 'wrong names'),
    'missed under the stated limit': ('under the stated limit', 'cases'),
    'truth and more': ('truth and more', 'cases'),
    'intervals': ('intervals that hold', 'intervals'),
    'gains within 0.05': ('gains within 0.05', 'gains'),
    'units': ('the same in other units', 'in other units'),
    'not converged': ('not converged', 'cases')}
"""The figures of the DX competitions and the other targets, as shares of counts."""


def main() -> None:
    args = arguments(__doc__, {'machines': ['mask'], 'seeds': [1]},
                     machines=(*OTHERS, *ALSO_HIDDEN), seeds=(1, 2), units=False)
    found = {}
    for machine in machines(args.machines):
        counts = found[machine.name] = Counter[str]()
        for seed in args.seeds:
            for case in cases(machine, seed):
                trial(machine, case, seed, args.units, counts)
    found['all'] = sum(found.values(), Counter[str]())
    table('Verdicts', ['machine', *COLUMNS], [
        [name, *(f'{counts[part]:g}/{counts[whole]}' for part, whole in COLUMNS.values())]
        for name, counts in found.items()])


if __name__ == '__main__':
    main()
