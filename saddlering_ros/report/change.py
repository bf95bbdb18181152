"""A comparison of two sessions as text, as figures and as one HTML page."""

from collections.abc import Mapping, Sequence
import math
from pathlib import Path
from typing import Any

import numpy as np

from saddlering_ros.comparison.change import Change, change_words, lowered_names, name_of
from saddlering_ros.comparison.series import CHANGED, ChangeSeries
from saddlering_ros.discrepancy import Estimate, wording
from saddlering_ros.identification.uncertainty import reason_wide, UNDETERMINED
from saddlering_ros.pages import charts, html
from saddlering_ros.pages.certainty import certainty
from saddlering_ros.pages.charts import Chart, Panel
from saddlering_ros.pages.html import Cell, code, number
from saddlering_ros.quantities import probability, quantity, verdict_line
from saddlering_ros.report import reports
from saddlering_ros.report.figures import axis_label, MICRO
from saddlering_ros.rig import FORCE_UNITS
from saddlering_ros.rig.description import WEAR_LIMITS


def change_text(change: Change) -> str:
    """The comparison as the command prints it."""
    lines = [verdict_line(change.verdict), change.headline, *(
        f'  p {probability(cause.p_value)}: {change_words(cause)}'
        for cause in change.diagnosis.causes)]
    lines += wording.certainty_lines(wording.certainty_document(change.diagnosis), lowered_names)
    lines += ['contact law, before, after and change:']
    lines += [f'  {name}: {", ".join(contact_words(name, numbers))}'
              for name, numbers in change.contact.items()]
    test, rows = _maker_table(change)
    lines += [f'figures of makers, {test}:'] if rows else []
    lines += [f'  {name}: {first}, {second}, wear {wear}' for name, first, second, wear in rows]
    lines += wear_words(change.wear_judged)
    lines += [f'series: {change.series.headline}'] if change.series else []
    lines += [f'next test: {change.next_test}'] if change.next_test else []
    lines += [f'note: {note}' for note in change.notes]
    return '\n'.join(lines)


def contact_words(name: str, numbers: Sequence[Estimate]) -> list[str]:
    """A contact parameter before, after, and its change, each as far as the sessions determine it.

    The change can be known better than either, as errors that both sessions share are not in it.
    """
    least = 1.0 if name[0] == 'n' else max(abs(one.value) for one in numbers[:2])
    return [f'{UNDETERMINED} (best known {quantity(one.value, one.unit)})'
            if math.isnan(one.std) or reason_wide(name, one.std / least, 2)
            else quantity(one.value, one.unit, one.std) for one in numbers]


def wear_words(judged: Sequence[Mapping[str, Any]]) -> list[str]:
    """A sentence for each limit of the rig file."""
    return [f'wear of {wear["figure"].replace("_", " ")}: {round(100.0 * wear["share"])} % of the '
            f'limit of {wear["limit_mm"]:g} mm, {wear["state"]}' for wear in judged]


def change_chart(change: Change) -> Chart:
    """What the simulation leaves of each later run, over the load: without and with the causes.

    Errors that both sessions share are removed.
    """
    metric = change.diagnosis.fits.metric
    problem = metric.problem
    before, after = (metric.without_nuisances(problem.measured - fit.prediction)
                     for fit in (change.diagnosis.fits.before, change.diagnosis.fits.after))
    views, unit, panels = list(problem.system.views), change.rig.force_unit, []
    later = {record.run.name: column for column, record in enumerate(change.after)}
    for row, view in enumerate(views):
        for run, without, rest in zip(problem.runs, *(
                problem.view_residuals(residual, view) for residual in (before, after)),
                strict=True):
            if run.name not in later:
                continue
            load, column = run.inputs['load'] / FORCE_UNITS[unit], later[run.name]
            panels.append(Panel(row, column, f'load / {unit}', axis_label(view), (
                charts.markers(load, MICRO * without, '.', charts.BEFORE, 'without the causes',
                               size=2.5),
                charts.line(load, MICRO * (without - rest), charts.AFTER,
                            'explained by the causes')),
                title=run.name.partition(': ')[2] if not row else '', shows_y_label=not column))
    return Chart(tuple(panels), 3.6 * len(later), 1.9 * len(views), (1.0,) * len(views),
                 len(later), shares_x=True)


