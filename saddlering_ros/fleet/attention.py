"""Sessions, rings and rigs of a fleet that need attention, with reasons, and their page."""

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
import math
from textwrap import fill
from typing import Any

import numpy as np
from numpy.typing import NDArray

from saddlering_ros.errors import plain_number
from saddlering_ros.fleet import history, statistics
from saddlering_ros.fleet.history import Drift, RemainingLife, RingHistory, words_of
from saddlering_ros.fleet.statistics import COORDINATES, FleetError, LEVEL, SessionFigures
from saddlering_ros.pages import charts, html
from saddlering_ros.progress import one_blas_thread
from saddlering_ros.quantities import finite_json
from saddlering_ros.rig import PARAMETER_NAMES


@dataclass(frozen=True)
class RingJudgement:
    """One ring: its sessions, whether they hold a finding, and how it compares and drifts."""

    ring: str
    bench: str
    sessions: tuple[SessionFigures, ...]
    e_value: float
    finding: bool
    unlike: statistics.Unlikeness | None
    history: RingHistory
    drift: Drift | None
    life: Mapping[str, RemainingLife]

    @property
    def concern(self) -> float:
        """Order of the table: rings that need a person first."""
        return len(self.reasons) + min(math.log10(max(self.e_value, 1.0)), 99.0) / 100.0

    @property
    def titles(self) -> dict[str, str]:
        """Titles of the causes by their ids."""
        return {name: title for session in self.sessions for name, title in session.titles.items()}

    @property
    def reasons(self) -> tuple[str, ...]:
        """Why the ring needs a person, in words; none if it does not."""
        answer = []
        if self.finding:
            names = sorted({words_of([name], session.titles)
                            for session in self.sessions for name in session.causes})
            answer.append(f'finding: {", ".join(names) or "cause unknown"}')
        if self.unlike is not None and self.unlike.stands:
            strongest = COORDINATES[int(np.argmax(np.abs(self.unlike.z_scores)))]
            answer.append(f'unlike the other rings in {words_of([strongest], {})}')
        if self.drift is not None:
            answer.append(f'drifts: {words_of(self.drift.group, self.titles)}')
        answer += filter(None, [self.sessions[-1].change])
        return tuple(answer)


@dataclass(frozen=True)
class Fleet:
    """Everything found about a fleet."""

    sessions: tuple[SessionFigures, ...]
    session_stands: NDArray[np.bool_]
    rings: tuple[RingJudgement, ...]
    rigs: tuple[Drift, ...]
    population: statistics.Population | None
    inflation: float


@one_blas_thread()
def judge_fleet(sessions: Sequence[SessionFigures],
                limits: Mapping[str, float] | None = None) -> Fleet:
    """The judgement on all sessions; `limits`: of K and D (SI) by name, for remaining life."""
    judged = [item for item in sessions if item.verdict != 'failed']
    rings: dict[str, list[SessionFigures]] = {session.ring: [] for session in judged}
    for session in sorted(judged, key=lambda item: (math.isnan(item.time), item.time, item.name)):
        rings[session.ring].append(session)
    # Values and covariances of the sessions that measured every coordinate.
    measured = {ring: (np.array([item.value for item in good]),
                       np.array([item.covariance for item in good]))
                for ring, tests in rings.items()
                if (good := [item for item in tests if np.isfinite(item.covariance).all()])}
    inflation = statistics.scatter_inflation(list(measured.values()))
    unlike, population = {}, None
    if len(measured) >= statistics.MIN_RINGS:
        means, spreads, _ = zip(*(statistics.weighted_mean(values, inflation * spread)
                                  for values, spread in measured.values()), strict=True)
        judgements, population = statistics.unlike_sisters(np.array(means), np.array(spreads))
        unlike = dict(zip(measured, judgements, strict=True))
    histories = {ring: history.histories_of(ring, [
        replace(one, covariance=inflation * one.covariance) for one in tests])
        for ring, tests in rings.items()}
    drifting, rigs = history.significant_drifts(list(histories.values()))
    of_ring = {item.owner: item for item in drifting}
    evidence = {ring: statistics.e_value([item.p_value for item in tests])
                for ring, tests in rings.items()}
    # e-BH: at any dependence between the rings.
    findings = statistics.benjamini_hochberg(
        [1.0 / max(value, 1e-300) for value in evidence.values()])
    answer = [
        RingJudgement(
            ring, tests[-1].bench, tuple(tests), evidence[ring], bool(is_finding),
            unlike.get(ring), histories[ring], of_ring.get(ring),
            _lives(histories[ring], tests, limits or {}) if ring in of_ring else {})
        for (ring, tests), is_finding in zip(rings.items(), findings, strict=True)]
    answer.sort(key=lambda item: (-item.concern, item.ring))
    return Fleet(
        tuple(judged), statistics.benjamini_hochberg([item.p_value for item in judged]),
        tuple(answer), tuple(rigs), population, inflation)


