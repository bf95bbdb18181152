"""Chapters on contact parameters: identified, of a file, and before and after a diagnosis."""

from collections.abc import Mapping
import math
from typing import Any

import numpy as np

from saddlering_ros.diagnosis.ring_wording import causes_of, VerdictDocument
from saddlering_ros.identification.result import INTERVALS
from saddlering_ros.pages import html
from saddlering_ros.pages.html import Cell, code, number
from saddlering_ros.quantities import compact, quantity, span, WIDTH_95
from saddlering_ros.report.figures import Array
from saddlering_ros.rig import (
    PARAMETER_NAMES,
    PARAMETER_UNITS,
    ParameterSet,
    stiffness_per_millimetre,
)

STRONG = 0.9
"""A correlation of parameters beyond which neither is known without the other."""

Row = list[str | Cell]
HEAD = ('parameter', number('value ± standard deviation'), number('95 % interval'), '')
UNDETERMINED = 'not determined by these data: '
ASSUMPTION = ('Every dimension of the rig is an assumption of this project, so the parameters are '
              "equivalent ones: they reproduce the ring's response, not a single roller's.")
OF_NOISE = ('Where no cause is in the model, standard deviations of a parameter file count noise '
            'alone. They hold for another test of the same ring. The intervals of identify also '
            'allow for unequal rollers.')


def identified(found: Mapping[str, Any], words: str = '') -> str:
    """Result of an identification: values, errors, intervals, undetermined parameters."""
    items = {name: found['parameters'][name] for name in PARAMETER_NAMES}
    rows: list[Row] = [
        [code(name), quantity(item['value'], item['unit'], item['std']),
         span(*item['interval']) if item['interval'] else '–',
         UNDETERMINED + item['reason'] if item['reason'] else
         ('at its bound' if item['at_bound'] else '')] for name, item in items.items()]
    rows += _per_millimetre({name: item['value'] for name, item in items.items()})
    covariance = np.array([[math.nan if value is None else value for value in row]
                           for row in found.get('covariance') or []])
    return html.section(
        'Identification',
        html.paragraph(f'{found["evaluations"]} simulations in {found["elapsed"]:.1f} s; '
                       f'{found["status"]}.'),
        html.table(HEAD, rows, words), html.paragraph(INTERVALS, 'note'),
        correlation(covariance if covariance.shape == (6, 6) else None),
        html.paragraph(ASSUMPTION, 'note'), html.bullets(list(found.get('notes') or [])))


def before_and_after(document: VerdictDocument, covariance: Array | None = None) -> str:
    """Contact parameters before and after, with intervals, correlation, and the bias removed."""
    first, last = document['parameters']['before'], document['parameters']['after']
    reasons = document['parameters'].get('undetermined', {}).get('after', {})
    is_extended = bool(causes_of(document))  # Without a cause, columns of the change are empty.
    rows: list[Row] = []
    for name in PARAMETER_NAMES:
        if name not in first or name not in last:
            continue
        std = None if name in reasons else last.get(f'{name}_std')
        ratio = first[name] / last[name]
        moved = '–' if name in reasons else '0 %' if abs(ratio - 1.0) < 5e-4 else (
            f'{100.0 * (ratio - 1.0):+.2g} %' if 0.5 < ratio < 1.5 else f'× {ratio:.2g}')
        rows.append([
            code(name), quantity(first[name], PARAMETER_UNITS[name]) if is_extended else '',
            quantity(last[name], PARAMETER_UNITS[name], std), interval(last[name], std),
            moved if is_extended else '',
            f'{abs(first[name] - last[name]) / std:.1f}' if std and is_extended else '–',
            UNDETERMINED + reasons[name] if name in reasons else ''])
    rows += [[name, before_words if is_extended else '', after_words, *[''] * 4]
             for (name, before_words, *_), (_, after_words, *_) in zip(
                 _per_millimetre(first), _per_millimetre(last), strict=True)]
    return html.section(
        'Contact parameters',
        html.table(['parameter', *map(number, (
            'before', f'{"after" if is_extended else "value"} ± standard deviation',
            '95 % interval', 'bias removed', 'bias / std')), ''], rows),
        correlation(covariance),
        html.paragraph(ASSUMPTION + ' K and n of a row are strongly correlated: judge them '
                       'together.', 'note'),
    )


