"""The report of a fleet: one HTML page, with rings and rigs that need attention first."""

from collections import Counter
from collections.abc import Sequence
import math
from textwrap import fill

import numpy as np

from saddlering_ros.fleet.attention import Fleet, RingJudgement
from saddlering_ros.fleet.history import words_of
from saddlering_ros.fleet.statistics import COORDINATES, LEVEL
from saddlering_ros.pages import charts, html

MAX_DRAWN = 12
"""Rings whose histories are drawn, those of most concern first."""

MAX_TITLE = 22
"""Letters of a line above a picture of a history."""

EPOCH = 1970.0
"""Year from which the calendar time of a history counts (`SessionFigures.time`)."""

UNLIKE_TEST = ('Test the ring on another rig. If it differs there too, measure its clearances. If '
               'it does not, the rig is at fault.')
"""Test that separates a ring that differs from the rig that tested it."""


def fleet_page(fleet: Fleet, failures: Sequence[tuple[str, str]]) -> str:
    """The page; failures: name of a session without a verdict, and the reason."""
    flagged = [ring for ring in fleet.rings if ring.reasons]
    verdicts = Counter(session.verdict for session in fleet.sessions).most_common()
    rigs = [f'Rig {drift.owner}: most of its rings drift together ({words_of(drift.group, {})}). '
            f'The rig is at fault, not the rings. {drift.next_test}' for drift in fleet.rigs]
    pictures = [
        html.picture(history_chart(ring), f'history_{ring.ring}', f'Ring {ring.ring}.')
        for ring in [ring for ring in fleet.rings if ring.history.of][:MAX_DRAWN]]
    every: list[list[str | html.Cell]] = [
        [html.code(ring.ring), ring.bench, str(len(ring.sessions)), f'{ring.e_value:.3g}',
         *([''] * len(COORDINATES) if ring.unlike is None else
           [f'{value:+.1f}' for value in ring.unlike.z_scores]), '; '.join(ring.reasons)]
        for ring in fleet.rings]
    return html.page('Fleet of rings', [
        '<h1>Rings and rigs of this campaign</h1>',
        html.tiles([
            (str(len(fleet.rings)), 'rings'), (str(len(fleet.sessions)), 'sessions: ' + ', '.join(
                f'{count} {name}' for name, count in verdicts)),
            (str(len(flagged)), 'rings that need attention'),
            (str(len(fleet.rigs)), 'rigs that drift'),
            (str(len(failures)), 'sessions without a verdict')]),
        html.section(
            'Rings and rigs that need attention', html.bullets(rigs),
            html.table(['ring', 'rig', 'why', 'next test', 'remaining life (90 %)', 'reports'],
                       [_attention(ring) for ring in flagged]),
            '' if flagged or rigs else html.paragraph('No ring and no rig needs attention.')),
        html.section('Histories', html.paragraph(
            f'The {MAX_DRAWN} rings of most concern. Points: values with two standard deviations. '
            'Line: the level of the trend. A dashed line is a service. Stiffness and damping are '
            'shown as change in percent. 1: axial rows, 2: radial row.', 'note'), *pictures)
        if pictures else '',
        html.section('All rings by concern', html.table(
            ['ring', 'rig', *map(html.number, (
                'sessions', 'e-value', *(f'z {name.replace("_", " ")}' for name in COORDINATES))),
             'concern'], every, 'z: distance from the other rings in standard deviations')),
        html.section('Sessions without a verdict', html.table(['session', 'reason'], failures)),
        html.section('How to read this page', html.bullets([
            f'At most {100 * LEVEL:g} % of the findings listed are expected to be false: '
            'Benjamini-Hochberg over sessions and drifts, e-values over the sessions of a ring.',
            f'Sessions of one ring scatter {fleet.inflation:.2f} times as much (in variance) as '
            'their own intervals; all statistics here include that factor.',
            'A drift of stiffness and damping by the same share can be a drift of the load cell. '
            'Then both are listed, and a dead weight on the load cell tells them apart.',
            'Remaining life is given only for a significant drift whose predictions of the next '
            'session were correct.'])),
    ])


def _attention(ring: RingJudgement) -> list[str | html.Cell]:
    """The row of a ring that needs a person."""
    unit = 'h' if ring.history.clock == 'service_hours' else 'years'
    lives = [(name, *('beyond the horizon' if math.isinf(time) else f'{float(f"{time:.3g}"):g}'
                      for time in (life.median, life.low, life.high)))
             for name, life in ring.life.items()]
    links = ', '.join(
        f'<a href="{html.escape(session.report)}">{html.escape(session.name)}</a>'
        for session in ring.sessions if session.report)
    proposed = [session.next_test for session in reversed(ring.sessions) if session.next_test]
    if ring.unlike is not None and ring.unlike.stands:
        proposed.append(UNLIKE_TEST)
    if ring.drift is not None:
        proposed.insert(0, ring.drift.next_test)
    life = '; '.join(f'{name}: {median} {unit} ({low} to {high})'
                     for name, median, low, high in lives)
    return [html.code(ring.ring), ring.bench, '; '.join(ring.reasons), next(iter(proposed), ''),
            life, html.Cell(links, is_html=True)]


def history_chart(ring: RingJudgement) -> charts.Chart:
    """Readings with two standard deviations, the filtered level, services as dashed lines.

    Logarithms are drawn as percent of the first level, exponents and sizes unchanged.
    """
    by_hours = ring.history.clock == 'service_hours'
    panels = []
    for column, (name, history) in enumerate(ring.history.of.items()):
        series = history.series
        curves = np.array([series.value - 2.0 * series.std, series.value + 2.0 * series.std,
                           history.level, series.value])
        is_relative = name.startswith(('stiffness', 'damping'))
        low, high, level, value = (100.0 * np.expm1(curves - history.level[0]) if is_relative
                                   else curves)
        time = series.time + (0.0 if by_hours else EPOCH)
        renewed = time[series.renewed]
        panels.append(charts.Panel(
            0, column, 'time / h' if by_hours else 'year',
            'change / %' if is_relative else 'value', (
                charts.strokes(renewed, np.full(renewed.size, low.min()),
                               np.full(renewed.size, high.max()), dash='--', width=0.9),
                charts.strokes(time, low, high, width=0.9),
                charts.line(time, level, charts.AFTER),
                charts.markers(time, value, 'o', charts.MEASURED, size=3.0)),
            title=fill(ring.titles.get(name, name.replace('_', ' ')), MAX_TITLE)
            + ' / %' * is_relative, shows_y_label=False))
    return charts.Chart(tuple(panels), width=11.4, height=2.1, columns=len(panels))
