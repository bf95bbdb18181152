"""A diagnosis as one HTML page: verdict, causes, misfit by run and channel, curves."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from html import escape
from pathlib import Path

import numpy as np

from saddlering_ros.discrepancy.results import Diagnosis, RunPrediction
from saddlering_ros.discrepancy.summary import estimate_words, gain_words, WORDS
from saddlering_ros.discrepancy.system import Array
from saddlering_ros.quantities import compact, probability, quantity

STYLE = (
    'body{font:16px/1.5 system-ui,sans-serif;max-width:62rem;margin:2rem auto;padding:0 1rem;'
    'color:#1b2733}table{border-collapse:collapse;margin:1rem 0}td,th{padding:.25rem .75rem;'
    'border-bottom:1px solid #d4dbe2;text-align:left}svg{width:100%;height:auto}'
    '.warning{background:#fff4d6;padding:.5rem .75rem;margin:.25rem 0}'
)
COLOURS = {'measured': '#6b7885', 'before': '#c2571a', 'after': '#1f6fb2'}
MAX_POINTS = 600
"""Largest number of drawn samples of a curve."""


def write_page(found: Diagnosis, path: Path) -> None:
    """Write the page whole, or not at all."""
    text = '\n'.join(['<!doctype html><html lang="en"><meta charset="utf-8">', *_parts(found)])
    part = path.with_name(f'{path.name}.part')
    part.write_text(f'{text}\n</html>\n', encoding='utf-8')
    part.replace(path)


def _parts(found: Diagnosis) -> Iterator[str]:
    title = f'Verdict: {found.verdict}'
    yield f'<title>{escape(title)}</title><style>{STYLE}</style>'
    yield f'<h1>{escape(title)}</h1><p>{escape(WORDS[found.verdict].capitalize())}.</p>'
    for warning in found.warnings:
        yield f'<p class="warning">{escape(warning)}</p>'
    if found.causes:
        yield '<h2>Causes</h2>'
        yield _table(
            ['cause', 'parameters', 'alternatives', 'misfit reduction', 'p'],
            [
                [
                    cause.definition.title + (' (part of it only)' if cause.partial else ''),
                    ', '.join(
                        f'{name} {estimate_words(item)}' for name, item in cause.parameters.items()
                    ),
                    ', '.join(cause.group[1:]) or '-',
                    gain_words(cause.gain.fit, cause.gain.held_out),
                    probability(cause.p_value),
                ]
                for cause in found.causes
            ],
        )
    yield '<h2>Base parameters</h2>'
    yield _table(
        ['parameter', 'alone', 'with the causes'],
        [
            [name, estimate_words(found.base_alone[name]), estimate_words(item)]
            for name, item in found.base.items()
        ],
    )
    yield '<h2>Detection limits of these data</h2>'
    yield _table(
        ['effect', 'size found nine times in ten', 'can be tested'],
        [
            [item.effect, quantity(item.limit, item.unit), 'yes' if item.testable else 'no']
            for item in found.observability.limits
        ],
    )
    names = found.fits.metric.experiment.system.channel_names
    yield '<h2>Misfit by run and channel</h2>'
    for item in found.runs:
        held_out = ', held out' if item.run.held_out else ''
        for channel, name in enumerate(names):
            yield f'<h3>{escape(f"{name} in {item.run.name}{held_out}")}</h3>'
            yield _curves(item, channel)


def _table(head: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    lines = [f'<tr>{"".join(f"<th>{escape(cell)}</th>" for cell in head)}</tr>']
    lines += [f'<tr>{"".join(f"<td>{escape(cell)}</td>" for cell in row)}</tr>' for row in rows]
    return f'<table>{"".join(lines)}</table>'


def _curves(item: RunPrediction, channel: int) -> str:
    """Residuals without and with the causes over time."""
    run = item.run
    there = np.ones(run.time.size, bool) if run.present is None else run.present[channel]
    kept = np.flatnonzero(there)[:: max(1, int(there.sum()) // MAX_POINTS)]
    time = run.time[kept]
    lines = {
        'before': (run.channels - item.before)[channel, kept],
        'after': (run.channels - item.after)[channel, kept],
    }
    high = max(float(np.nanmax(np.abs(values))) for values in lines.values()) or 1.0
    across = 780.0 * (time - time[0]) / max(float(np.ptp(time)), 1e-300) + 10.0
    drawn = [
        f'<polyline fill="none" stroke="{COLOURS[name]}" stroke-width="1.2" '
        f'points="{_points(across, 90.0 - 80.0 * values / high)}"/>'
        for name, values in lines.items()
    ]
    words = f'residual up to {compact(high)}: without (orange) and with the causes (blue)'
    return (
        f'<svg viewBox="0 0 800 200" role="img" aria-label="{escape(words)}">'
        f'<line x1="10" x2="790" y1="90" y2="90" stroke="{COLOURS["measured"]}"/>'
        f'{"".join(drawn)}<text x="10" y="195" font-size="12">{escape(words)}, over time</text>'
        '</svg>'
    )


def _points(across: Array, down: Array) -> str:
    return ' '.join(f'{x:.1f},{y:.1f}' for x, y in zip(across, down, strict=True))
