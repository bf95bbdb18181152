"""Reports of a diagnosis, of a validation and of a change, each one HTML page."""

from collections.abc import Mapping, Sequence
from datetime import datetime, timezone
from functools import partial
import math
from pathlib import Path
from typing import Any

import numpy as np

from saddlering_ros import quantities
from saddlering_ros.comparison.change import Change, change_words, name_of
from saddlering_ros.comparison.series import CHANGED, ChangeSeries
from saddlering_ros.diagnosis.ring_wording import (
    bag_name,
    limit_words,
    lowered_titles,
    VerdictDocument,
)
from saddlering_ros.diagnosis.verdict import Verdict
from saddlering_ros.discrepancy import Estimate, wording
from saddlering_ros.errors import ReportError
from saddlering_ros.files import whole_file, write_csv
from saddlering_ros.identification.uncertainty import MAX_SOUND, reason_wide, UNDETERMINED
from saddlering_ros.identification.validation import judge, Validation
from saddlering_ros.pages import charts, html
from saddlering_ros.pages.charts import Chart, draw, Panel
from saddlering_ros.pages.html import Cell, certainty, code, number
from saddlering_ros.quantities import percent, probability, quantity, told_once, verdict_line
from saddlering_ros.record.batches import gap_mask
from saddlering_ros.record.displacement import displacement_of_run
from saddlering_ros.record.quality import white_noise
from saddlering_ros.record.record import Record
from saddlering_ros.report import chapters, figures
from saddlering_ros.report.figures import Array, axis_label, MICRO, RunCurves, SYMBOLS
from saddlering_ros.rig import CHANNELS, FORCE_UNITS, MOTION, Rig, short_digest, units
from saddlering_ros.rig.description import WEAR_LIMITS
from saddlering_ros.rig.drawing import drawing_svg, ENTRIES, entry_values

ROLES = ('fitted', 'held out')
DIAGNOSIS = 'What the ring simulation lacks'
VALIDATION = 'How well the parameters predict'


def write_diagnosis_report(verdict: Verdict, path: Path | str, command: str = '',
                           more: Sequence[str] = ()) -> tuple[Path, Path]:
    """Write a verdict's page and curves; the paths written. more: chapters of the caller."""
    beside, curves = figures.curves_path(path), figures.curves_of(verdict)
    tests = [(run.record.test_run, ROLES[run.record.run.held_out]) for run in verdict.runs]
    html.write_page(path, diagnosis_page(
        verdict.to_json(), curves, verdict.extended_parameters().source.covariance,
        top=head(DIAGNOSIS, verdict.rig, tests),
        quality=data_quality([run for run, _ in tests], verdict.rig),
        command=command, curves_file=beside.name, more=more))
    write_csv(beside, figures.curve_columns(curves), ReportError)
    return Path(path), beside


def diagnosis_page(document: VerdictDocument, curves: Sequence[RunCurves],
                   covariance: Array | None = None, *, top: str = f'<h1>{DIAGNOSIS}</h1>',
                   quality: str = '', command: str = '', curves_file: str = '',
                   more: Sequence[str] = ()) -> str:
    """The page of a verdict's JSON and the curves of its runs, most important first.

    covariance (6, 6) of the contact parameters in the order of PARAMETER_NAMES; top: the head;
    quality: the chapter on the data; command: the command line that makes the page; curves_file:
    the name of the file of its curves; more: chapters of the caller, after the causes.
    """
    return html.page('Diagnosis of the ring simulation', [
        top,
        chapters.verdict_banner(document, curves),
        certainty(document, lowered_titles),
        chapters.causes(document),
        *more,
        chapters.proposal(document, curves[0].force_unit if curves else 't'),
        misfit_reductions(document),
        chapters.misfit(document),
        chapters.paper_split(curves),
        chapters.residual_map(curves),
        chapters.before_and_after(document, covariance),
        chapters.candidates(document),
        chapters.shape_tests(document),
        chapters.residuals(curves),
        chapters.detection_limits(document),
        quality,
        chapters.notes(document),
        reproduction(document, command, curves_file)])


