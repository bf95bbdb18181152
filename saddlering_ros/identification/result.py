"""The result of an identification, and its JSON."""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from itertools import combinations
import math
from typing import Any

import numpy as np

from saddlering_ros.estimation.process import Array
from saddlering_ros.files import Provenance
from saddlering_ros.identification import uncertainty
from saddlering_ros.quantities import finite_json, percent, quantity, significant, span
from saddlering_ros.rig import (
    ContactParameters,
    PARAMETER_NAMES,
    PARAMETER_UNITS,
    ParameterSet,
    ParameterSource,
)
from saddlering_ros.rig.units import line_contact_stiffness, stiffnesses_per_millimetre


@dataclass(frozen=True)
class FittedLaw(uncertainty.Uncertainty):
    """A contact law with its uncertainty."""

    contact: ContactParameters
    at_bound: dict[str, bool]

    @property
    def noise_factor(self) -> float:
        """Rms misfit over the noise; 1 if a law of this form explains the runs."""
        return math.sqrt(self.reduced_chi_square)

    @property
    def entries(self) -> dict[str, dict[str, Any]]:
        """The parameters as in the JSON, by name."""
        return {name: {
            'value': float(getattr(self.contact, name)),
            'std': float(self.std[index]) if self.determined[name] else None,
            'interval': None if (ends := self.intervals[name]) is None else list(ends),
            'unit': PARAMETER_UNITS[name], 'pinned': self.determined[name],
            'reason': self.reasons.get(name), 'at_bound': self.at_bound[name],
        } for index, name in enumerate(PARAMETER_NAMES)}


@dataclass(frozen=True)
class Identification(FittedLaw):
    """Identified contact parameters and their uncertainty.

    objective: the paper's J (method 'paper') or chi square (method 'default'). If the data do not
    determine a parameter, std is NaN, the interval is None, reasons states why, and the value is
    the best known one. All of these allow for unequal rollers; the covariance in the parameters'
    source counts noise alone, for predictions of the same ring and its changes. The law is that of
    a ring without errors. beside_errors: that of the contacts, where waves of the raceways and
    small errors of ring and rig bend the former and explain the misfit.
    """

    source: ParameterSource
    method: str
    objective: float
    chi_square: float
    degrees_of_freedom: int
    evaluations: int
    elapsed: float
    status: str
    cancelled: bool
    notes: tuple[str, ...] = ()
    beside_errors: FittedLaw | None = None

    @property
    def parameters(self) -> ParameterSet:
        """The law with its source, as in a parameter file."""
        return ParameterSet(self.contact, source=self.source)

    def to_json(self) -> dict[str, Any]:
        """Plain dictionaries, lists and numbers; null if the data do not determine a value."""
        return dict(finite_json({
            **{name: getattr(self, name) for name in ('method', 'status', 'cancelled')},
            'bags': list(self.parameters.source.bags),
            **{name: getattr(self, name) for name in (
                'objective', 'chi_square', 'degrees_of_freedom', 'reduced_chi_square',
                'noise_factor', 'sound_factor', 'evaluations', 'elapsed')},
            'parameters': self.entries,
            'line_contact_ratio': line_contact_ratios(self.parameters.contact),
            'order': list(PARAMETER_NAMES),
            'covariance': self.covariance.tolist(),
            'correlation': self.correlation.tolist(),
            'collinearity': self.collinearity,
            'systematic': {
                key: _changes(shift) for key, shift in self.systematic.items()},
            'budget': self.budget,
            'raceway_waves': self.waves.rms,
            'beside_errors': None if (beside := self.beside_errors) is None else {
                'noise_factor': beside.noise_factor, 'raceway_waves': beside.waves.rms,
                'parameters': beside.entries,
                'covariance': beside.covariance.tolist()},
            'joint': self.joint,
            'notes': list(self.notes),
            'provenance': Provenance(self.parameters.source.origins).as_dict()}))


def line_contact_ratios(contact: ContactParameters) -> dict[str, float]:
    """Identified K over Palmgren's line contact of one roller, rows 1 and 2, both in N/mm^n.

    The exponents differ a little from 10/9, so the ratio compares forces at a penetration of
    0.1 mm, the size of the measured ones.
    """
    penetration = 0.1
    line = line_contact_stiffness() * penetration ** (10.0 / 9.0)
    return {
        name: stiffness * penetration**getattr(contact, f'n{name[1]}') / line
        for name, stiffness in stiffnesses_per_millimetre(vars(contact)).items()}


CORRELATION_THRESHOLD = 0.5  # a smaller one widens an interval by under 16 %

INTERVALS = (
    'Errors and intervals allow for noise, for unequal rollers, and for waves of the raceways of '
    'the size that the misfit shows. They do not allow for a wrong weight of the moving mass, '
    'for friction or creep of the rig, which change D most, or for the imperfections that '
    'saddlering identify lists.')
"""Sentence beside the intervals of an identification, in the text and in the report."""


