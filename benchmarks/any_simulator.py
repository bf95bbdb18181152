"""The public face on the example machines: detection, false alarms, isolation, unknown recall.

python benchmarks/any_simulator.py [--seeds N]: every example of examples/any_simulator with its
cause hidden in three sizes, with nothing hidden, and with the cause taken out of the catalogue.
Reported as in the DX competitions, with the coverage of 95 % intervals and the difference of the
reported misfit reduction from plain least squares.
"""

from __future__ import annotations

import argparse
from collections import Counter
from dataclasses import replace
import importlib.util
from pathlib import Path
import time
from types import ModuleType
from typing import Any

import numpy as np
from scipy.optimize import least_squares

from saddlering_ros.discrepancy import diagnose, Diagnosis, Model, Run

FOLDER = Path(__file__).resolve().parent.parent / 'examples' / 'any_simulator'
SIZES = (0.4, 1.0, 2.0)


def load(path: Path) -> ModuleType:
    spec = importlib.util.spec_from_file_location(path.stem, path)
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def records(module: ModuleType, hidden: dict[str, float], seed: int) -> tuple[list[Run], Run]:
    """Two runs to fit and one to hold out; the seed draws drive and noise."""
    runs = [module.record(name, 3 * seed + number, hidden)
            for number, name in enumerate(('first', 'second', 'third'), start=1)]
    return runs[:2], runs[2]


def rms(model: Model, values: dict[str, float], runs: list[Run]) -> np.ndarray:
    """Residuals over range, samples missing left out, free constants taken off."""
    parts = []
    for name, channel in model.channels.items():
        span = max(float(np.ptp(run.outputs[name][np.isfinite(run.outputs[name])]))
                   for run in runs)
        for run in runs:
            left = np.asarray(model.simulate(values, run)[name]) - run.outputs[name]
            left = left[np.isfinite(left)]
            if channel.offset == 'free':
                left = left - left.mean()
            parts.append(left / span / np.sqrt(left.size))
    return np.concatenate(parts)


def plain_gain(model: Model, effect: str, found: Diagnosis, runs: list[Run]) -> float:
    """Misfit reduction of plain least squares from the published values."""
    neutral = model.neutral()
    own = {f'{effect}.{name}': item.value for name, item in found.causes[0].parameters.items()}

    def best(names: list[str], values: dict[str, float], bounds: list[Any]) -> float:
        low, high = np.array(bounds).T
        start = np.clip([values[name] for name in names], low + 1e-9, high - 1e-9)

        def residual(theta: np.ndarray) -> np.ndarray:
            return rms(model, {**values, **dict(zip(names, theta, strict=True))}, runs)

        answer = least_squares(residual, start, bounds=(low, high), x_scale=high - low)
        return float(np.sqrt(2.0 * answer.cost))

    base = {name: (item.low, item.high) for name, item in model.base.items()}
    alone = {**neutral, **{name: item.value for name, item in found.base_alone.items()}}
    full = {**neutral, **own, **{name: item.value for name, item in found.base.items()}}
    bent = {f'{effect}.{name}': (item.low - (7 if item.periodic else 0),
                                 item.high + (7 if item.periodic else 0))
            for name, item in model.effects[effect].parameters.items()}
    before = best(list(base), alone, list(base.values()))
    after = best([*base, *bent], full, [*base.values(), *bent.values()])
    return 1.0 - after / before


def trial(module: ModuleType, counts: Counter[str], seed: int) -> list[str]:
    """Every case of one machine and seed; lines on what went wrong."""
    lines = []
    effect = next(iter(module.HIDDEN)).split('.')[0]
    first = next(iter(module.HIDDEN))
    for size in SIZES:
        hidden = {**module.HIDDEN, first: module.HIDDEN[first] * size}
        runs, held_out = records(module, hidden, seed)
        found = diagnose(module.model, runs, hold_out=[held_out])
        counts['present'] += 1
        counts['detected'] += found.verdict != 'none'
        names = [cause.effect for cause in found.causes]
        right = found.verdict in ('named', 'ambiguous') and names == [effect]
        counts['right'] += right
        if found.verdict in ('named', 'ambiguous') and effect not in names:
            counts['wrong names'] += 1
        if right:
            counts['isolation x 100'] += round(100 / len(found.causes[0].group))
            item = next(iter(found.causes[0].parameters.values()))
            counts['covered'] += abs(item.value - hidden[first]) <= 1.96 * item.std
            apart = abs(found.gain.fit - plain_gain(module.model, effect, found, runs))
            counts['gain within 0.05'] += apart <= 0.05
        else:
            lines.append(f'{module.__name__} seed {seed} size {size}: {found.verdict} {names}')
            lines += [f'    {warning}' for warning in found.warnings]
        counts['not converged'] += not found.converged
    runs, _ = records(module, {}, seed)
    found = diagnose(module.model, runs)
    counts['null'] += 1
    counts['false alarms'] += found.verdict != 'none'
    if found.verdict != 'none':
        lines.append(f'{module.__name__} seed {seed} null: {found.verdict}')
        lines += [f'    {warning}' for warning in found.warnings]
    gone = dict(module.model.effects)
    gone.pop(effect)
    absent = {name: value for name, value in module.model.neutral().items()
              if name.startswith(f'{effect}.')}
    model = replace(module.model, effects=gone, simulate=lambda values, run: module.simulate(
        {**absent, **values}, run))
    runs, _ = records(module, module.HIDDEN, seed)
    found = diagnose(model, runs)
    counts['removed'] += 1
    counts['unknown recall'] += found.verdict == 'unknown'
    if found.verdict != 'unknown':
        counts['wrong names'] += found.verdict != 'none'
        lines.append(f'{module.__name__} seed {seed} removed: {found.verdict} '
                     f'{[cause.effect for cause in found.causes]}')
    return lines


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument('--seeds', type=int, default=6)
    seeds = parser.parse_args().seeds
    total: Counter[str] = Counter()
    for path in sorted(FOLDER.glob('*.py')):
        counts: Counter[str] = Counter()
        began = time.process_time()
        for seed in range(1, seeds + 1):
            for line in trial(load(path), counts, seed):
                print(line, flush=True)
        print(f'{path.stem}: {dict(counts)}, {time.process_time() - began:.0f} s', flush=True)
        total += counts
    print(f'all: {dict(total)}')


if __name__ == '__main__':
    main()
