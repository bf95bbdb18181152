"""The report of parameters: their source, and their predictions of the given runs."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from saddlering_ros.bags import TestRun
from saddlering_ros.identification.criteria import judge
from saddlering_ros.identification.validation import ChannelFigures, RunValidation, Validation
from saddlering_ros.quantities import compact, percent, quantity
from saddlering_ros.report import background, chapters, html
from saddlering_ros.report.background import correlation, quality_of
from saddlering_ros.report.curves import curves_of_run, RunCurves
from saddlering_ros.report.curves_file import curves_path, write_curves
from saddlering_ros.report.header import head, head_line
from saddlering_ros.report.html import Cell, code, number
from saddlering_ros.report.style import SYMBOLS
from saddlering_ros.rig import (
    CHANNELS,
    PARAMETER_NAMES,
    PARAMETER_UNITS,
    ParameterSet,
    Rig,
    stiffness_per_millimetre,
    write_text_atomically,
)
from saddlering_ros.thresholds import allowed_misfit

OF_NOISE = ('Where no cause is in the model, standard deviations of a parameter file count noise '
            'alone. They hold for another test of the same ring. The intervals of identify also '
            'allow for unequal rollers.')


def write_validation_report(
    path: Path | str, validation: Validation, runs: Sequence[TestRun], rig: Rig,
    identification: Mapping[str, Any] | None = None, command: str = '',
) -> tuple[Path, Path]:
    """Write the page of a validation and its curves, whole or not at all; the paths written.

    `runs` are those validated, in order; `identification` is the JSON of an identification.
    """
    beside = curves_path(path)
    write_text_atomically(
        Path(path), validation_page(validation, runs, rig, identification, command, beside.name))
    write_curves(beside, curves_of_validation(validation, runs, rig.force_unit))
    return Path(path), beside


def validation_page(
    validation: Validation, runs: Sequence[TestRun], rig: Rig,
    identification: Mapping[str, Any] | None = None, command: str = '', curves_file: str = '',
) -> str:
    """The whole page; curves_file: the name of the file that holds its curves."""
    curves = curves_of_validation(validation, runs, rig.force_unit)
    found_by = ('' if identification is None else chapters.identified(identification))
    return html.page('How well the parameters predict', [
        head('How well the parameters predict', rig, [
            head_line(run, held_out=shown.held_out)
            for run, shown in zip(runs, curves, strict=True)]),
        _banner(validation, curves),
        found_by or _parameters(validation.parameters),
        _criteria(validation),
        _figures(validation),
        chapters.paper_split(curves),
        chapters.residual_map(curves),
        chapters.residuals(curves),
        background.data_quality([quality_of(run, rig) for run in runs]),
        background.reproduction(validation.to_json(), command, curves_file),
    ])


def curves_of_validation(
    validation: Validation, runs: Sequence[TestRun], force_unit: str,
) -> list[RunCurves]:
    """The curves of the validated runs, in order."""
    return [_curves(found, run, validation.parameters, force_unit)
            for found, run in zip(validation.runs, runs, strict=True)]


def _curves(
    found: RunValidation, run: TestRun, parameters: ParameterSet, force_unit: str,
) -> RunCurves:
    known = {Path(bag).name for bag in parameters.source.bags}
    floors = {name: item.noise_floor for name, item in found.channels.items()}
    return curves_of_run(run, found.measured, found.simulated, found.simulated, floors,
                         held_out=run.path.name not in known, force_unit=force_unit)


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


def _parameters(parameters: ParameterSet) -> str:
    """The parameter file: contact law with errors, effects, correlation, where it came from."""
    covariance = parameters.source.covariance
    spread = [None] * 6 if covariance is None else np.sqrt(np.diag(covariance)).tolist()
    rows: list[list[str | Cell]] = []
    for name, std in zip(PARAMETER_NAMES, spread, strict=True):
        value = float(getattr(parameters.contact, name))
        unit = PARAMETER_UNITS[name]
        reason = parameters.source.undetermined.get(name)
        known = std if reason is None else None
        rows.append([code(name), number(quantity(value, '' if unit == '1' else unit, known)),
                     number(chapters.interval(value, known)),
                     '' if reason is None else f'not determined by these data: {reason}'])
    contact = parameters.contact
    for name, value, power in (('K1', contact.K1, contact.n1), ('K2', contact.K2, contact.n2)):
        shown = quantity(stiffness_per_millimetre(value, power), 'N/mm^n')
        rows.append([code(name), number(shown), '', ''])
    for effect, values in parameters.effects.items():
        rows += [[code(f'{effect}.{name}'), number(f'{compact(value, 5)} (SI)'), '', '']
                 for name, value in values.items()]
    source = parameters.source
    words = 'As given' if source.method == 'given' else f'By {source.method}'
    words += f' from {", ".join(source.bags)}' if source.bags else ''
    return html.section(
        'Parameters',
        html.table(['parameter', number('value ± standard deviation'), number('95 % interval'),
                    ''], rows, words + (f': {source.note}' if source.note else '')),
        correlation(covariance),
        '' if covariance is None or source.method == 'given' else html.paragraph(OF_NOISE, 'note'),
        html.paragraph(chapters.ASSUMPTION, 'note'))


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
