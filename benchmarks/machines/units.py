"""The same model and records in other units."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np

from saddlering_ros.discrepancy import Model, Parameter, Run


def in_other_units(model: Model, channel: float, time: float, parameter: float) -> Model:
    """The model with its channels, its time and its parameters in units so many times as small."""

    def simulate(parameters: dict[str, float], run: Run) -> dict[str, Any]:
        usual = {name: value / scale.get(name, 1.0) for name, value in parameters.items()}
        seen = model.simulate(usual, replace(run, time=run.time / time))
        return {name: channel * np.asarray(values) for name, values in seen.items()}

    def scaled(item: Parameter) -> Parameter:
        if item.periodic:
            return item
        start, neutral = (
            None if value is None else value * parameter for value in (item.start, item.neutral)
        )
        return replace(
            item, low=item.low * parameter, high=item.high * parameter, start=start,
            neutral=neutral)

    base = {name: scaled(item) for name, item in model.base.items()}
    scale = dict.fromkeys(base, parameter)
    effects = {}
    for key, effect in model.effects.items():
        own = {name: scaled(item) for name, item in effect.parameters.items()}
        effects[key] = replace(effect, parameters=own)
        scale |= {f'{key}.{name}': parameter for name, item in own.items() if not item.periodic}
    channels = {
        name: replace(
            item,
            offset=item.offset if isinstance(item.offset, str) else item.offset * channel,
            noise=replace(item.noise, std=item.noise.std * channel)  # type: ignore[type-var]
            if hasattr(item.noise, 'std')
            else item.noise,
        )
        for name, item in model.channels.items()
    }
    return Model(simulate, base, effects, channels)


def run_in_other_units(run: Run, channel: float, time: float) -> Run:
    """The record with its channels and its time in units so many times as small."""
    outputs = {name: values * channel for name, values in run.outputs.items()}
    return replace(run, time=run.time * time, outputs=outputs)
