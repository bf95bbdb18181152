"""The public face on machines of other people: is what is hidden named, and only that?

    python benchmarks/any_simulator.py [--machines NAME ...] [--seeds 1 2]

Every effect of every machine is hidden in turn, then hidden while it is not in the catalogue, and
once nothing is hidden. Reported are the four figures of the DX competitions (detection rate, false
alarms, isolation, unknown recall), the share of right verdicts, wrong names and coverage of 95 %
intervals. Machines whose program is not installed are left out by name;
benchmarks/machines-requirements.txt has the programs.
"""

from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass
import importlib

from frame import arguments, table
from machines.examples import ALSO_HIDDEN
from machines.examples import machine as example
from machines.machine import Machine, without
import numpy as np

from saddlering_ros.discrepancy import diagnose, Diagnosis, Model
from saddlering_ros.quantities import WIDTH_95

OTHERS = ('pendulum', 'cart_pole', 'predator_prey')
SIZES = (0.6, 2.0)
"""The true size is drawn between these shares of the one that the machine lists."""


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


def count_intervals(case: Case, found: Diagnosis, truth: Mapping[str, float],
                    counts: Counter[str]) -> None:
    """Intervals of a cause that was named rightly."""
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
        counts['intervals'] += 1
        counts['intervals that hold'] += away <= WIDTH_95 * item.std
        if away > WIDTH_95 * item.std:
            print(f'    {case.name}: {name} {item.value:.5g} +/- {item.std:.2g}, true {true:.5g}')


def trial(machine: Machine, case: Case, seed: int, counts: Counter[str]) -> None:
    """One case of one machine, counted."""
    runs = [machine.record(number, seed, case.hidden) for number in (1, 2, 3)]
    found = diagnose(case.model, runs[:2], hold_out=runs[2:])
    kind = 'present' if case.effect else 'removed' if case.hidden else 'null'
    is_established = found.verdict in ('named', 'ambiguous')
    if case.effect:
        right = is_established and len(found.causes) == 1 and (
            case.effect in found.causes[0].group)
    else:
        right = found.verdict == ('unknown' if case.hidden else 'none')
    counts.update((kind, 'cases'))
    counts['right'] += right
    counts[f'{kind} right'] += right
    counts[f'alarms, {kind}'] += found.verdict != 'none'
    counts['not converged'] += not found.converged
    if is_established and not right:
        truth_in = case.effect and any(case.effect in cause.group for cause in found.causes)
        counts['truth and more' if truth_in else 'wrong names'] += 1
    if not right:
        size = {name: round(value, 5) for name, value in case.hidden.items()}
        print(f'  {machine.name} {seed}: {case.name} {size}: {found.verdict} '
              f'{[cause.effect for cause in found.causes]}')
        for warning in found.warnings:
            print(f'      {warning}')
    if case.effect and right:
        count_intervals(case, found, machine.truth(seed), counts)


COLUMNS = {
    'right': ('right', 'cases'), 'detection': ('alarms, present', 'present'),
    'false alarms': ('alarms, null', 'null'), 'isolation': ('isolation', 'present'),
    'unknown recall': ('removed right', 'removed'), 'wrong names': ('wrong names', 'cases'),
    'truth and more': ('truth and more', 'cases'),
    'intervals': ('intervals that hold', 'intervals'), 'not converged': ('not converged', 'cases')}
"""The figures of the DX competitions and the other targets, as shares of counts."""


def main() -> None:
    args = arguments(__doc__, {'machines': ['mask'], 'seeds': [1]},
                     machines=(*OTHERS, *ALSO_HIDDEN), seeds=(1, 2))
    found = {}
    for machine in machines(args.machines):
        counts = found[machine.name] = Counter[str]()
        for seed in args.seeds:
            for case in cases(machine, seed):
                trial(machine, case, seed, counts)
    found['all'] = sum(found.values(), Counter[str]())
    table('Verdicts', ['machine', *COLUMNS], [
        [name, *(f'{counts[part]:g}/{counts[whole]}' for part, whole in COLUMNS.values())]
        for name, counts in found.items()])


if __name__ == '__main__':
    main()