def _lives(followed: RingHistory, sessions: Sequence[SessionFigures],
           limits: Mapping[str, float]) -> dict[str, RemainingLife]:
    answer = {}
    for name, limit in limits.items():
        number = PARAMETER_NAMES.index(name)
        if COORDINATES[number] not in followed.of:
            continue
        reached = math.log(limit)
        if name.startswith('K'):  # at the ring's own mean exponent
            exponent = float(np.nanmean([item.value[number + 1] for item in sessions]))
            reached += (exponent - 1.0) * math.log(statistics.REFERENCE_PENETRATION)
        life = history.remaining_life(followed.of[COORDINATES[number]], reached)
        if life is not None:
            answer[name] = life
    return answer


def limits_from_text(texts: Sequence[str]) -> dict[str, float]:
    """Limits given as NAME=VALUE; FleetError names the one that cannot be used."""
    limits = {}
    for text in texts:
        name, _, value = text.partition('=')
        allowed = [parameter for parameter in PARAMETER_NAMES if not parameter.startswith('n')]
        if name not in allowed:
            raise FleetError(f'--limit {text}: give one of {", ".join(allowed)} as K1=6e7')
        try:
            limits[name] = plain_number(value)
        except ValueError:
            raise FleetError(f'--limit {text}: {value!r} is not a number: write NAME=NUMBER'
                             ) from None
        if not (math.isfinite(limits[name]) and limits[name] > 0.0):
            raise FleetError(f'--limit {text}: give a number above 0 (SI units)')
    return limits


def fleet_document(fleet: Fleet) -> dict[str, Any]:
    """fleet.json: plain data, numbers that are not finite as null."""
    population = fleet.population
    return dict(finite_json({
        'level': LEVEL,
        'sessions': {
            'total': len(fleet.sessions),
            'verdicts': dict(Counter(session.verdict for session in fleet.sessions)),
            'findings': [item.key for item, real in zip(
                fleet.sessions, fleet.session_stands, strict=True) if real]},
        'scatter_inflation': fleet.inflation,
        'coordinates': list(COORDINATES),
        'reference_penetration': statistics.REFERENCE_PENETRATION,
        'population': None if population is None else {
            'mean': population.mean.tolist(),
            'mean_covariance': population.mean_covariance.tolist(),
            'between_rings': population.between.tolist()},
        'rigs': [_drift_document(item) for item in fleet.rigs],
        'rings': [{
            'ring': ring.ring, 'rig': ring.bench, 'reasons': list(ring.reasons),
            'sessions': [session.key for session in ring.sessions],
            'e_value': ring.e_value, 'finding': ring.finding,
            'unlike_sisters': None if ring.unlike is None else {
                'p_value': ring.unlike.p_value, 'stands': ring.unlike.stands,
                'z_scores': dict(zip(COORDINATES, ring.unlike.z_scores.tolist(), strict=True))},
            'drift': None if ring.drift is None else _drift_document(ring.drift),
            'history': {'clock': ring.history.clock, 'coordinates': {
                name: {**{key: array.tolist() for key, array in {
                    **vars(item.series), 'level': item.level,
                    'level_std': item.level_std}.items()},
                    **{key: getattr(item, key) for key in (
                        'slope', 'slope_std', 'drift_p_value', 'predictions', 'coverage')}}
                for name, item in ring.history.of.items()}},
            'remaining_life': {name: {**vars(life), 'clock': ring.history.clock}
                               for name, life in ring.life.items()},
        } for ring in fleet.rings]}))


def _drift_document(drift: Drift) -> dict[str, Any]:
    return {**vars(drift), 'slopes': {name: {'value': value, 'std': std}
                                      for name, (value, std) in drift.slopes.items()}}


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
            'session were correct.']))])


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
    for column, (name, past) in enumerate(ring.history.of.items()):
        series = past.series
        curves = np.array([series.value - 2.0 * series.std, series.value + 2.0 * series.std,
                           past.level, series.value])
        is_relative = name.startswith(('stiffness', 'damping'))
        low, high, level, value = (100.0 * np.expm1(curves - past.level[0]) if is_relative
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
