"""A diagnosis as one HTML page: verdict, causes, misfit by run and channel, curves."""

from __future__ import annotations

from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np

from saddlering_ros.discrepancy.verdict.results import Diagnosis, RunPrediction
from saddlering_ros.discrepancy.verdict.wording import (
    estimate_words,
    estimates_words,
    gain_words,
    PARTIAL,
)
from saddlering_ros.pages import html
from saddlering_ros.pages.certainty import certainty
from saddlering_ros.pages.charts import AFTER, BEFORE, Chart, line, Panel, without_inner_labels
from saddlering_ros.pages.html import code, number
from saddlering_ros.quantities import probability, quantity, VERDICT_WORDS

MAX_POINTS = 600
"""Largest number of drawn samples of a curve."""


def write_page(answer: Diagnosis, path: Path) -> None:
    """Write the page whole, or not at all."""
    title = f'Verdict: {answer.verdict} ({VERDICT_WORDS[answer.verdict]})'
    html.write_page(path, html.page(title, [
        f'<div class="verdict {answer.verdict}">{html.paragraph(title, "headline")}'
        f'{html.paragraph(answer.headline)}</div>',
        html.section('Warnings', html.bullets(answer.warnings)),
        _causes(answer), certainty(_certainty_document(answer)), _base(answer),
        _misfit(answer), _limits(answer)]))


def _certainty_document(answer: Diagnosis) -> dict[str, Any]:
    """What the pictures of certainty show, as the document of a ring has it."""
    keys = ('remainder', 'influence', 'refits')
    return {'probabilities': answer.probabilities, 'stability': answer.stability,
            'near_limit': getattr(answer, 'near_limit', ()),
            'causes': [{'effect': cause.effect} for cause in answer.causes],
            **{key: [asdict(item) for item in getattr(answer, key, ())] for key in keys}}


def _causes(answer: Diagnosis) -> str:
    return html.section('Causes', html.table(
        ['cause', 'parameters', 'alternatives', 'misfit reduction', number('p')],
        [[cause.definition.title + (PARTIAL if cause.partial else ''),
          estimates_words(cause.parameters),
          ', '.join(cause.group[1:]) or '–',
          gain_words(cause.gain.fit, cause.gain.held_out), number(probability(cause.p_value))]
         for cause in answer.causes]))


def _base(answer: Diagnosis) -> str:
    return html.section('Base parameters', html.table(
        ['parameter', number('alone'), number('with the causes')],
        [[code(name), number(estimate_words(answer.base_alone[name])),
          number(estimate_words(item))] for name, item in answer.base.items()]))


def _limits(answer: Diagnosis) -> str:
    return html.section('Detection limits of these data', html.table(
        ['effect', number('size found nine times in ten'), 'can be tested'],
        [[code(item.effect), number(quantity(item.limit, item.unit)),
          'yes' if item.testable else 'no'] for item in answer.observability.limits]))


def _misfit(answer: Diagnosis) -> str:
    names = answer.fits.metric.problem.system.channel_names
    return html.section('Misfit by run and channel', *(
        html.picture(
            _curves(prediction, names), f'misfit_{place + 1}',
            f'{", ".join(names)} in {prediction.run.name}'
            f'{", held out" if prediction.run.held_out else ""}: measured minus simulated, '
            'without and with the causes, over time.')
        for place, prediction in enumerate(answer.runs)))


def _curves(prediction: RunPrediction, names: tuple[str, ...]) -> Chart:
    """Residuals without and with the causes over time, a panel a channel."""
    run = prediction.run
    panels = []
    for row, name in enumerate(names):
        there = np.ones(run.time.size, bool) if run.present is None else run.present[row]
        kept = np.flatnonzero(there)[::max(1, int(there.sum()) // MAX_POINTS)]
        residuals = ((prediction.before, BEFORE, 'without the causes'),
                     (prediction.after, AFTER, 'with the causes'))
        panels.append(Panel(row, 0, 'time', name, tuple(
            line(run.time[kept], (run.channels - simulated)[row, kept], colour, words, width=0.9)
            for simulated, colour, words in residuals), levels=(0.0,)))
    return Chart(tuple(without_inner_labels(panels, len(names))), width=9.4,
                 height=1.0 + 1.8 * len(names), heights=(1.0,) * len(names), shares_x=True)
