"""Parameters and their sources, to and from messages."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from builtin_interfaces.msg import Time
import numpy as np

from saddlering_interfaces.msg import DiagnosedCause, RingParameters
from saddlering_ros.rig import ContactParameters, ParameterSet, ParameterSource
from saddlering_ros.rig.parameter_file import Effects
from saddlering_ros.ros.errors import NodeError

FIELDS = ('k1', 'n1', 'd1', 'k2', 'n2', 'd2')
"""Fields of RingParameters in the order of ContactParameters."""


def parameters_to_message(parameters: ParameterSet, stamp: Time) -> RingParameters:
    """A RingParameters message of `parameters`."""
    message = RingParameters(source=words_of(parameters.source))
    message.header.stamp = stamp
    for name, value in zip(FIELDS, parameters.contact.to_array().tolist(), strict=True):
        setattr(message, name, value)
    covariance = parameters.source.covariance
    if covariance is not None:
        message.covariance = [float(value) for value in np.ravel(covariance)]
    for effect, values in parameters.effects.items():
        for name, value in values.items():
            message.effect_parameter_names.append(f'{effect}.{name}')
            message.effect_parameter_values.append(float(value))
    return message


def parameters_from_message(message: RingParameters) -> ParameterSet:
    """The ParameterSet of a message; SaddleringError for an entry that cannot be used."""
    values = [float(getattr(message, name)) for name in FIELDS]
    if not np.isfinite(values).all():
        raise NodeError('/ring/parameters: a contact parameter is not finite: publish six numbers')
    covariance = np.array(message.covariance, dtype=np.float64)
    if covariance.size not in (0, 36):
        raise NodeError(f'/ring/parameters: covariance has {covariance.size} numbers: '
                        'give 36 or none')
    source = ParameterSource(
        method='message', note=str(message.source),
        covariance=covariance.reshape(6, 6) if covariance.size else None)
    return ParameterSet(ContactParameters(*values), _effects(message), source)


def _effects(message: RingParameters) -> Effects:
    names, values = message.effect_parameter_names, message.effect_parameter_values
    if len(names) != len(values):
        raise NodeError(f'/ring/parameters: {len(names)} effect parameters have {len(values)} '
                        'values: give one each')
    effects: Effects = {}
    for name, value in zip(names, values, strict=True):
        effect, dot, parameter = name.partition('.')
        if not dot or not np.isfinite(value):
            raise NodeError(f'/ring/parameters: effect parameter {name!r} = {value}: give '
                            'effect.parameter and a finite number')
        effects.setdefault(effect, {})[parameter] = float(value)
    return effects


def words_of(source: ParameterSource) -> str:
    """Where parameters came from, in words."""
    words = source.method
    if source.bags:
        words += f' from {", ".join(source.bags)}'
    return f'{words} ({source.note})' if source.note else words


def causes_to_messages(document: Mapping[str, Any]) -> list[DiagnosedCause]:
    """The causes of a verdict document (`diagnose --json`) as messages; NaN for null."""
    return [_cause_to_message(cause) for cause in document['causes'] if 'effect' in cause]


def _cause_to_message(cause: Mapping[str, Any]) -> DiagnosedCause:
    items = cause['parameters']
    values = [float(item['value']) for item in items.values()]
    stds = [_number(item['std']) for item in items.values()]
    return DiagnosedCause(
        effect=cause['effect'], group=list(cause['group']), parameter_names=list(items),
        units=[item['unit'] for item in items.values()], values=values, stds=stds,
        lower=[value - 1.96 * std for value, std in zip(values, stds, strict=True)],
        upper=[value + 1.96 * std for value, std in zip(values, stds, strict=True)],
        p_value=_number(cause['evidence'].get('p_value')),
        delta_bic=_number(cause['evidence'].get('delta_bic')),
        misfit_reduction_fit=_number(cause['gain'].get('fit')),
        misfit_reduction_held_out=_number(cause['gain'].get('held_out')))


def _number(value: float | None) -> float:
    return float('nan') if value is None else float(value)
