"""How certain a verdict is, as pictures: probabilities, refits, evidence and what fits no cause.

The document of a ring and of a declared model have the same keys.
"""

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
    shares = document.get('probabilities') or {}
    outcomes = [
        (f'{OUTCOMES.get(outcome) or " or ".join(map(title_of, outcome.split(" or ")))}: {told}',
         100.0 * shares[outcome], NOISE if outcome in OUTCOMES else AFTER)
        for outcome, told in shares_in_words(shares).items()]
    stretches = document.get('influence') or ()
    total = sum(max(item['evidence'], 0.0) for item in stretches)
    influences = [
        (f'{item["run"]}, {item["start"]:.3g} to {item["end"]:.3g} s',
         100.0 * item['evidence'] / total, AFTER if item['evidence'] > 0.0 else BEFORE)
        for item in sorted(stretches, key=lambda item: -abs(item['evidence']))] if total else []
    remainders = [
        (f'{item["run"]}, {item["channel"]}, along {item["along"]}: '
         f'{compact(item["times_noise"], 2)} × noise', 100.0 * item['share_of_range'], BEFORE)
        for item in document.get('remainder') or ()]
    pictures = [
        html.picture(bars(outcomes, 'probability / %', 100.0), 'probabilities', 'Probability of '
                     'each cause, of no cause, and of an unknown one.') if outcomes else '',
        _refits(document, title_of),
        html.picture(bars(influences, 'share of the evidence / %'), 'influence', 'Evidence for '
                     'the causes by stretch of a run, the largest first. Red: a stretch against '
                     'them.') if influences else '',
        html.picture(bars(remainders, "rms / % of the channel's range"), 'remainder', 'Misfit '
                     'that fits no cause, by run and channel, with the coordinate that it follows '
                     'most.') if remainders else '']
    shown = '\n'.join(filter(None, pictures))
    return html.section('How certain the verdict is',
                        f'<div class="pair">{shown}</div>' if shown else '',
                        html.bullets(list(document.get('near_limit') or ())))


def bars(rows: Sequence[Row], label: str, top: float | None = None) -> Chart:
    """One bar for each row, from the top down; top: end of the axis."""
    rows = rows[:MAX_ROWS]
    words = [fill(row[0], MAX_WORDS) for row in rows]
    series = [line([0.0, size], [place, place], colour, width=9.0)
              for place, (_, size, colour) in enumerate(rows)]
    if top:
        series.append(markers([top], [len(rows) + 4.0], '.', NOISE, size=0.1))
    panel = Panel(0, 0, label, '', tuple(series), y_ticks=_down(words), has_y_grid=False,
                  y_range=(len(rows) - 0.3, -0.7))
    lines = len(rows) * max(1 + word.count('\n') for word in words)
    return Chart((panel,), WIDTH, 0.9 + 0.27 * lines)


def _down(words: Sequence[str]) -> Ticks:
    return Ticks(tuple(map(float, range(len(words)))), tuple(words))


def _refits(document: Mapping[str, Any], title_of: Callable[[str], str]) -> str:
    """One row for each refit: whether it has the first cause of the verdict."""
    refits = (document.get('refits') or ())[:MAX_ROWS]
    causes = [cause['effect'] for cause in document['causes'] if 'effect' in cause]
    if not refits or not causes:
        return ''
    words = [f'{item["change"]}: ' + (title_of(item['first']) if item['first'] else 'no cause')
             for item in refits]
    series = [markers([1.0], [place], 'o', AFTER, size=7.0) if item['first'] == causes[0] else
              markers([0.0], [place], 'D', BEFORE, size=7.0) for place, item in enumerate(refits)]
    panel = Panel(0, 0, 'first cause', '', tuple(series), y_ticks=_down(words),
                  x_ticks=Ticks((-0.5, 0.0, 1.0, 1.5), ('', 'another', 'the same', '')),
                  y_range=(len(words) - 0.3, -0.7))
    return html.picture(
        Chart((panel,), WIDTH, 0.9 + 0.27 * len(words)), 'refits', 'Refits of the data under '
        f'other conditions: {percent(document["stability"])} have the same first cause.')
