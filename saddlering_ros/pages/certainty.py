"""How certain a verdict is, as pictures: probabilities, refits, evidence and what fits no cause.

The document of a ring and of a declared model have the same keys.
"""

from collections.abc import Callable, Mapping, Sequence
from textwrap import fill
from typing import Any

from saddlering_ros.pages import charts, html
from saddlering_ros.pages.charts import AFTER, BEFORE, NOISE
from saddlering_ros.quantities import percent, remainder_words, shares_in_words, span

OUTCOMES = {'none': 'no cause', 'unknown': 'an unknown cause'}
MAX_ROWS, MAX_WORDS = 16, 48
"""Rows of a picture, and letters of a line beside one."""

WIDTH = 5.8
"""Width of a picture [inches]: two stand side by side on a page."""

Row = tuple[str, float, str]
"""Words beside a bar, its length and its colour."""


def certainty(document: Mapping[str, Any], title_of: Callable[[str], str] = str) -> str:
    """The chapter of a verdict's document, without the pictures for which it has no data."""
    shares = document.get('probabilities') or {}
    outcomes = [
        (f'{OUTCOMES.get(outcome) or title_of(outcome)}: {told}',
         100.0 * shares[outcome], NOISE if outcome in OUTCOMES else AFTER)
        for outcome, told in shares_in_words(shares).items()]
    stretches, unit = document.get('influence') or (), document.get('time_unit', 's')
    total = sum(max(item['evidence'], 0.0) for item in stretches)
    influences = [
        (f'{item["run"]}, {span(item["start"], item["end"], unit, 3)}',
         100.0 * item['evidence'] / total, AFTER if item['evidence'] > 0.0 else BEFORE)
        for item in sorted(stretches, key=lambda item: -abs(item['evidence']))] if total else []
    remainders = [
        (remainder_words(item), 100.0 * item['share_of_range'], BEFORE)
        for item in document.get('remainder') or ()]
    refits = (document.get('refits') or ())[:MAX_ROWS]
    first = next((one['effect'] for one in document['causes'] if 'effect' in one), '')
    tried = rows_down(
        [one['change'] if one['is_same'] else f'{one["change"]}: ' + (
            title_of(one['first']) if one['first'] else 'no cause') for one in refits],
        [charts.markers([1.0], [row], 'o', AFTER, size=7.0) if one['is_same'] else
         charts.markers([0.0], [row], 'D', BEFORE, size=7.0) for row, one in enumerate(refits)],
        'first cause', (-0.5, 1.5), charts.Ticks((0.0, 1.0), ('another', 'the same')))
    pictures = [
        html.picture(bars(outcomes, 'probability / %', 100.0), 'probabilities', 'Probability of '
                     'each cause, of no cause, and of an unknown one.') if outcomes else '',
        html.picture(tried, 'refits', 'Refits of the data under other conditions: '
                     f'{percent(document["stability"])} have the same first cause.')
        if refits and first else '',
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


def bars(rows: Sequence[Row], label: str, top: float | None = None) -> charts.Chart:
    """One bar for each row, from the top down; top: end of the axis."""
    rows = rows[:MAX_ROWS]
    series = [charts.line([0.0, size], [place, place], colour, width=9.0)
              for place, (_, size, colour) in enumerate(rows)]
    return rows_down([row[0] for row in rows], series, label, (top,) if top else ())


def rows_down(
    words: Sequence[str], series: Sequence[charts.Series], label: str, ends: Sequence[float] = (),
    x_ticks: charts.Ticks | None = None,
) -> charts.Chart:
    """Series from the top down beside their words; ends: values that the axis reaches."""
    series = [*series, *(charts.markers([end], [len(words) + 4.0], '.', NOISE, size=0.1)
                         for end in ends)]
    lines = [fill(one, MAX_WORDS) for one in words]
    panel = charts.Panel(0, 0, label, '', tuple(series), x_ticks=x_ticks,
                         y_ticks=charts.Ticks(tuple(map(float, range(len(lines)))), tuple(lines)),
                         y_range=(len(lines) - 0.3, -0.7))
    count = sum(1 + one.count('\n') for one in lines)
    return charts.Chart((panel,), WIDTH, 0.9 + 0.27 * count)
