"""A comparison of two sessions as text, as figures and as one HTML page."""

from collections.abc import Mapping, Sequence
import math
from pathlib import Path
from typing import Any

import numpy as np

from saddlering_ros.comparison.change import Change, change_words, name_of
from saddlering_ros.comparison.maker import MakerFigures
from saddlering_ros.comparison.series import CHANGED, ChangeSeries
from saddlering_ros.pages import html
from saddlering_ros.pages.certainty import certainty
from saddlering_ros.pages.charts import (
    AFTER,
    BEFORE,
    Chart,
    line,
    markers,
    MEASURED,
    NOISE,
    Panel,
    Ticks,
)
from saddlering_ros.pages.html import Cell, code, number
from saddlering_ros.quantities import probability, quantity
from saddlering_ros.report import background
from saddlering_ros.rig import MICRO_UNITS, PARAMETER_UNITS, Rig
from saddlering_ros.rig.description import WEAR_LIMITS

PER_MILLION = 1e6
KILONEWTON = 1e-3


def change_text(change: Change) -> str:
    """The comparison as the command prints it."""
    lines = [f'verdict: {change.verdict}', change.headline]
    lines += [f'  p {probability(cause.p_value)}: {change_words(cause)}'
              for cause in change.diagnosis.causes]
    lines.append('contact law, before, after and change:')
    for name, (before, after, both) in change.contact.items():
        unit = PARAMETER_UNITS[name]
        lines.append(f'  {name}: {quantity(before.value, unit, before.std)}, '
                     f'{quantity(after.value, unit, after.std)}, '
                     f'{quantity(both.value, unit, both.std)}')
    if change.maker is not None:
        lines += [f'figures of makers, {_maker_test(change.maker[0], change.rig)}:', *(
            f'  {name}: {first}, {second}, wear {wear}'
            for name, first, second, wear in _maker_rows(change.maker))]
    lines += wear_words(change.wear_judged)
    lines += [f'series: {change.series.headline}'] if change.series else []
    lines += [f'next test: {change.next_test}'] if change.next_test else []
    lines += [f'note: {note}' for note in change.notes]
    return '\n'.join(lines)


def wear_words(judged: Sequence[Mapping[str, Any]]) -> list[str]:
    """A sentence for each limit of the rig file."""
    return [f'wear of {item["figure"].replace("_", " ")}: {round(100.0 * item["share"])} % of the '
            f'limit of {item["limit_mm"]:g} mm, {item["state"]}' for item in judged]


def change_chart(change: Change) -> Chart:
    """What the simulation leaves of each later run, over the load: without and with the causes.

    Errors that both sessions share are removed.
    """
    metric = change.diagnosis.fits.metric
    problem = metric.problem
    before, after = (metric.without_nuisances(problem.measured - fit.prediction)
                     for fit in (change.diagnosis.fits.before, change.diagnosis.fits.after))
    later = {record.run.name for record in change.after}
    runs = [run for run in problem.runs if run.name in later]
    loads = {run.name: KILONEWTON * np.asarray(run.inputs['load']) for run in runs}
    views = list(problem.system.views)
    panels = []
    for row, view in enumerate(views):
        seen = [dict(zip((run.name for run in problem.runs),
                         problem.view_residuals(residual, view), strict=True))
                for residual in (before, after)]
        panels += [
            Panel(row, column, 'load / kN', f'{view} / {MICRO_UNITS[view]}', (
                markers(loads[run.name], PER_MILLION * seen[0][run.name], '.', BEFORE,
                        'without the causes', size=2.5),
                line(loads[run.name], PER_MILLION * (seen[0][run.name] - seen[1][run.name]), AFTER,
                     'explained by the causes')),
                title=run.name.partition(': ')[2] if not row else '',
                shows_y_label=not column)
            for column, run in enumerate(runs)]
    return Chart(tuple(panels), 3.6 * len(runs),
                 1.9 * len(views), (1.0,) * len(views), len(runs), shares_x=True)


