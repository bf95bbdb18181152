"""Claims on the public face, made of the examples: named, none, unknown, in any unit."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
import importlib.util
from pathlib import Path
import sys
from types import ModuleType

import numpy as np
import pytest

from saddlering_ros.discrepancy import diagnose, Diagnosis, Run

sys.path.insert(0, str(Path(__file__).parents[2] / 'benchmarks'))

from machines.units import in_other_units, run_in_other_units

FOLDER = Path(__file__).parents[2] / 'examples' / 'any_simulator'
NAMES = sorted(path.stem for path in FOLDER.glob('*.py'))


@cache
def example(name: str) -> ModuleType:
    spec = importlib.util.spec_from_file_location(f'example_{name}', FOLDER / f'{name}.py')
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def hidden_effect(module: ModuleType) -> str:
    return next(iter(module.HIDDEN)).split('.')[0]


def records(module: ModuleType, hidden: dict[str, float]) -> list[Run]:
    return [module.record('first', 1, hidden), module.record('second', 2, hidden)]


@cache
def found_in(name: str) -> Diagnosis:
    """The answer to an example with its first effect hidden, asked for once."""
    module = example(name)
    return diagnose(module.model, records(module, module.HIDDEN))


def names(found: Diagnosis) -> list[str]:
    return [cause.effect for cause in found.causes]


@pytest.mark.parametrize('name', NAMES)
def test_what_is_hidden_is_named_and_its_size_is_right(name: str) -> None:
    module = example(name)
    found = found_in(name)
    assert (found.verdict, names(found)) == ('named', [hidden_effect(module)])
    size = next(iter(found.causes[0].parameters.values()))
    true = next(iter(module.HIDDEN.values()))
    assert abs(size.value - true) < 4.0 * size.std
    assert found.converged


@pytest.mark.parametrize('name', NAMES)
def test_where_nothing_is_hidden_nothing_is_found(name: str) -> None:
    module = example(name)
    assert diagnose(module.model, records(module, {})).verdict == 'none'


@pytest.mark.parametrize('name', NAMES)
def test_what_is_in_no_catalogue_gets_no_name(name: str) -> None:
    module = example(name)
    effects = dict(module.model.effects)
    absent = effects.pop(hidden_effect(module))
    gone = {f'{hidden_effect(module)}.{item}': 0.0 for item in absent.parameters}

    def simulate(parameters: dict[str, float], run: Run) -> dict[str, np.ndarray]:
        return module.simulate({**module.TRUE, **gone, **parameters}, run)

    model = replace(module.model, simulate=simulate, effects=effects)
    assert diagnose(model, records(module, module.HIDDEN)[:1]).verdict == 'unknown'


UNITS = {True: (1e6, 1e-3, 1e3), False: (1e-6, 1e3, 1e-3)}
"""Factors on channels, time and parameters, in turn over the examples."""


@pytest.mark.parametrize('name', NAMES)
def test_a_verdict_is_the_same_in_any_unit(name: str) -> None:
    module = example(name)
    channel, time, parameter = UNITS[NAMES.index(name) % 2 == 0]
    usual = records(module, module.HIDDEN)
    other = [run_in_other_units(run, channel, time) for run in usual]
    first = found_in(name)
    second = diagnose(in_other_units(module.model, channel, time, parameter), other)
    assert (second.verdict, names(second)) == (first.verdict, names(first))
    assert second.gain.fit == pytest.approx(first.gain.fit, abs=1e-3)
