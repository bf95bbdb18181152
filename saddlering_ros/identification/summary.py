"""An identification and a validation in plain text, as the commands print them."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from saddlering_ros.estimation.identifiability import undetermined_words
from saddlering_ros.identification.criteria import judge
from saddlering_ros.identification.result import Identification, line_contact_ratios
from saddlering_ros.identification.uncertainty import IMPERFECTIONS
from saddlering_ros.identification.validation import Validation
from saddlering_ros.quantities import percent, quantity, significant, span
from saddlering_ros.rig import PARAMETER_NAMES, PARAMETER_UNITS, stiffness_per_millimetre

CORRELATION_THRESHOLD = 0.5

INTERVALS = (
    'Errors and intervals allow for noise and for unequal rollers. They do not allow for a wrong '
    'weight of the moving mass or for the imperfections that saddlering identify lists.')
"""Sentence beside the intervals of an identification, in the text and in the report."""

VALIDATION_COLUMNS = (
    ('rmse', 'rmse'), ('nrmse', 'nrmse %'), ('noise_floor', 'noise %'), ('maximum', 'max'),
    ('bias', 'bias'), ('zero_error', 'zero'), ('slope_ratio', 'slope'), ('loop_area', 'loop %'),
    ('zero_return', 'return'), ('time_shift', 'shift ms'), ('iso18571', 'ISO'),
    ('e_over_uval', 'E/u_val'),
)

COLUMN_WORDS = (
    ('rmse', 'rms of measured minus simulated, without the zero error, in µm or µrad'),
    ('nrmse %', "rmse in % of the channel's measured range"),
    ('noise %', 'rms noise of the measurement in % of the same range'),
    ('max', 'largest difference, in µm or µrad'),
    ('bias', 'mean of measured minus simulated, in µm or µrad'),
    ('zero', 'part of the bias that the noise of the zero explains, in µm or µrad'),
    ('slope', 'slope of measured over simulated; 1 if the stiffness is right'),
    ('loop %', 'area of the measured loop over load minus that of the simulated loop, in % of '
               'load range times channel range; shows friction and damping'),
    ('return', 'measured minus simulated at the end of the test, in µm or µrad'),
    ('shift ms', 'delay of the measurement after the simulation; dynamic tests only'),
    ('ISO', 'overall rating of the curve after ISO 18571, 0 to 1'),
    ('E/u_val', 'comparison error over validation uncertainty after ASME V&V 20'),
)
"""Content of each column of the table of a validation."""

SCALES = {
    'nrmse': 100.0, 'noise_floor': 100.0, 'loop_area': 100.0, 'time_shift': 1e3,
    'rmse': 1e6, 'maximum': 1e6, 'bias': 1e6, 'zero_return': 1e6,
    'zero_error': 1e6,
}


def identification_text(found: Identification) -> str:
    """Method, evaluations, chi square, values with errors, bounds, correlations, notes."""
    source = found.parameters.source
    lines = [
        '[[Identification]]',
        f'    method              = {found.method}',
        f'    bags                = {", ".join(source.bags)}',
        f'    status              = {found.status}',
        f'    evaluations         = {found.evaluations} in {found.elapsed:.2f} s',
        f'    objective           = {quantity(found.objective, digits=6)}',
        f'    chi square          = {quantity(found.chi_square, digits=6)}',
        f'    reduced chi square  = {quantity(found.reduced_chi_square, digits=4)}'
        f' ({found.degrees_of_freedom} degrees of freedom)',
        '[[Parameters]]',
        *(f'    {parameter_words(name, found.parameter_entry(index, name))}'
          for index, name in enumerate(PARAMETER_NAMES)),
        f'    {INTERVALS}',
        *_stiffness_lines(found),
        *_systematic_lines(found),
        *_correlation_lines(found),
    ]
    if found.profiles:
        lines += ['[[Profile likelihood, 95 %]]', *_profile_lines(found)]
    if found.notes:
        lines += ['[[Notes]]', *(f'    {note}' for note in found.notes)]
    return '\n'.join(lines)


def parameter_words(name: str, entry: Mapping[str, Any]) -> str:
    """A parameter with error and interval, or why it is open, from its entry in the JSON."""
    value, unit, std = entry['value'], entry['unit'], entry['std']
    if not entry['pinned']:
        bound = ' (at boundary)' if entry['at_bound'] else ''
        return undetermined_words(name, f'{quantity(value, unit)}{bound}', entry['reason'])
    low, high = entry['interval'] or (np.nan, np.nan)
    return (f'{name}: {quantity(value, unit, std)} ({percent(std / abs(value))}), '
            f'95 % interval {span(low, high)}')


def _stiffness_lines(found: Identification) -> list[str]:
    contact = found.parameters.contact
    ratios = line_contact_ratios(contact)
    lines = ['[[Stiffness in N/mm^n, as in ADAMS]]']
    for row, name in ((1, 'axial'), (2, 'radial')):
        stiffness, exponent = getattr(contact, f'K{row}'), getattr(contact, f'n{row}')
        lines.append(
            f'    K{row} ({name} row{"s" if row == 1 else ""}): '
            f'{quantity(stiffness_per_millimetre(stiffness, exponent), "N/mm^n", digits=5)}, '
            f'{significant(ratios[f"K{row}"], 2)} of one roller in Palmgren line contact '
            '(at 0.1 mm)'
        )
    return lines


def _systematic_lines(found: Identification) -> list[str]:
    """How much each imperfection, which no fit can see, would change the free parameters."""
    known = {one.name: one.words for one in IMPERFECTIONS}
    lines = ['[[Effect of small imperfections of the rig]]']
    for name, shift in found.systematic.items():
        words = [
            f'{parameter} {value:+.3f}' if parameter[0] == 'n'
            else f'{parameter} {100.0 * np.expm1(np.clip(value, -9, 9)):+.1f} %'
            for parameter, value in zip(PARAMETER_NAMES, shift, strict=True)
            if np.isfinite(value) and abs(value) >= 5e-4
        ]
        lines.append(f'    {known.get(name, name)}: {", ".join(words) or "no change"}')
    return lines


def _correlation_lines(found: Identification) -> list[str]:
    pairs = [
        (first, second, float(found.correlation[i, j]))
        for i, first in enumerate(PARAMETER_NAMES)
        for j, second in enumerate(PARAMETER_NAMES)
        if i < j and abs(found.correlation[i, j]) >= CORRELATION_THRESHOLD
    ]
    lines = [f'[[Correlations]] (below {CORRELATION_THRESHOLD} not shown)']
    lines += [
        f'    C({first}, {second}) = {value:+.4f}, '
        f'collinearity {found.collinearity.get(f"{first},{second}", np.nan):.1f}'
        for first, second, value in sorted(pairs, key=lambda pair: -abs(pair[2]))
    ]
    return lines


def _profile_lines(found: Identification) -> list[str]:
    lines = []
    for name, profile in found.profiles.items():
        low, high = profile.interval
        if low is not None and high is not None:
            lines.append(f'    {name}: {span(low, high)}')
        else:
            ends = ['open' if end is None else quantity(end, digits=4) for end in (low, high)]
            lines.append(f'    {name}: {" to ".join(ends)}')
    return lines


def validation_text(validation: Validation) -> str:
    """A table with a line per run and channel, its columns explained, and every criterion."""
    widths = [max(9, len(title)) for _, title in VALIDATION_COLUMNS]
    head = f'{"channel":8s}  ' + '  '.join(
        title.rjust(width) for (_, title), width in zip(VALIDATION_COLUMNS, widths, strict=True)
    )
    lines = []
    for run in validation.runs:
        lines += [f'{run.name}: {run.test}, {np.degrees(run.elevation):g} deg', f'  {head}']
        for channel, figures in run.channels.items():
            cells = [
                _cell(getattr(figures, key), SCALES.get(key, 1.0)).rjust(width)
                for (key, _), width in zip(VALIDATION_COLUMNS, widths, strict=True)
            ]
            lines.append(f'  {channel:8s}  ' + '  '.join(cells))
        lines += [f'  note: {note}' for note in run.notes]
    lines += [''] if validation.parameters.source.undetermined else []
    lines += [
        undetermined_words(
            name, quantity(getattr(validation.parameters.contact, name), PARAMETER_UNITS[name]),
            reason)
        for name, reason in validation.parameters.source.undetermined.items()]
    lines += ['', 'columns:', *(f'  {title:9s}  {words}' for title, words in COLUMN_WORDS)]
    lines += ['', 'criteria:', *(f'  {item.line}' for item in judge(validation.runs))]
    return '\n'.join(lines)


def _cell(value: float | None, scale: float) -> str:
    if value is None or not np.isfinite(value):
        return '-'
    return significant(scale * value, 4)
