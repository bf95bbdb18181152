"""The result of an identification, and its JSON."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from saddlering_ros.files import Provenance
from saddlering_ros.identification.uncertainty import Profile
from saddlering_ros.record import Record
from saddlering_ros.rig import (
    ContactParameters,
    line_contact_stiffness,
    PARAMETER_NAMES,
    PARAMETER_UNITS,
    ParameterSet,
    stiffness_per_millimetre,
)

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Identification:
    """Identified contact parameters and their uncertainty.

    objective: the paper's J (method 'paper') or chi square (method 'default'). covariance and
    correlation (6, 6), std (6,) in the order of PARAMETER_NAMES. If the data do not determine
    a parameter, std is NaN, the interval is None, reasons states why, and the value is the
    best known one. All of these allow for unequal rollers; the covariance in the parameters'
    source counts noise alone, for predictions of the same ring and its changes. systematic:
    shift (6,) in (ln K, n, ln D) by each small imperfection that no fit can see.
    """

    parameters: ParameterSet
    method: str
    objective: float
    chi_square: float
    degrees_of_freedom: int
    covariance: Array
    correlation: Array
    std: Array
    intervals: dict[str, tuple[float, float] | None]
    determined: dict[str, bool]
    reasons: dict[str, str]
    at_bound: dict[str, bool]
    systematic: dict[str, Array]
    collinearity: dict[str, float]
    ellipses: dict[str, Array] = field(repr=False)
    evaluations: int
    elapsed: float
    status: str
    cancelled: bool
    notes: tuple[str, ...] = ()
    profiles: dict[str, Profile] = field(default_factory=dict)

    def made_from(self, runs: Sequence[Record]) -> Identification:
        """The same with the hashes of its bags and the software versions among the sources."""
        made = Provenance(tuple(run.origin for run in runs))
        source = replace(
            self.parameters.source, sha256=tuple(origin.sha256 for origin in made.bags),
            versions=made.versions_in_words)
        return replace(self, parameters=replace(self.parameters, source=source))

    @property
    def reduced_chi_square(self) -> float:
        """Chi square per degree of freedom; 1 if the misfit equals the noise."""
        return self.chi_square / max(1, self.degrees_of_freedom)

    def to_json(self) -> dict[str, Any]:
        """Plain dictionaries, lists and numbers; null if the data do not determine a value."""
        contact = self.parameters.contact
        return {
            'method': self.method,
            'status': self.status,
            'cancelled': self.cancelled,
            'bags': list(self.parameters.source.bags),
            'objective': _number(self.objective),
            'chi_square': _number(self.chi_square),
            'degrees_of_freedom': self.degrees_of_freedom,
            'reduced_chi_square': _number(self.reduced_chi_square),
            'evaluations': self.evaluations,
            'elapsed': self.elapsed,
            'parameters': {
                name: self.parameter_entry(index, name)
                for index, name in enumerate(PARAMETER_NAMES)
            },
            'line_contact_ratio': line_contact_ratios(contact),
            'order': list(PARAMETER_NAMES),
            'covariance': [[_number(value) for value in row] for row in self.covariance],
            'correlation': [[_number(value) for value in row] for row in self.correlation],
            'collinearity': {key: _number(value) for key, value in self.collinearity.items()},
            'systematic': {
                key: {
                    name: _number(value)
                    for name, value in zip(PARAMETER_NAMES, shift, strict=True)
                }
                for key, shift in self.systematic.items()
            },
            'ellipses': {key: points.tolist() for key, points in self.ellipses.items()},
            'profiles': {
                name: {
                    'values': profile.values.tolist(),
                    'rise': profile.rise.tolist(),
                    'interval': list(profile.interval),
                }
                for name, profile in self.profiles.items()
            },
            'notes': list(self.notes),
            'provenance': Provenance(self.parameters.source.origins).as_dict(),
        }

    def parameter_entry(self, index: int, name: str) -> dict[str, Any]:
        """One parameter as `to_json` has it."""
        interval = self.intervals[name]
        return {
            'value': float(getattr(self.parameters.contact, name)),
            'std': _number(self.std[index]) if self.determined[name] else None,
            'interval': None if interval is None else list(interval),
            'unit': PARAMETER_UNITS[name],
            'pinned': self.determined[name],
            'reason': self.reasons.get(name),
            'at_bound': self.at_bound[name],
        }


def line_contact_ratios(contact: ContactParameters) -> dict[str, float]:
    """Identified K over Palmgren's line contact of one roller, rows 1 and 2, both in N/mm^n.

    The exponents differ a little from 10/9, so the ratio compares forces at a penetration of
    0.1 mm, the size of the measured ones.
    """
    penetration = 0.1
    line = line_contact_stiffness() * penetration ** (10.0 / 9.0)
    return {
        f'K{row}': stiffness_per_millimetre(stiffness, exponent) * penetration**exponent / line
        for row, stiffness, exponent in ((1, contact.K1, contact.n1), (2, contact.K2, contact.n2))
    }


def _number(value: float) -> float | None:
    return float(value) if math.isfinite(value) else None
