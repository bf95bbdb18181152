"""How certain a verdict is, as pictures: probabilities, refits, evidence and what fits no cause.

The document of a ring and of a declared model have the same keys.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from textwrap import fill
from typing import Any

from saddlering_ros.pages import html
from saddlering_ros.pages.charts import AFTER, BEFORE, Chart, line, markers, NOISE, Panel, Ticks
from saddlering_ros.quantities import compact, percent, shares_in_words

OUTCOMES = {'none': 'no cause', 'unknown': 'an unknown cause'}
MAX_ROWS = 16
"""Rows of a picture: the largest are shown."""

MAX_WORDS = 48
"""Letters of a line beside a bar."""

WIDTH = 5.8
"""Width of a picture [inches]: two stand side by side on a page."""

Row = tuple[str, float, str]
"""Words beside a bar, its length and its colour."""


def certainty(document: Mapping[str, Any], title_of: Callable[[str], str] = str) -> str:
    """The chapter of a verdict's document, without the pictures for which it has no data."""
    pictures = [_probabilities(document.get('probabilities') or {}, title_of),
                _refits(document, title_of), _influence(document.get('influence') or ()),
                _remainder(document.get('remainder') or ())]
    shown = '\n'.join(filter(None, pictures))
    return html.section('How certain the verdict is',
                        f'<div class="pair">{shown}</div>' if shown else '',
                        html.bullets(list(document.get('near_limit') or ())))


def bars(rows: Sequence[Row], label: str, top: float | None = None) -> Chart:
    """One bar for each row, from the top down; top: end of the axis."""
    rows = rows[:MAX_ROWS]
    words = tuple(fill(row[0], MAX_WORDS) for row in rows)
    places = tuple(float(place) for place in range(len(rows)))
    series = [line([0.0, size], [place, place], colour, width=9.0)
              for place, (_, size, colour) in zip(places, rows, strict=True)]
    end = [markers([top], [places[-1] + 5.0], '.', NOISE, size=0.1)] if top else []
    return _chart(Panel(
        0, 0, label, '', (*series, *end), y_ticks=Ticks(places, words),
        y_range=(places[-1] + 0.7, -0.7), shows_y_label=False, has_y_grid=False),
        len(rows) * max(1 + word.count('\n') for word in words))


def _chart(panel: Panel, rows: int) -> Chart:
    return Chart((panel,), WIDTH, 0.9 + 0.27 * rows)


def _probabilities(probabilities: Mapping[str, float], title_of: Callable[[str], str]) -> str:
    words = shares_in_words(probabilities)
    rows = []
    for outcome, told in words.items():
        title = OUTCOMES.get(outcome) or ' or '.join(map(title_of, outcome.split(' or ')))
        colour = NOISE if outcome in OUTCOMES else AFTER
        rows.append((f'{title}: {told}', 100.0 * probabilities[outcome], colour))
    if not rows:
        return ''
    return html.picture(bars(rows, 'probability / %', 100.0), 'probabilities',
                        'Probability of each cause, of no cause, and of an unknown one.')


def _refits(document: Mapping[str, Any], title_of: Callable[[str], str]) -> str:
    """One row for each refit: whether it has the first cause of the verdict."""
    refits = document.get('refits') or ()
    causes = [cause['effect'] for cause in document['causes'] if 'effect' in cause]
    if not refits or not causes:
        return ''
    rows = [(f'{item["change"]}: ' + (title_of(item['first']) if item['first'] else 'no cause'),
             float(item['first'] == causes[0])) for item in refits[:MAX_ROWS]]
    places = tuple(float(place) for place in range(len(rows)))
    series = [markers([is_same], [place], 'o' if is_same else 'D', AFTER if is_same else BEFORE,
                      size=7.0) for place, (_, is_same) in zip(places, rows, strict=True)]
    panel = Panel(0, 0, 'first cause', '', tuple(series), x_ticks=Ticks(
        (-0.5, 0.0, 1.0, 1.5), ('', 'another', 'the same', '')), y_ticks=Ticks(
        places, tuple(row[0] for row in rows)), y_range=(places[-1] + 0.7, -0.7),
        shows_y_label=False)
    return html.picture(_chart(panel, len(rows)), 'refits', 'Refits of the data under other '
                        f'conditions: {percent(document["stability"])} have the same first cause.')


def _influence(stretches: Sequence[Mapping[str, Any]]) -> str:
    total = sum(max(item['evidence'], 0.0) for item in stretches)
    if not total:
        return ''
    rows = [(f'{item["run"]}, {item["start"]:.3g} to {item["end"]:.3g} s',
             100.0 * item['evidence'] / total, AFTER if item['evidence'] > 0.0 else BEFORE)
            for item in sorted(stretches, key=lambda item: -abs(item['evidence']))]
    return html.picture(bars(rows, 'share of the evidence / %'), 'influence', 'Evidence for the '
                        'causes by stretch of a run, the largest first. Red: a stretch against '
                        'them.')


def _remainder(parts: Sequence[Mapping[str, Any]]) -> str:
    if not parts:
        return ''
    rows = [(f'{item["run"]}, {item["channel"]}, along {item["along"]}: '
             f'{compact(item["times_noise"], 2)} × noise', 100.0 * item['share_of_range'], BEFORE)
            for item in parts]
    return html.picture(bars(rows, "rms / % of the channel's range"), 'remainder',
                        'Misfit that fits no cause, by run and channel, with the coordinate that '
                        'it follows most.')