def identification_text(identification: Identification) -> str:
    """Method, evaluations, chi square, values with errors, bounds, correlations, notes."""
    source = identification.parameters.source
    lines = [
        '[[Identification]]',
        f'    method              = {identification.method}',
        f'    bags                = {", ".join(source.bags)}',
        f'    status              = {identification.status}',
        f'    evaluations         = {identification.evaluations}'
        f' in {identification.elapsed:.2f} s',
        f'    objective           = {quantity(identification.objective, digits=6)}',
        f'    chi square          = {quantity(identification.chi_square, digits=6)}',
        f'    reduced chi square  = {quantity(identification.reduced_chi_square, digits=4)}'
        f' ({identification.degrees_of_freedom} degrees of freedom)',
        f'    rms misfit          = {identification.noise_factor:.2f} times the noise, '
        f'{identification.sound_factor:.2f} times noise and small errors of a sound ring',
        '[[Parameters]]',
        *(f'    {parameter_words(name, entry)}' for name, entry in identification.entries.items()),
        f'    {INTERVALS}', *_lines_beside_errors(identification.beside_errors),
        '[[Stiffness in N/mm^n, as in ADAMS]]', *_stiffness_lines(identification),
        '[[Effect of small imperfections of the rig]]', *_imperfection_lines(identification),
        f'[[Correlations]] (below {CORRELATION_THRESHOLD} not shown)']
    pairs = {(first, second): float(identification.correlation[i, j])
             for (i, first), (j, second) in combinations(enumerate(PARAMETER_NAMES), 2)}
    lines += [
        f'    C({first}, {second}) = {value:+.4f}, '
        f'collinearity {identification.collinearity.get(f"{first},{second}", np.nan):.1f}'
        for (first, second), value in sorted(pairs.items(), key=lambda pair: -abs(pair[1]))
        if abs(value) >= CORRELATION_THRESHOLD]
    if identification.notes:
        lines += ['[[Notes]]', *(f'    {note}' for note in identification.notes)]
    return '\n'.join(lines)


def beside_errors_words(noise_factor: float, waves: float) -> str:
    """What a contact law beside errors of a ring is.

    noise_factor: rms misfit beside them, in noise; waves: rms [m] of the raceways, or 0.
    """
    beside = (f', beside raceways that wave by {quantity(waves, "m", digits=2)} (rms),'
              if waves else '')
    return (f'Usual small errors of friction, creep, structure, load and probes{beside} can '
            f'explain the misfit: {noise_factor:.2f} times the noise is left. These parameters '
            'beside the errors are the contact law of the rollers, and their intervals allow for '
            'such errors. A larger gain of the load or of all probes, or a wrong span, makes them '
            'wrong and leaves no misfit. With the first parameters a ring without errors comes '
            'nearest to the measurement.')


def _lines_beside_errors(law: FittedLaw | None) -> Iterator[str]:
    if law is not None:
        yield '[[Parameters beside small errors of the ring]]'
        yield from (f'    {parameter_words(name, entry)}' for name, entry in law.entries.items())
        yield f'    {beside_errors_words(law.noise_factor, law.waves.rms)}'


def _stiffness_lines(identification: Identification) -> Iterator[str]:
    contact = identification.parameters.contact
    ratios = line_contact_ratios(contact)
    for (name, stiffness), row in zip(stiffnesses_per_millimetre(vars(contact)).items(),
                                      ('axial rows', 'radial row'), strict=True):
        is_open = {name, f'n{name[1]}'} & identification.reasons.keys()
        yield (f'    {name} ({row}): {"best known " if is_open else ""}'
               f'{quantity(stiffness, "N/mm^n", digits=5)}, {significant(ratios[name], 2)} '
               'of one roller in Palmgren line contact (at 0.1 mm)')


def _imperfection_lines(identification: Identification) -> Iterator[str]:
    """How much each imperfection, which no fit can see, would change the free parameters."""
    for name, shift in identification.systematic.items():
        words = [
            f'{parameter} {value:+.3f}' if parameter[0] == 'n'
            else f'{parameter} {100.0 * value:+.1f} %'
            for parameter, value in _changes(shift).items()
            if np.isfinite(value) and abs(value) >= 5e-4]
        yield f'    {uncertainty.IMPERFECTION_WORDS[name]}: {", ".join(words) or "no change"}'


def _changes(shift: Array) -> dict[str, float]:
    """Changes by name from a shift (6,) in coordinates: of n itself, of K and D as a share."""
    return {name: float(value if name[0] == 'n' else np.expm1(np.clip(value, -9, 9)))
            for name, value in zip(PARAMETER_NAMES, shift, strict=True)}


def parameter_words(name: str, entry: Mapping[str, Any]) -> str:
    """A parameter with error and interval, or why it is open, from its entry in the JSON."""
    value, unit, std = entry['value'], entry['unit'], entry['std']
    if not entry['pinned']:
        bound = ' (at boundary)' if entry['at_bound'] else ''
        best = f'{quantity(value, unit)}{bound}'
        return uncertainty.undetermined_words(name, best, entry['reason'])
    low, high = entry['interval'] or (np.nan, np.nan)
    return (f'{name}: {quantity(value, unit, std)} ({percent(std / abs(value))}), '
            f'95 % interval {span(low, high)}')
