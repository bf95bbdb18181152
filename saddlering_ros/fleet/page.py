"""The report of a fleet: one HTML page, with rings and rigs that need attention first."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
import html as markup
import math

from saddlering_ros.fleet.drawing import history_drawing, verdicts_drawing
from saddlering_ros.fleet.drifts import Drift, words_of
from saddlering_ros.fleet.judgement import Fleet, RingJudgement
from saddlering_ros.fleet.observations import COORDINATES
from saddlering_ros.report import html

MAX_DRAWN = 40
"""Rings whose histories are drawn."""

CSS = ('<style>.row { display: flex; flex-wrap: wrap; gap: 4px 8px; }\n'
       'td:nth-child(-n+2) { white-space: nowrap; }</style>')


UNLIKE_TEST = (
    'Test the ring on another rig. If it differs there too, measure its clearances. If it does '
    'not, the rig is at fault.'
)
"""Test that separates a ring that differs from the rig that tested it."""


def fleet_page(fleet: Fleet, failures: Sequence[tuple[str, str]]) -> str:
    """The page; failures: name of a session without a verdict, and the reason."""
    flagged = [item for item in fleet.rings if item.reasons]
    return html.page('Fleet of rings', [
        CSS, '<h1>Rings and rigs of this campaign</h1>', _tiles(fleet, flagged, failures),
        _needs_a_person(fleet, flagged), html.section('Verdicts over time',
                                                      verdicts_drawing(fleet.sessions)),
        _histories(fleet), _all_rings(fleet), _failures(failures), _method(fleet),
    ])


def _tiles(
    fleet: Fleet, flagged: Sequence[RingJudgement], failures: Sequence[tuple[str, str]]
) -> str:
    verdicts = Counter(item.verdict for item in fleet.sessions)
    words = ', '.join(f'{count} {name}' for name, count in verdicts.most_common())
    return html.tiles([
        (str(len(fleet.rings)), 'rings'), (str(len(fleet.sessions)), f'sessions: {words}'),
        (str(len(flagged)), 'rings that need attention'), (str(len(fleet.rigs)), 'rigs that '
                                                                                 'drift'),
        (str(len(failures)), 'sessions without a verdict'),
    ])


def _needs_a_person(fleet: Fleet, flagged: Sequence[RingJudgement]) -> str:
    rigs = [_rig_line(drift) for drift in fleet.rigs]
    rows: list[list[str | html.Cell]] = [
        [item.ring, item.bench, '; '.join(item.reasons), _next_test(item), _life(item),
         _links(item)]
        for item in flagged
    ]
    head = ['ring', 'rig', 'why', 'next test', 'remaining life', 'reports']
    nothing = '' if rows or rigs else html.paragraph('No ring and no rig needs attention.')
    return html.section('Rings and rigs that need attention', html.bullets(rigs),
                        html.table(head, rows), nothing)


def _rig_line(drift: Drift) -> str:
    return (f'Rig {drift.owner}: most of its rings drift together ({words_of(drift.group)}). The '
            f'rig is at fault, not the rings. {drift.next_test}')


def _next_test(item: RingJudgement) -> str:
    if item.drift is not None:
        return item.drift.next_test
    found = next((session.next_test for session in reversed(item.sessions) if session.next_test),
                 '')
    if not found and item.unlike is not None and item.unlike.stands:
        return UNLIKE_TEST
    return found


def _life(item: RingJudgement) -> str:
    unit = 'h' if item.history.clock == 'service_hours' else 'years'
    return '; '.join(
        f'{name}: {_long(life.median)} {unit} ({_long(life.low)} to {_long(life.high)})'
        for name, life in item.life.items())


def _long(time: float) -> str:
    """A time of three digits, without an exponent."""
    return 'beyond the horizon' if math.isinf(time) else f'{float(f"{time:.3g}"):g}'


def _links(item: RingJudgement) -> html.Cell:
    links = [
        f'<a href="{markup.escape(session.report)}">{markup.escape(session.name)}</a>'
        for session in item.sessions if session.report
    ]
    return html.Cell(', '.join(links), is_html=True)


def _histories(fleet: Fleet) -> str:
    rows = []
    for item in [ring for ring in fleet.rings if ring.history.of][:MAX_DRAWN]:
        drawings = ''.join(
            history_drawing(found, name.replace('_', ' '), item.history.clock)
            for name, found in item.history.of.items())
        rows.append(f'{html.heading(item.ring)}<div class="row">{drawings}</div>')
    words = html.paragraph(
        'Points: values with two standard deviations. Line: the level of the trend. A dashed '
        'line is a service. Stiffness and damping are shown as change in percent.', 'note')
    return html.section('Histories', words, *rows) if rows else ''


def _all_rings(fleet: Fleet) -> str:
    head: list[str | html.Cell] = ['ring', 'rig', html.number('sessions'), html.number('e-value'),
            *(html.number(f'z {name.replace("_", " ")}') for name in COORDINATES), 'concern']
    rows: list[list[str | html.Cell]] = []
    for item in fleet.rings:
        scores = ['' if item.unlike is None else f'{value:+.1f}'
                  for value in (item.unlike.z_scores if item.unlike else [0.0] * 6)]
        rows.append([
            item.ring, item.bench, html.number(str(len(item.sessions))),
            html.number(f'{item.e_value:.3g}'), *map(html.number, scores),
            '; '.join(item.reasons)])
    return html.section('All rings by concern', html.table(
        head, rows, 'z: distance from the other rings in standard deviations'))


def _failures(failures: Sequence[tuple[str, str]]) -> str:
    rows = [[name, reason] for name, reason in failures]
    return html.section('Sessions without a verdict', html.table(['session', 'reason'], rows))


def _method(fleet: Fleet) -> str:
    return html.section('How to read this page', html.bullets([
        f'At most {100 * fleet.level:g} % of the findings listed are expected to be false: '
        'Benjamini-Hochberg over sessions and drifts, e-values over the sessions of a ring.',
        f'Sessions of one ring scatter {fleet.inflation:.2f} times as much (in variance) as '
        'their own intervals; all statistics here include that factor.',
        'A drift of stiffness and damping by the same share can be a drift of the load cell. '
        'Then both are listed, and a dead weight on the load cell tells them apart.',
        'Remaining life is given only for a significant drift whose predictions of the next '
        'session were correct.',
    ]))
