"""The report of a fleet: one HTML page, with rings and rigs that need attention first."""

from collections import Counter
from collections.abc import Sequence
import math

import numpy as np

from saddlering_ros.fleet.attention import Fleet, RingJudgement
from saddlering_ros.fleet.drifts import words_of
from saddlering_ros.fleet.observations import Array, COORDINATES
from saddlering_ros.fleet.statistics import LEVEL
from saddlering_ros.pages import html
from saddlering_ros.pages.charts import AFTER, Chart, line, markers, MEASURED, NOISE, Panel, Series

MAX_DRAWN = 12
"""Rings whose histories are drawn, those of most concern first."""

EPOCH = 1970.0
"""Year from which the calendar time of a history counts (`SessionFigures.time`)."""

UNLIKE_TEST = (
    'Test the ring on another rig. If it differs there too, measure its clearances. If it does '
    'not, the rig is at fault.'
)
"""Test that separates a ring that differs from the rig that tested it."""


def fleet_page(fleet: Fleet, failures: Sequence[tuple[str, str]]) -> str:
    """The page; failures: name of a session without a verdict, and the reason."""
    flagged = [ring for ring in fleet.rings if ring.reasons]
    verdicts = Counter(session.verdict for session in fleet.sessions)
    words = ', '.join(f'{count} {name}' for name, count in verdicts.most_common())
    return html.page('Fleet of rings', [
        '<h1>Rings and rigs of this campaign</h1>',
        html.tiles([
            (str(len(fleet.rings)), 'rings'), (str(len(fleet.sessions)), f'sessions: {words}'),
            (str(len(flagged)), 'rings that need attention'),
            (str(len(fleet.rigs)), 'rigs that drift'),
            (str(len(failures)), 'sessions without a verdict')]),
        _needs_a_person(fleet, flagged), _histories(fleet), _all_rings(fleet),
        html.section('Sessions without a verdict', html.table(
            ['session', 'reason'], [[name, reason] for name, reason in failures])),
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


def _needs_a_person(fleet: Fleet, flagged: Sequence[RingJudgement]) -> str:
    rigs = [f'Rig {drift.owner}: most of its rings drift together ({words_of(drift.group)}). The '
            f'rig is at fault, not the rings. {drift.next_test}' for drift in fleet.rigs]
    rows: list[list[str | html.Cell]] = []
    for ring in flagged:
        unit = 'h' if ring.history.clock == 'service_hours' else 'years'
        life = '; '.join(
            f'{name}: {_long(life.median)} {unit} ({_long(life.low)} to {_long(life.high)})'
            for name, life in ring.life.items())
        links = ', '.join(
            f'<a href="{html.escape(session.report)}">{html.escape(session.name)}</a>'
            for session in ring.sessions if session.report)
        proposed = [session.next_test for session in reversed(ring.sessions) if session.next_test]
        if ring.unlike is not None and ring.unlike.stands:
            proposed.append(UNLIKE_TEST)
        next_test = ring.drift.next_test if ring.drift is not None else next(iter(proposed), '')
        rows.append([ring.ring, ring.bench, '; '.join(ring.reasons), next_test, life,
                     html.Cell(links, is_html=True)])
    head = ['ring', 'rig', 'why', 'next test', 'remaining life', 'reports']
    nothing = '' if rows or rigs else html.paragraph('No ring and no rig needs attention.')
    return html.section('Rings and rigs that need attention', html.bullets(rigs),
                        html.table(head, rows), nothing)


def _long(time: float) -> str:
    """A time of three digits, without an exponent."""
    return 'beyond the horizon' if math.isinf(time) else f'{float(f"{time:.3g}"):g}'


def _histories(fleet: Fleet) -> str:
    pictures = [
        html.picture(history_chart(ring), f'history_{ring.ring}', f'Ring {ring.ring}.')
        for ring in [item for item in fleet.rings if item.history.of][:MAX_DRAWN]]
    words = html.paragraph(
        f'The {MAX_DRAWN} rings of most concern. Points: values with two standard deviations. '
        'Line: the level of the trend. A dashed line is a service. Stiffness and damping are '
        'shown as change in percent.', 'note')
    return html.section('Histories', words, *pictures) if pictures else ''


def history_chart(ring: RingJudgement) -> Chart:
    """Readings with two standard deviations, the filtered level, services as dashed lines.

    Logarithms are drawn as percent of the first level, exponents and sizes unchanged.
    """
    by_hours = ring.history.clock == 'service_hours'
    begin, label = (0.0, 'time / h') if by_hours else (EPOCH, 'year')
    panels = []
    for column, (name, history) in enumerate(ring.history.of.items()):
        series, first = history.series, history.level[0]
        is_relative = name.startswith(('stiffness', 'damping'))

        def shown(numbers: Array, first: float = first, is_relative: bool = is_relative) -> Array:
            return np.asarray(100.0 * np.expm1(numbers - first)) if is_relative else numbers

        low, high = shown(series.value - 2.0 * series.std), shown(series.value + 2.0 * series.std)
        time = begin + series.time
        renewed = time[series.renewed]
        ends = float(low.min()), float(high.max())
        drawn = (
            _strokes(renewed, np.full(renewed.size, ends[0]), np.full(renewed.size, ends[1]),
                     '--'),
            _strokes(time, low, high), line(time, shown(history.level), AFTER),
            markers(time, shown(series.value), 'o', MEASURED, size=3.0))
        panels.append(Panel(
            0, column, label, 'change / %' if is_relative else 'value', drawn,
            title=name.replace('_', ' '), shows_y_label=False))
    return Chart(tuple(panels), width=11.4, height=2.1, columns=len(panels))


def _strokes(x: Array, low: Array, high: Array, dash: str = '-') -> Series:
    """Upright strokes as one line, with NaN between them."""
    gaps = np.full(x.size, np.nan)
    return line(np.stack([x, x, gaps], axis=1).ravel(),
                np.stack([low, high, gaps], axis=1).ravel(), NOISE, dash=dash, width=0.9)


def _all_rings(fleet: Fleet) -> str:
    head: list[str | html.Cell] = ['ring', 'rig', html.number('sessions'), html.number('e-value'),
            *(html.number(f'z {name.replace("_", " ")}') for name in COORDINATES), 'concern']
    rows: list[list[str | html.Cell]] = []
    for ring in fleet.rings:
        scores = ['' if ring.unlike is None else f'{value:+.1f}'
                  for value in (ring.unlike.z_scores if ring.unlike else [0.0] * 6)]
        rows.append([
            ring.ring, ring.bench, html.number(str(len(ring.sessions))),
            html.number(f'{ring.e_value:.3g}'), *map(html.number, scores),
            '; '.join(ring.reasons)])
    return html.section('All rings by concern', html.table(
        head, rows, 'z: distance from the other rings in standard deviations'))