def series_chart(series: ChangeSeries) -> Chart:
    """Evidence over the sessions, and the size of the change with most evidence in each."""
    places = np.arange(1.0, len(series.names))
    ticks = charts.Ticks(tuple(places), series.names[1:])
    low, high = (series.sizes + side * 2.0 * series.deviations for side in (-1.0, 1.0))
    decades = np.log10(series.evidence.e_values)
    return Chart((
        Panel(0, 0, 'session', 'decades of the e-value', (
            charts.line(places, decades, charts.AFTER, 'evidence of a change'),
            charts.markers(places, decades, 'o', charts.AFTER),
            charts.line(places[[0, -1]], np.full(2, math.log10(CHANGED)), charts.BEFORE,
                        'changed', dash='--')), x_ticks=ticks),
        Panel(0, 1, 'session', f'{series.parameter} / {series.unit}', (
            charts.strokes(places, low, high, 'two deviations'),
            charts.markers(places, series.sizes, 'o', charts.MEASURED,
                           'change since the base session')),
              title=name_of(series.effect), x_ticks=ticks)), 9.4, 3.0, columns=2)


def write_change_page(change: Change, path: Path, command: str = '') -> None:
    """Write the page whole, or not at all."""
    contact: list[list[str | Cell]] = [
        [code(name), *contact_words(name, numbers)] for name, numbers in change.contact.items()]
    limits: list[list[str | Cell]] = [
        [name_of(item.effect), quantity(max(item.limit, item.material_limit), item.unit),
         quantity(change.limits_alone.get(item.effect), item.unit)]
        for item in change.diagnosis.observability.limits if item.testable]
    series = '' if change.series is None else html.section(
        'Series', html.paragraph(change.series.headline), html.picture(
            series_chart(change.series), 'series',
            'The e-value may be read after every session: an unchanged ring reaches 100 with a '
            'chance of at most 1 %. Right: the size of the change with most evidence.'))
    maker_test, makers = _maker_table(change)
    tests = [(record.test_run, session) for session, records in (
        ('before', change.before), ('after', change.after)) for record in records]
    html.write_page(path, html.page('What changed', [
        reports.head('What changed', change.rig, tests),
        html.verdict(
            change.verdict, change.headline,
            html.paragraph(f'Next test: {change.next_test}' if change.next_test else '', 'next')),
        certainty(change.to_json(), lowered_names),
        html.section('Change of the later runs', html.picture(
            change_chart(change), 'change',
            'Measured minus simulated in the later session, over the load. Errors that both '
            'sessions share are removed. The line is the part that the causes explain.')),
        series,
        html.section('Contact law', html.table(
            ['parameter', number('before'), number('after'), number('change')], contact)),
        html.section('Figures of makers', html.table(
            ['', number('before'), number('after'), number('wear')], makers,
            f'Static tests {maker_test}.'), html.bullets(wear_words(change.wear_judged))),
        html.section('Smallest change that these sessions could show', html.table(
            ['cause', number('change'), number('in the later session alone')], limits)),
        html.section('Notes', html.bullets(change.notes)),
        html.section('Command', html.commands([command])) if command else ''
    ]))


def _maker_table(change: Change) -> tuple[str, list[list[str]]]:
    """The tests of makers' figures in words, and each figure by its name: before, after, wear."""
    if change.maker is None:
        return '', []
    first, second = change.maker
    documents = [first.as_dict(), second.as_dict(), second.wear_since(first)]
    words = (f'at {math.degrees(first.elevation):g} deg from {change.rig.force_words(first.low)} '
             f'to {change.rig.force_words(first.high)}')
    return words, [
        [name.replace('_', ' '),
         *(f'{one[f"{name}_mm"]:.5f} ± {one[f"{name}_std_mm"]:.5f} mm' for one in documents)]
        for name in WEAR_LIMITS]
