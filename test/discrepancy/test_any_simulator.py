"""Claims on the public face, made of the examples: named, none, unknown, in any unit."""

from dataclasses import replace
from functools import cache
import importlib.util
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
import pytest

from saddlering_ros.discrepancy import diagnose, Diagnosis, Model, Noise, Parameter, Run

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
def test_a_name_takes_about_as_many_simulations_as_are_usual(name: str) -> None:
    found = found_in(name)
    usual = found.fits.metric.problem.usual_simulations
    assert 0.4 * usual < found.simulations < 2.0 * usual


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


def in_other_units(model: Model, channel: float, time: float, parameter: float) -> Model:
    """The model with its channels, its time and its parameters in units so many times as small."""
    straight = {name for name, item in model.base.items() if not item.periodic}
    straight |= {f'{key}.{name}' for key, effect in model.effects.items()
                 for name, item in effect.parameters.items() if not item.periodic}

    def simulate(parameters: dict[str, float], run: Run) -> dict[str, Any]:
        usual = {name: value / parameter if name in straight else value
                 for name, value in parameters.items()}
        seen = model.simulate(usual, replace(run, time=run.time / time))
        return {name: channel * np.asarray(values) for name, values in seen.items()}

    def scaled(items: dict[str, Parameter]) -> dict[str, Parameter]:
        fields = ('low', 'high', 'start', 'neutral')
        return {name: item if item.periodic else replace(item, **{
            field: getattr(item, field) * parameter for field in fields
            if getattr(item, field) is not None}) for name, item in items.items()}

    effects = {key: replace(effect, parameters=scaled(effect.parameters))
               for key, effect in model.effects.items()}
    channels = {name: replace(
        item, offset=item.offset if isinstance(item.offset, str) else item.offset * channel,
        noise=item.noise if item.noise.learns_from_residuals else Noise.white(0.2 * channel))
        for name, item in model.channels.items()}
    return Model(simulate, scaled(model.base), effects, channels)


@pytest.mark.parametrize('name', NAMES)
def test_a_verdict_is_the_same_in_any_unit(name: str) -> None:
    module = example(name)
    channel, time, parameter = UNITS[NAMES.index(name) % 2 == 0]
    usual = records(module, module.HIDDEN)
    other = [replace(run, time=run.time * time, outputs={
        name: values * channel for name, values in run.outputs.items()}) for run in usual]
    first = found_in(name)
    second = diagnose(in_other_units(module.model, channel, time, parameter), other)
    assert (second.verdict, names(second)) == (first.verdict, names(first))
    assert second.gain.fit == pytest.approx(first.gain.fit, abs=1e-3)