def write_validation_report(path: Path | str, validation: Validation, runs: Sequence[Record],
                            rig: Rig, identification: Mapping[str, Any] | None = None,
                            command: str = '') -> tuple[Path, Path]:
    """Write a validation's page and curves; `runs` in its order, `identification` as JSON."""
    beside = figures.curves_path(path)
    curves = curves_of_validation(validation, runs, rig)
    tests = [(run, ROLES[shown.held_out]) for run, shown in zip(runs, curves, strict=True)]
    html.write_page(path, html.page(VALIDATION, [
        head(VALIDATION, rig, tests),
        _banner(validation, curves, identification),
        chapters.of_file(validation.parameters) if identification is None else
        chapters.identified(identification),
        html.section('Criteria', html.table(
            ['criterion', 'worst channel', number('value'), number('limit')],
            [[f'{criterion.words}{criterion.doubt}',
              f'{criterion.bag}, {SYMBOLS[criterion.channel]}',
              number(criterion.with_unit(criterion.value), 'good' if criterion.is_met else 'bad'),
              criterion.with_unit(criterion.limit)]
             for criterion in judge(
                 validation.runs, validation.parameters.source.undetermined)])),
        _figures(validation),
        chapters.paper_split(curves),
        chapters.residual_map(curves),
        chapters.residuals(curves),
        data_quality(runs, rig),
        reproduction(validation.to_json(), command, beside.name)]))
    write_csv(beside, figures.curve_columns(curves), ReportError)
    return Path(path), beside


def curves_of_validation(validation: Validation, runs: Sequence[Record],
                         rig: Rig) -> list[RunCurves]:
    """The curves of the validated runs, in order."""
    return [
        figures.curves_of_run(
            rig, run, result.measured, result.simulated, result.simulated,
            {name: channel.noise_floor for name, channel in result.channels.items()},
            held_out=validation.is_held_out(run.path))
        for result, run in zip(validation.runs, runs, strict=True)]


def _banner(validation: Validation, curves: Sequence[RunCurves],
            identification: Mapping[str, Any] | None) -> str:
    """Whether every channel is within its noise, and the one that is predicted worst.

    A fit may leave what no sound ring does, although the errors of a sound ring move each channel
    by more.
    """
    cases = [(run, name, run.channels[name]) for run in validation.runs for name in MOTION]
    run, name, channel = max(cases, key=lambda case: (case[2].nrmse or 0.0) / (
        quantities.allowed_misfit(case[2].noise_floor, case[2].sound)))
    misfit, floor = channel.nrmse or 0.0, channel.noise_floor or 0.0
    factor = 0.0 if identification is None else identification['sound_factor']
    said, advice = (f'The misfit of {SYMBOLS[name]} in {Path(run.name).name} is '
                    f'{percent(misfit)} of its range; noise alone would give {percent(floor)}.',
                    'saddlering diagnose on these bags looks for the missing cause.')
    within = misfit <= quantities.allowed_misfit(floor, channel.sound)
    is_good = within and factor <= MAX_SOUND
    if is_good:
        said, advice = ('These parameters predict every channel of every run within its noise and '
                        'the small errors of a sound ring.', '')
    elif within:
        said = (f'The misfit is {factor:.2f} times what noise and small errors of a sound ring '
                'leave.')
    if not is_good and identification is not None and identification['beside_errors']:
        advice = ('Usual small errors of ring and rig can explain the misfit: see the parameters '
                  'beside them.')
    shown = [one for one in curves if one.name == Path(run.name).name]
    return html.found(
        'none' if is_good else 'ambiguous', html.paragraph(said, 'headline'),
        html.paragraph(advice), chapters.proof_picture(shown[0], name) if shown else '')


def _figures(validation: Validation) -> str:
    """Every figure of every channel, with its unit."""
    rows: list[list[str | Cell]] = []
    for run in validation.runs:
        for name, channel in run.channels.items():
            misfit = channel.nrmse
            mark = '' if misfit is None or name == 'parity' else (
                'bad' if misfit > quantities.allowed_misfit(channel.noise_floor, channel.sound)
                else 'good')
            rows.append([
                Path(run.name).name, run.test, f'{np.degrees(run.elevation):g}°', code(name),
                quantity(channel.rmse, channel.unit), number(percent(misfit), mark),
                percent(channel.noise_floor), quantity(channel.maximum, channel.unit),
                quantity(channel.bias, channel.unit), quantity(channel.slope_ratio),
                percent(channel.loop_area), quantity(channel.time_shift, 's'),
                quantity(channel.iso18571), quantity(channel.e_over_uval)])
    return html.section('In numbers', html.table(
        ['run', 'test', number('elevation'), 'channel', *map(number, (
            'rms misfit', 'of range', 'noise', 'largest', 'bias', 'slope ratio', 'loop', 'shift',
            'ISO 18571', 'E / u_val'))], rows,
        f'{chapters.RED}Loop: missing area over load, as a share of load range times channel '
        'range. E / u_val: comparison '
        'error over validation uncertainty (ASME V&V 20).'))


