"""Chapter: the law that would explain a misfit without a known cause."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from saddlering_ros.diagnosis.contract import VerdictDocument
from saddlering_ros.quantities import percent, quantity
from saddlering_ros.report import html
from saddlering_ros.report.charts import Chart, line, Panel
from saddlering_ros.report.html import Cell, code, number
from saddlering_ros.report.style import AFTER, MICRO
from saddlering_ros.rig import FORCE_UNITS, MICRO_UNITS


def proposal(document: VerdictDocument, force_unit: str = 't') -> str:
    """The proposed law with its curve, misfit reduction and doubts; empty without a law.

    force_unit: unit in which loads are shown.
    """
    law = document.get('proposal')
    if not law:
        return ''
    gain = law['gain']
    kept = gain['held_out']
    worth = f'The law reduces the misfit by {percent(gain["fit"])} on fitted runs' + (
        '.' if kept is None else f' and by {percent(kept)} on held-out runs.')
    parts = [html.paragraph('A proposal; the verdict stays unknown.', 'soft'),
             html.paragraph(worth)]
    for place, term in enumerate(law['terms']):
        parts += _term(term, place, force_unit)
    parts += [html.heading('Doubts') if law['doubts'] else '', html.bullets(law['doubts'])]
    if law['effect_files']:
        parts.append(html.paragraph(
            f'Effect file, for the next diagnosis: {", ".join(law["effect_files"])}.', 'note'))
    return html.section('A law that would explain the misfit', *parts)


def _term(term: Mapping[str, Any], place: int, force_unit: str) -> list[str]:
    rows: list[list[str | Cell]] = [
        [code(name), number(quantity(item['value'], item['unit'], item['std']))]
        for name, item in term['parameters'].items()]
    words = f'{term["channel"]} += {term["law"]} in {term["coordinate"]}'
    return [
        html.heading(words), html.commands([term['formula']]),
        html.table(['parameter', number('value ± standard deviation')], rows),
        html.picture(_curve(term, force_unit), f'proposal_{place + 1}', f'{words}: the addition, '
                     'with twice its standard deviation (dotted).')]


def _curve(term: Mapping[str, Any], force_unit: str) -> Chart:
    """The addition of the term over its coordinate."""
    curve = term['curve']
    newtons = FORCE_UNITS[force_unit]
    size, unit = {'N': (newtons, force_unit), 'N/s': (newtons, f'{force_unit}/s'),
                  '1': (1.0, '')}.get(curve['at_unit'], (1.0, curve['at_unit']))
    at = np.array(curve['at'], float) / size
    is_load = curve['unit'] == 'N'
    scale = 1.0 / newtons if is_load else MICRO
    values, spread = (scale * np.array(curve[key], float) for key in ('values', 'std'))
    shown = force_unit if is_load else MICRO_UNITS.get(term['channel'], 'µm')
    across = term['coordinate'] + (f' / {unit}' if unit else '')
    series = (line(at, values, AFTER, 'proposed law'),
              line(at, values - 2.0 * spread, AFTER, dash=':'),
              line(at, values + 2.0 * spread, AFTER, dash=':'))
    panel = Panel(0, 0, across, f'{term["channel"]} / {shown}', series, levels=(0.0,))
    return Chart((panel,), width=7.0, height=3.2)