def interval(value: float, std: float | None) -> str:
    """The 95 % interval about a value; a dash without a standard deviation."""
    return span(value - WIDTH_95 * std, value + WIDTH_95 * std) if std else '–'


def _per_millimetre(values: Mapping[str, float]) -> list[Row]:
    """K1 and K2 of parameters by name, each with its stiffness as catalogues give it."""
    return [[code(name), quantity(stiffness_per_millimetre(values[name], values[exponent]),
                                  'N/mm^n'), '', '']
            for name, exponent in (('K1', 'n1'), ('K2', 'n2'))
            if name in values and exponent in values]


def of_file(parameters: ParameterSet) -> str:
    """The parameter file: contact law with errors, effects, correlation, where it came from."""
    source, covariance = parameters.source, parameters.source.covariance
    spread = [None] * 6 if covariance is None else np.sqrt(np.diag(covariance)).tolist()
    values_of = {name: float(getattr(parameters.contact, name)) for name in PARAMETER_NAMES}
    rows: list[Row] = []
    for (name, value), std in zip(values_of.items(), spread, strict=True):
        reason = source.undetermined.get(name)
        shown = std if reason is None else None
        rows.append([code(name), quantity(value, PARAMETER_UNITS[name], shown),
                     interval(value, shown), '' if reason is None else UNDETERMINED + reason])
    rows += _per_millimetre(values_of)
    rows += [[code(f'{effect}.{name}'), f'{compact(value, 5)} (SI)', '', '']
             for effect, values in parameters.effects.items() for name, value in values.items()]
    words = 'As given' if source.method == 'given' else f'By {source.method}'
    words += f' from {", ".join(source.bags)}' if source.bags else ''
    return html.section(
        'Parameters',
        html.table(HEAD, rows, words + (f': {source.note}' if source.note else '')),
        correlation(covariance),
        html.paragraph('' if covariance is None or source.method == 'given' else OF_NOISE, 'note'),
        html.paragraph(ASSUMPTION, 'note'))


def correlation(covariance: Array | None) -> str:
    """A table of correlations of the contact parameters; empty if they are not known."""
    if covariance is None or not np.isfinite(covariance).all():
        return ''
    spread = np.sqrt(np.diag(covariance))
    scale = np.outer(spread, spread)
    shares = np.divide(covariance, scale, out=np.zeros_like(covariance), where=scale > 0.0)
    rows: list[Row] = [
        [code(name), *(_heat(share) if size > 0.0 else Cell('–', mark='heat')
                       for share, size in zip(*of, strict=True))]
        for name, *of in zip(PARAMETER_NAMES, shares, scale, strict=True)]
    strong = [f'{PARAMETER_NAMES[i]} and {PARAMETER_NAMES[j]}'
              for i, j in zip(*np.triu_indices(6, 1), strict=True) if abs(shares[i, j]) > STRONG]
    words = (f'Strongly correlated: {"; ".join(strong)}.' if strong
             else 'No correlation exceeds 0.9.')
    return html.heading('Correlation') + html.table(
        ['', *map(number, PARAMETER_NAMES)], rows) + html.paragraph(words, 'note')


def _heat(value: float) -> Cell:
    hue = '31,111,178' if value >= 0.0 else '209,73,91'
    return Cell(f'<span style="background:rgba({hue},{0.45 * abs(value):.2f});padding:1px 7px">'
                f'{value:+.2f}</span>'.replace('-', '−'), is_number=True, is_html=True)