def plot_paths(validation: Validation, folder: Path) -> list[Path]:
    """Path of the PNG of each run in `folder`."""
    return [folder / f'{place:02d}_{Path(run.name).stem}.png'
            for place, run in enumerate(validation.runs, start=1)]


def save_plots(validation: Validation, runs: Sequence[Record], folder: Path,
               rig: Rig) -> list[Path]:
    """One PNG per run in `folder`; the paths written."""
    paths = plot_paths(validation, folder)
    curves = curves_of_validation(validation, runs, rig)
    for run, path in zip(curves, paths, strict=True):
        with whole_file(path, ReportError) as temporary:
            temporary.write_bytes(html.png(draw(figures.of_run(run))))
    return paths


def date_of(stamp: int) -> str:
    """'2026-11-20 08:15 UTC' of a stamp [ns]; '' before 2000, because its zero is another."""
    date = datetime.fromtimestamp(stamp / 1e9, timezone.utc)
    return date.strftime('%Y-%m-%d %H:%M UTC') if date.year >= 2000 else ''


def head(title: str, rig: Rig, tests: Sequence[tuple[Record, str]]) -> str:
    """Title, rig with its hash, tests (a run and its role each), the rig's dimensions folded."""
    named = ', '.join(sorted({run.rig for run, _ in tests if run.rig})) or 'not named in the bags'
    digest, elevations = rig.digest, [round(math.degrees(run.elevation), 2) for run, _ in tests]
    rows = [
        [run.path.name, run.test, f'{elevation:g}°', role,
         run.details.get('date', '') or date_of(int(run.stamps[0])) or '–',
         run.details.get('operator', '') or '–', run.run or '–']
        for elevation, (run, role) in zip(elevations, tests, strict=True)]
    svg = drawing_svg(rig, *elevations[:1])
    return '\n'.join([
        f'<h1>{html.escape(title)}</h1>',
        f'<p class="soft">Rig: {html.escape(named)}, hash <code title="{digest}">'
        f'{short_digest(digest)}</code></p>',
        html.table(['test', 'kind', number('elevation'), 'role', 'date', 'operator', 'run'], rows),
        html.folded(
            'Dimensions of the rig',
            f'<div role="img" aria-label="Drawing of the rig with probes and signs">{svg}</div>',
            html.table(['entry of the rig file (SI units)', number('value'), 'meaning'], [
                [code(name), str(value), words] for (name, words), value in zip(
                    ENTRIES, entry_values(rig).values(), strict=True)], f'Rig hash {digest}'))])


def data_quality(runs: Sequence[Record], rig: Rig) -> str:
    """Chapter: the quality of each run's data: length, rate, load, faults, zero, white noise."""
    rows: list[list[str | Cell]] = []
    for run in runs:
        measured = displacement_of_run(rig, run)
        steps = np.diff(run.stamps) / 1e9
        period, long = float(np.median(steps)), steps[gap_mask(run.stamps)]
        incomplete, zero = int((~measured.complete).sum()), measured.zero
        low, high = float(run.load.min()), float(run.load.max())
        decimals = units.force_decimals(high, rig.force_unit)
        rows.append([
            run.path.name, f'{len(run.stamps)}', f'{float(run.time[-1]):.1f} s',
            f'{1.0 / period:.4g} Hz', rig.force_range(low, high, decimals + 1),
            number(f'{incomplete}', 'bad' if incomplete > 0.01 * len(run.stamps) else ''),
            number(f'{len(long)} (≤ {long.max():.3g} s)', 'bad') if len(long) else 'none',
            number(rig.force_words(zero.load, decimals + 2), '' if zero.near_preload else 'bad'),
            *(quantity(white_noise(np.asarray(getattr(measured.displacement, name))),
                       'rad' if name == 'gamma' else 'm') for name in CHANNELS)])
    said = told_once((run.path.name, note) for run in runs for note in run.notes)
    return html.section('Data quality', html.table(
        ['run', *map(number, ('load samples', 'duration', 'rate', 'load', 'without all probes',
                              'gaps', 'zero at', *(f'noise {SYMBOLS[name]}'
                                                   for name in CHANNELS)))], rows,
        'Noise: white noise of one sample, from second differences. Red: more than 1 % of the '
        'samples lack a probe, the stamps have gaps, or the zero is not at preload.'),
        html.bullets(said),
        html.paragraph('These bags have no other fault.' if runs and not said else '', 'soft'))


