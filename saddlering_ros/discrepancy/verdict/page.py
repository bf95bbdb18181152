"""A diagnosis as one HTML page: verdict, causes, misfit by run and channel, curves; as text."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from saddlering_ros.discrepancy.problem.model import ModelSystem
from saddlering_ros.discrepancy.verdict import wording
from saddlering_ros.discrepancy.verdict.results import Diagnosis, RunPrediction
from saddlering_ros.pages import charts, html
from saddlering_ros.pages.charts import Chart, MAIN, Panel, ShadedBand, STRIP
from saddlering_ros.pages.html import certainty, code, number
from saddlering_ros.quantities import CHANCE, percent, probability, quantity, verdict_line

PAUSE = 10.0
"""Times the usual step between two samples above which their line is broken."""

MAX_POINTS = 600
"""Largest number of drawn samples of a curve."""


def write_page(answer: Diagnosis, path: Path) -> None:
    """Write the page whole, or not at all."""
    along = next((rest.along for rest in answer.remainder), '')
    next_step = answer.next_test or wording.fit_too_words(answer.remainder) or {
        'none': 'none is needed; the detection limits state what these data could not show.',
        'named': 'put the cause with its size into the simulator and predict a run that was not '
                 'fitted.',
        'ambiguous': 'record a run in which the alternatives differ, and hold it out.',
        'unknown': f'declare an effect that goes along {along or "what the misfit follows"}, or '
                   'a model error as large as a sound machine leaves.',
    }[answer.verdict]
    causes = html.table(
        ['cause', 'parameters', 'alternatives', 'misfit reduction', number('p')],
        [[cause.definition.title + wording.standing(answer.remainder, cause.entry()),
          wording.estimates_words(cause.parameters),
          ', '.join(map(answer.title_of, cause.group[1:])) or '–',
          wording.gain_words(cause.gain.fit, cause.gain.held_out, cause.gain.how),
          number(probability(cause.p_value))] for cause in answer.causes])
    base = html.table(
        ['parameter', number('alone'), number('with the causes')],
        [[code(item.name), number(wording.base_words(answer.base_alone, item)),
          number(wording.base_words(answer.base, item))]
         for item in answer.fits.metric.problem.system.base_parameters])
    limits = html.table(
        ['effect', number('size found nine times in ten'), 'can be tested'],
        [[answer.title_of(item.effect), number(quantity(item.limit, item.unit)),
          'yes' if item.testable else 'no'] for item in answer.observability.limits])
    channels = channels_of(answer)
    html.write_page(path, html.page(verdict_line(answer.verdict).capitalize(), [
        html.verdict(
            answer.verdict, answer.headline,
            html.paragraph(f'Next step: {next_step}', 'next'), _proof(answer, channels)),
        html.section('Warnings', html.bullets(answer.warnings)),
        html.section('Causes', causes), certainty(
            wording.certainty_document(answer), answer.title_of),
        html.section('Base parameters', base), _misfit(answer, channels),
        html.section('Detection limits of these data', limits)]))


@dataclass(frozen=True)
class _Channel:
    """A channel as the page shows it; band: the half widths of its bands by their names."""

    name: str
    unit: str
    time_unit: str
    bands: dict[str, float]

    def panels(self, prediction: RunPrediction, place: int, row: int) -> tuple[Panel, Panel]:
        """The channel of one run as measured and simulated, and its misfit below."""
        run = prediction.run
        there = np.ones(run.time.size, bool) if run.present is None else run.present[place]
        kept = np.flatnonzero(there)[::max(1, int(there.sum()) // MAX_POINTS)]
        steps = np.diff(run.time[kept])  # a line across a pause would show what was not measured
        pauses = 1 + np.flatnonzero(steps > PAUSE * np.median(np.append(steps, 0.0)))
        time, measured, before, after = (np.insert(values[kept], pauses, np.nan) for values in (
            run.time, run.channels[place], prediction.before[place], prediction.after[place]))
        simulated = [charts.line(time, before, charts.BEFORE, 'simulated, without causes',
                                 width=1.0)]
        if not np.array_equal(before, after, equal_nan=True):
            simulated.append(charts.line(time, after, charts.AFTER, 'simulated, with the causes',
                                         '--', width=1.0))
        upper = Panel(row, 0, f'time / {self.time_unit}' if self.time_unit else 'time',
                      f'{self.name} / {self.unit}' if self.unit else self.name,
                      (charts.line(time, measured, charts.MEASURED, 'measured', width=3.5,
                                   opacity=0.4),))
        bands = tuple(ShadedBand(-size, size, opacity, name) for opacity, (name, size) in zip(
            (charts.DARK, charts.LIGHT), self.bands.items(), strict=False))
        return charts.compared(upper, self.unit, measured, simulated, bands)


def channels_of(answer: Diagnosis) -> list[_Channel]:
    """Every channel with its unit, and its bands of noise and of declared model error."""
    metric = answer.fits.metric
    problem, system = metric.problem, metric.problem.system
    declared = system.model if isinstance(system, ModelSystem) else None
    channels = []
    for place, name in enumerate(system.channel_names):
        scale = system.scales[place] if isinstance(system, ModelSystem) else 1.0
        noise = np.mean([np.mean(metric.sensors[run.name, place].variances(run.width))
                         for run in problem.runs]) ** 0.5
        bands = {'± 2 × noise': 2.0 * scale * float(noise)}
        allowed = declared.channels[name].model_error if declared else 0.0
        if allowed:
            bands['± 2 × noise and declared model error'] = 2.0 * scale * float(
                np.hypot(noise, allowed))
        channels.append(_Channel(name, declared.channels[name].unit if declared else '',
                                 problem.time_unit, bands))
    return channels


def _proof(answer: Diagnosis, channels: Sequence[_Channel]) -> str:
    """The channel and run, held out if any is, in which the causes or else the misfit are most."""
    def size(case: tuple[RunPrediction, int]) -> tuple[bool, float]:
        prediction, place = case
        run = prediction.run
        there = slice(None) if run.present is None else run.present[place]
        apart = prediction.before if answer.causes else run.channels
        change = float(np.std((prediction.after - apart)[place, there]))
        return run.held_out, change / max(float(np.ptp(run.channels[place, there])), 1e-300)

    prediction, place = max(
        ((one, row) for one in answer.runs for row in range(len(channels))), key=size)
    panels = list(channels[place].panels(prediction, place, 0))
    if len(panels[-1].series) > 1:  # the bands are narrow beside the misfit without causes
        panels.append(replace(panels[-1], row=2, series=panels[-1].series[1:],
                              y_label=f'with causes\n{channels[place].unit}'.rstrip()))
    chart = Chart(tuple(panels), width=9.4, height=3.0 + 1.4 * (len(panels) - 1),
                  heights=(MAIN, *(STRIP,) * (len(panels) - 1)), shares_x=True)
    return html.picture(chart, 'proof', f'{channels[place].name} in {_place(prediction)}: '
                        'measured and simulated; below, the misfit with its bands.')


def _misfit(answer: Diagnosis, channels: Sequence[_Channel]) -> str:
    parts = []
    for number_of_run, prediction in enumerate(answer.runs, start=1):
        panels = [panel for place, channel in enumerate(channels)
                  for panel in channel.panels(prediction, place, 2 * place)]
        chart = Chart(tuple(panels), width=9.4, height=1.0 + 3.0 * len(channels),
                      heights=(MAIN, STRIP) * len(channels), shares_x=True)
        parts.append(html.picture(
            chart, f'misfit_{number_of_run}',
            f'{_place(prediction)}: measured and simulated, and the misfit below each channel.'))
    return html.section('Runs, measured and simulated', *parts)


def _place(prediction: RunPrediction) -> str:
    return f'{prediction.run.name}, {"held out" if prediction.run.held_out else "fitted"}'


def summary_text(diagnosis: Diagnosis) -> str:
    """Verdict, causes, misfit reduction, parameters, warnings of a declared model."""
    lines = [verdict_line(diagnosis.verdict), diagnosis.headline]
    for cause in diagnosis.causes:
        lines += wording.cause_lines(
            cause.entry(), wording.estimates_words(cause.parameters), diagnosis.title_of,
            diagnosis.gain.how, diagnosis.remainder)
    if next_test := diagnosis.next_test or wording.fit_too_words(diagnosis.remainder):
        share = ''.join(
            ' If the true cause is an alternative, the test leaves it alone in '
            f'{round(100 * best.share)} of 100 simulated draws{best.caveat}.'
            for best in diagnosis.separations[:1])
        lines.append(f'next test: {next_test}{share}')
    gain = diagnosis.gain
    if diagnosis.causes and gain.how != 'none':
        lines.append(f'misfit reduction: {wording.gain_words(gain.fit, gain.held_out, gain.how)}')
    lines += wording.certainty_lines(wording.certainty_document(diagnosis), diagnosis.title_of)
    unseen = [diagnosis.title_of(limit.effect) for limit in diagnosis.observability.limits
              if not limit.testable]
    if unseen and diagnosis.verdict in ('none', 'unknown'):
        lines.append(f'These data cannot test {wording.joined(unseen)}.')
    if diagnosis.verdict == 'unknown':
        lines.append(wording.tried_words(
            len(diagnosis.observability.limits), len(diagnosis.search.candidates),
            has_law=diagnosis.law is not None
            if diagnosis.fits.metric.problem.assumptions.proposes_law else None))
        after = diagnosis.residual_after
        tests = sorted((*after.consistency, *after.shapes), key=lambda test: test.p_value)
        lines += dict.fromkeys(
            f'  residual: {shape.view} along {shape.coordinate}, {percent(shape.visible)} of range'
            for shape in tests[:4] if shape.p_value < CHANCE)
    lines += ['', 'base parameters (alone -> with the causes):', *(
        f'  {one.name}: {wording.base_words(diagnosis.base_alone, one)} -> '
        f'{wording.base_words(diagnosis.base, one)}'
        for one in diagnosis.fits.metric.problem.system.base_parameters)]
    lines += [f'warning: {warning}' for warning in diagnosis.warnings]
    if not diagnosis.converged:
        lines.append('not converged: a fit on which the verdict rests ended before its optimum')
    return '\n'.join(lines)
