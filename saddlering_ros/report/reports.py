"""Reports of a diagnosis and of a validation, each one HTML page with its curves beside it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from saddlering_ros.diagnosis.verdict import Verdict
from saddlering_ros.diagnosis.wording import lowered, title_of, VerdictDocument
from saddlering_ros.files import whole_file
from saddlering_ros.identification.figures import ChannelFigures, RunValidation
from saddlering_ros.identification.validation import judge, Validation
from saddlering_ros.pages import html, ReportError
from saddlering_ros.pages.certainty import certainty
from saddlering_ros.pages.charts import draw
from saddlering_ros.pages.html import Cell, code, number
from saddlering_ros.quantities import allowed_misfit, percent, quantity
from saddlering_ros.record import Record
from saddlering_ros.report import background, chapters, figures, parameters
from saddlering_ros.report.background import Background, head, head_line, quality_of
from saddlering_ros.report.curves import (
    curves_of,
    curves_of_run,
    curves_path,
    RunCurves,
    write_curves,
)
from saddlering_ros.report.figures import SYMBOLS
from saddlering_ros.rig import CHANNELS, ParameterSet, Rig

NOTHING = Background()


def write_diagnosis_report(
    verdict: Verdict, path: Path | str, command: str = '',
) -> tuple[Path, Path]:
    """Write the page of a verdict and its curves, whole or not at all; the paths written.

    command: the command line that makes the page.
    """
    surroundings = Background(
        covariance=verdict.extended_parameters().source.covariance,
        quality=[quality_of(figures.record.test_run, verdict.rig) for figures in verdict.runs],
        command=command, curves_file=curves_path(path).name,
        force_unit=verdict.rig.force_unit)
    tests = [head_line(figures.record.test_run, held_out=figures.record.run.held_out)
             for figures in verdict.runs]
    curves = curves_of(verdict)
    top = head(TITLE, verdict.rig, tests)
    html.write_page(path, diagnosis_page(verdict.to_json(), curves, surroundings, top))
    write_curves(curves_path(path), curves)
    return Path(path), curves_path(path)


TITLE = 'What the ring simulation lacks'


def diagnosis_page(
    document: VerdictDocument, curves: Sequence[RunCurves], surroundings: Background = NOTHING,
    top: str = f'<h1>{TITLE}</h1>',
) -> str:
    """The page of a verdict's JSON and the curves of its runs, below a head."""
    return html.page('Diagnosis of the ring simulation', [
        top, chapters.verdict_banner(document, curves),
        *diagnosis_chapters(document, curves, surroundings),
    ])


def diagnosis_chapters(
    document: VerdictDocument, curves: Sequence[RunCurves], surroundings: Background = NOTHING,
) -> list[str]:
    """Everything below the verdict, most important first."""
    return [
        certainty(document, lambda name: lowered(title_of(name))),
        chapters.causes(document),
        chapters.proposal(document, surroundings.force_unit),
        background.misfit_reductions(document),
        chapters.misfit(document),
        chapters.paper_split(curves),
        chapters.residual_map(curves),
        parameters.before_and_after(document, covariance=surroundings.covariance),
        chapters.candidates(document),
        chapters.shape_tests(document),
        chapters.residuals(curves),
        chapters.look_alikes(document),
        chapters.detection_limits(document),
        background.data_quality(surroundings.quality),
        chapters.notes(document),
        background.reproduction(document, surroundings.command, surroundings.curves_file),
    ]


def write_validation_report(
    path: Path | str, validation: Validation, runs: Sequence[Record], rig: Rig,
    identification: Mapping[str, Any] | None = None, command: str = '',
) -> tuple[Path, Path]:
    """Write the page of a validation and its curves, whole or not at all; the paths written.

    `runs` are those validated, in order; `identification` is the JSON of an identification.
    """
    beside = curves_path(path)
    html.write_page(
        path, validation_page(validation, runs, rig, identification, command, beside.name))
    write_curves(beside, curves_of_validation(validation, runs, rig.force_unit))
    return Path(path), beside