def series_chart(series: ChangeSeries) -> Chart:
    """Evidence over the sessions, and the size of the change with most evidence in each."""
    places = np.arange(1.0, len(series.names))
    ticks = Ticks(tuple(places), series.names[1:])
    low, high = (series.sizes + side * 2.0 * series.deviations for side in (-1.0, 1.0))
    gaps, decades = np.full(places.size, np.nan), np.log10(series.evidence.e_values)
    return Chart((
        Panel(0, 0, 'session', 'decades of the e-value', (
            line(places, decades, AFTER, 'evidence of a change'),
            markers(places, decades, 'o', AFTER),
            line(places[[0, -1]], np.full(2, math.log10(CHANGED)), BEFORE, 'changed', dash='--')),
            x_ticks=ticks),
        Panel(0, 1, 'session', f'{series.parameter} / {series.unit}', (
            line(np.stack([places, places, gaps], axis=1).ravel(),
                 np.stack([low, high, gaps], axis=1).ravel(), NOISE, 'two deviations'),
            markers(places, series.sizes, 'o', MEASURED, 'change since the base session')),
            title=name_of(series.effect), x_ticks=ticks)), 9.4, 3.0, columns=2)


def write_change_page(change: Change, path: Path, command: str = '') -> None:
    """Write the page whole, or not at all."""
    contact: list[list[str | Cell]] = [
        [code(name), *(number(quantity(item.value, PARAMETER_UNITS[name], item.std))
                       for item in numbers)]
        for name, numbers in change.contact.items()]
    limits: list[list[str | Cell]] = [
        [name_of(item.effect),
         number(quantity(max(item.limit, item.material_limit), item.unit)),
         number(quantity(change.limits_alone.get(item.effect), item.unit))]
        for item in change.diagnosis.observability.limits if item.testable]
    series = '' if change.series is None else html.section(
        'Series', html.paragraph(change.series.headline), html.picture(
            series_chart(change.series), 'series',
            'The e-value may be read after every session: an unchanged ring reaches 100 with a '
            'chance of at most 1 %. Right: the size of the change with most evidence.'))
    makers = '' if change.maker is None else html.table(
        ['', number('before'), number('after'), number('wear')],
        [[name, *map(number, figures)] for name, *figures in _maker_rows(change.maker)],
        f'Static tests {_maker_test(change.maker[0], change.rig)}.'
    ) + html.bullets(wear_words(change.wear_judged))
    tests = [(record.test_run, session) for session, records in (
        ('before', change.before), ('after', change.after)) for record in records]
    html.write_page(path, html.page('What changed', [
        background.head('What changed', change.rig, tests),
        f'<div class="verdict {change.verdict}">{html.paragraph(change.headline, "headline")}'
        + (html.paragraph(f'Next: {change.next_test}', 'next') if change.next_test else '')
        + '</div>',
        certainty(change.to_json(), name_of),
        html.section('Change of the later runs', html.picture(
            change_chart(change), 'change',
            'Measured minus simulated in the later session, over the load. Errors that both '
            'sessions share are removed. The line is the part that the causes explain.')),
        series,
        html.section('Contact law', html.table(
            ['parameter', number('before'), number('after'), number('change')], contact)),
        html.section('Figures of makers', makers),
        html.section('Smallest change that these sessions could show', html.table(
            ['cause', number('change'), number('in the later session alone')], limits)),
        html.section('Notes', html.bullets(change.notes)),
        html.section('Command', html.commands([command])) if command else ''
    ]))


def _maker_test(figures: MakerFigures, rig: Rig) -> str:
    return (f'at {math.degrees(figures.elevation):g} deg from {rig.force_words(figures.low)} to '
            f'{rig.force_words(figures.high)}')


def _maker_rows(maker: tuple[MakerFigures, MakerFigures]) -> list[list[str]]:
    """Each figure by its name: before, after and wear."""
    first, second = maker
    documents = [first.as_dict(), second.as_dict(), second.wear_since(first)]
    return [
        [name.replace('_', ' '),
         *(f'{one[f"{name}_mm"]:.5f} ± {one[f"{name}_std_mm"]:.5f} mm' for one in documents)]
        for name in WEAR_LIMITS]