def misfit_reductions(document: Mapping[str, Any]) -> str:
    """Chapter: by how much the misfit falls, run by run, with the extended model."""
    total, shown = document.get('gain') or {}, MOTION
    if document['verdict'] == 'none' or total.get('fit') is None:
        return ''
    rows = [[bag_name(run['bag']), 'held out' if run['held_out'] else 'fitted',
             *(_reduction_words(run['channels'].get(name) or {}) for name in shown), '–']
            for run in document['runs']]
    every = 'all runs in turn' if total.get('how') == 'held out in turn' else 'all held-out runs'
    rows.append(['all fitted runs', 'fitted', *'–––', percent(total['fit'])])
    if total.get('held_out') is not None:
        rows.append([every, 'held out', *'–––', percent(total['held_out'])])
    return html.section('Misfit reduction', html.table(
        ['run', 'role', *(number(f'misfit reduction in {SYMBOLS[name]}') for name in shown),
         number('in all channels')], rows,
        'Misfit reduction: the share by which the cause in the simulation reduces the rms misfit. '
        'It is negative if the misfit rises, and in brackets if the misfit was within twice the '
        'noise before. The last column weights the channels by their noise.'))


def _reduction_words(channel: Mapping[str, float | None]) -> str:
    before, after = channel.get('nrmse_before'), channel.get('nrmse_after')
    if not before or after is None:
        return '–'
    words = f'{round(100.0 * (1.0 - after / before))} %'
    return f'({words})' if before <= quantities.allowed_misfit(
        channel.get('noise_floor'), channel.get('sound')) else words


def reproduction(document: Mapping[str, Any], command: str = '', curves_file: str = '') -> str:
    """Chapter: the command, the versions and the hashes that lead to the same numbers again."""
    made = document.get('provenance') or {}
    rows: list[list[str | Cell]] = []
    for kind in ('bags', 'files'):
        rows += [[origin['path'], Cell(
            f'<code class="hash">{html.escape(origin.get("sha256") or "not a file")}</code>',
            is_html=True)] for origin in made.get(kind, ())]
    versions = ', '.join(f'{name} {version}' for name, version in made.get('versions', {}).items())
    return html.section(
        'To reproduce this result',
        html.commands([command] if command else []),
        html.table(['input', 'SHA-256'], rows, 'The hash of a bag is that of the '
                   'lines which sha256sum prints for its files.'),
        html.paragraph(f'{curves_file}, beside this page, holds the curves of all figures in SI '
                       'units.' if curves_file else '', 'note'),
        html.paragraph(f'Made with {versions}.' if versions else '', 'note'))


def change_text(change: Change) -> str:
    """The comparison as the command prints it."""
    lines = [verdict_line(change.verdict), change.headline, *(
        f'  p {probability(cause.p_value)}: {change_words(cause)}'
        for cause in change.diagnosis.causes)]
    lines += wording.certainty_lines(wording.certainty_document(change.diagnosis),
                                     partial(lowered_titles, title=name_of))
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
        [name_of(item.effect), *(limit_words(item.effect, size, item.unit) for size in (
            max(item.limit, item.material_limit), change.limits_alone.get(item.effect)))]
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
        head('What changed', change.rig, tests),
        html.verdict(
            change.verdict, change.headline,
            html.paragraph(f'Next test: {change.next_test}' if change.next_test else '', 'next')),
        certainty(change.to_json(), partial(lowered_titles, title=name_of)),
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
        html.section('Command', html.commands([command])) if command else '']))


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