def validation_page(
    validation: Validation, runs: Sequence[Record], rig: Rig,
    identification: Mapping[str, Any] | None = None, command: str = '', curves_file: str = '',
) -> str:
    """The whole page; curves_file: the name of the file that holds its curves."""
    curves = curves_of_validation(validation, runs, rig.force_unit)
    found_by = ('' if identification is None else parameters.identified(identification))
    return html.page('How well the parameters predict', [
        head('How well the parameters predict', rig, [
            head_line(run, held_out=shown.held_out)
            for run, shown in zip(runs, curves, strict=True)]),
        _banner(validation, curves),
        found_by or parameters.of_file(validation.parameters),
        _criteria(validation),
        _figures(validation),
        chapters.paper_split(curves),
        chapters.residual_map(curves),
        chapters.residuals(curves),
        background.data_quality([quality_of(run, rig) for run in runs]),
        background.reproduction(validation.to_json(), command, curves_file),
    ])


def curves_of_validation(
    validation: Validation, runs: Sequence[Record], force_unit: str,
) -> list[RunCurves]:
    """The curves of the validated runs, in order."""
    return [_curves(found, run, validation.parameters, force_unit)
            for found, run in zip(validation.runs, runs, strict=True)]


def _curves(
    validated: RunValidation, run: Record, parameters: ParameterSet, force_unit: str,
) -> RunCurves:
    fitted_bags = {Path(bag).name for bag in parameters.source.bags}
    floors = {name: item.noise_floor for name, item in validated.channels.items()}
    return curves_of_run(run, validated.measured, validated.simulated, validated.simulated, floors,
                         held_out=run.path.name not in fitted_bags, force_unit=force_unit)


def _worst(validation: Validation) -> tuple[RunValidation, str, ChannelFigures]:
    """The channel that is predicted worst, by its misfit over its noise floor."""
    cases = [(run, name, run.channels[name]) for run in validation.runs for name in CHANNELS[:3]]
    return max(cases, key=lambda case: (case[2].nrmse or 0.0) / max(
        case[2].noise_floor or 0.0, 1e-4))


def _banner(validation: Validation, curves: Sequence[RunCurves]) -> str:
    run, name, item = _worst(validation)
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


def _criteria(validation: Validation) -> str:
    """Every criterion with the run and channel that meets it worst."""
    rows: list[list[str | Cell]] = []
    for item in judge(validation.runs):
        rows.append([
            item.words, f'{item.bag}, {SYMBOLS[item.channel]}',
            number(item.value_words, 'good' if item.is_met else 'bad'),
            number(item.limit_words)])
    return html.section('Criteria', html.table(
        ['criterion', 'worst channel', number('value'), number('limit')], rows))


def _figures(validation: Validation) -> str:
    """Every figure of every channel, with its unit."""
    rows: list[list[str | Cell]] = []
    for run in validation.runs:
        for name, item in run.channels.items():
            misfit = item.nrmse
            mark = '' if misfit is None or name == 'parity' else (
                'bad' if misfit > allowed_misfit(item.noise_floor) else 'good')
            rows.append([
                Path(run.name).name, run.test, number(f'{np.degrees(run.elevation):g}°'),
                code(name), number(quantity(item.rmse, item.unit)),
                number(percent(misfit), mark), number(percent(item.noise_floor)),
                number(quantity(item.maximum, item.unit)), number(quantity(item.bias, item.unit)),
                number(quantity(item.slope_ratio)), number(percent(item.loop_area)),
                number(quantity(item.time_shift, 's')), number(quantity(item.iso18571)),
                number(quantity(item.e_over_uval))])
    return html.section('In numbers', html.table(
        ['run', 'test', number('elevation'), 'channel', number('rms misfit'),
         number('of range'), number('noise'), number('largest'), number('bias'),
         number('slope ratio'), number('loop'), number('shift'), number('ISO 18571'),
         number('E / u_val')], rows,
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
