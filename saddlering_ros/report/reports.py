"""Reports of a diagnosis and of a validation, each one HTML page with its curves beside it."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from saddlering_ros.diagnosis.ring_wording import lowered, title_of, VerdictDocument
from saddlering_ros.diagnosis.verdict import Verdict
from saddlering_ros.files import whole_file, write_csv
from saddlering_ros.identification.validation import judge, Validation
from saddlering_ros.pages import html, ReportError
from saddlering_ros.pages.certainty import certainty
from saddlering_ros.pages.charts import draw
from saddlering_ros.pages.html import Cell, code, number
from saddlering_ros.quantities import allowed_misfit, percent, quantity
from saddlering_ros.record import Record
from saddlering_ros.report import background, chapters, figures, parameters
from saddlering_ros.report.curves import (
    Array,
    curve_columns,
    curves_of,
    curves_of_run,
    curves_path,
    RunCurves,
)
from saddlering_ros.report.figures import SYMBOLS
from saddlering_ros.rig import CHANNELS, Rig

ROLES = ('fitted', 'held out')
DIAGNOSIS = 'What the ring simulation lacks'
VALIDATION = 'How well the parameters predict'


def write_diagnosis_report(
    verdict: Verdict, path: Path | str, command: str = '', more: Sequence[str] = (),
) -> tuple[Path, Path]:
    """Write the page of a verdict and its curves, whole or not at all; the paths written.

    command: the command line that makes the page; more: chapters of the caller.
    """
    beside, curves = curves_path(path), curves_of(verdict)
    tests = [(run.record.test_run, ROLES[run.record.run.held_out]) for run in verdict.runs]
    html.write_page(path, diagnosis_page(
        verdict.to_json(), curves, verdict.extended_parameters().source.covariance,
        top=background.head(DIAGNOSIS, verdict.rig, tests),
        quality=background.data_quality([run for run, _ in tests], verdict.rig),
        command=command, curves_file=beside.name, more=more))
    write_csv(beside, curve_columns(curves), ReportError)
    return Path(path), beside


def diagnosis_page(
    document: VerdictDocument, curves: Sequence[RunCurves],
    covariance: Array | None = None, *, top: str = f'<h1>{DIAGNOSIS}</h1>',
    quality: str = '', command: str = '', curves_file: str = '', more: Sequence[str] = (),
) -> str:
    """The page of a verdict's JSON and the curves of its runs, most important first.

    covariance (6, 6) of the contact parameters in the order of PARAMETER_NAMES; top: the head;
    quality: the chapter on the data; command: the command line that makes the page; curves_file:
    the name of the file of its curves; more: chapters of the caller, after the causes.
    """
    return html.page('Diagnosis of the ring simulation', [
        top,
        chapters.verdict_banner(document, curves),
        certainty(document, lambda name: lowered(title_of(name))),
        chapters.causes(document),
        *more,
        chapters.proposal(document, curves[0].force_unit if curves else 't'),
        background.misfit_reductions(document),
        chapters.misfit(document),
        chapters.paper_split(curves),
        chapters.residual_map(curves),
        parameters.before_and_after(document, covariance=covariance),
        chapters.candidates(document),
        chapters.shape_tests(document),
        chapters.residuals(curves),
        chapters.look_alikes(document),
        chapters.detection_limits(document),
        quality,
        chapters.notes(document),
        background.reproduction(document, command, curves_file),
    ])


def write_validation_report(
    path: Path | str, validation: Validation, runs: Sequence[Record], rig: Rig,
    identification: Mapping[str, Any] | None = None, command: str = '',
) -> tuple[Path, Path]:
    """Write the page of a validation and its curves, whole or not at all; the paths written.

    `runs` are those validated, in order; `identification` is the JSON of an identification.
    """
    beside, curves = curves_path(path), curves_of_validation(validation, runs, rig.force_unit)
    tests = [(run, ROLES[shown.held_out]) for run, shown in zip(runs, curves, strict=True)]
    html.write_page(path, html.page(VALIDATION, [
        background.head(VALIDATION, rig, tests),
        _banner(validation, curves),
        parameters.of_file(validation.parameters) if identification is None else
        parameters.identified(identification),
        html.section('Criteria', html.table(
            ['criterion', 'worst channel', number('value'), number('limit')],
            [[item.words, f'{item.bag}, {SYMBOLS[item.channel]}',
              number(item.value_words, 'good' if item.is_met else 'bad'), item.limit_words]
             for item in judge(validation.runs)])),
        _figures(validation),
        chapters.paper_split(curves),
        chapters.residual_map(curves),
        chapters.residuals(curves),
        background.data_quality(runs, rig),
        background.reproduction(validation.to_json(), command, beside.name),
    ]))
    write_csv(beside, curve_columns(curves), ReportError)
    return Path(path), beside


def curves_of_validation(
    validation: Validation, runs: Sequence[Record], force_unit: str,
) -> list[RunCurves]:
    """The curves of the validated runs, in order."""
    fitted_bags = {Path(bag).name for bag in validation.parameters.source.bags}
    return [
        curves_of_run(run, found.measured, found.simulated, found.simulated,
                      {name: item.noise_floor for name, item in found.channels.items()},
                      held_out=run.path.name not in fitted_bags, force_unit=force_unit)
        for found, run in zip(validation.runs, runs, strict=True)]


def _banner(validation: Validation, curves: Sequence[RunCurves]) -> str:
    """Whether every channel is within its noise, and the one that is predicted worst."""
    cases = [(run, name, run.channels[name]) for run in validation.runs for name in CHANNELS[:3]]
    run, name, item = max(cases, key=lambda case: (case[2].nrmse or 0.0) / max(
        case[2].noise_floor or 0.0, 1e-4))
    misfit, floor = item.nrmse or 0.0, item.noise_floor or 0.0
    is_good = misfit <= allowed_misfit(floor)
    said = ('These parameters predict every channel of every run within its noise.' if is_good
            else f'The misfit of {SYMBOLS[name]} in {Path(run.name).name} is '
            f'{percent(misfit)} of its range; noise alone would give {percent(floor)}.')
    more = ('' if is_good else 'saddlering diagnose on these bags finds the missing cause.')
    shown = [run_ for run_ in curves if run_.name == Path(run.name).name]
    return (f'<div class="verdict {"none" if is_good else "ambiguous"}">'
            + html.paragraph(said, 'headline') + html.paragraph(more)
            + (chapters.proof_picture(shown[0], name) if shown else '') + '</div>')


def _figures(validation: Validation) -> str:
    """Every figure of every channel, with its unit."""
    rows: list[list[str | Cell]] = []
    for run in validation.runs:
        for name, item in run.channels.items():
            misfit = item.nrmse
            mark = '' if misfit is None or name == 'parity' else (
                'bad' if misfit > allowed_misfit(item.noise_floor) else 'good')
            rows.append([
                Path(run.name).name, run.test, f'{np.degrees(run.elevation):g}°', code(name),
                quantity(item.rmse, item.unit), number(percent(misfit), mark),
                percent(item.noise_floor), quantity(item.maximum, item.unit),
                quantity(item.bias, item.unit), quantity(item.slope_ratio),
                percent(item.loop_area), quantity(item.time_shift, 's'),
                quantity(item.iso18571), quantity(item.e_over_uval)])
    return html.section('In numbers', html.table(
        ['run', 'test', number('elevation'), 'channel', *map(number, (
            'rms misfit', 'of range', 'noise', 'largest', 'bias', 'slope ratio', 'loop', 'shift',
            'ISO 18571', 'E / u_val'))], rows,
        'Red: more than twice the noise floor and more than 0.1 % of range. Loop: missing '
        'area over load, as a share of load range times channel range. E / u_val: comparison '
        'error over validation uncertainty (ASME V&V 20).'))


def plot_paths(validation: Validation, folder: Path) -> list[Path]:
    """Path of the PNG of each run in `folder`."""
    return [folder / f'{place:02d}_{Path(run.name).stem}.png'
            for place, run in enumerate(validation.runs, start=1)]


def save_plots(
    validation: Validation, runs: Sequence[Record], folder: Path, force_unit: str = 't',
) -> list[Path]:
    """One PNG per run in `folder`; the paths written. force_unit: unit of loads."""
    paths = plot_paths(validation, folder)
    curves = curves_of_validation(validation, runs, force_unit)
    for run, path in zip(curves, paths, strict=True):
        with whole_file(path, ReportError) as temporary:
            temporary.write_bytes(html.png(draw(figures.of_run(run))))
    return paths
