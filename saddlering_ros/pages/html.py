"""One HTML page in one file: text, tables and figures to zoom into, without downloads."""

import base64
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
import html
import io
from pathlib import Path
import re
from textwrap import fill
from typing import Any

from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from PIL import Image

from saddlering_ros.errors import ReportError
from saddlering_ros.files import check_ending, PAGE_ENDINGS, write_text
from saddlering_ros.pages import charts
from saddlering_ros.pages.charts import AFTER, BEFORE, Chart, draw, NOISE
from saddlering_ros.quantities import percent, remainder_words, shares_in_words, span, verdict_line

RESOLUTION, COLOURS = 100, 128
"""Pixels per inch and number of colours of a picture, which needs a third of the bytes without a
visible difference."""

MIN_CHAPTERS = 4
"""A page of fewer chapters needs no list of them."""

PHONE_LETTERS = 40
"""Letters of a row that fit the width of a phone (390 px); a longer row stands as a list there."""

NOTHING = ('', '–')
"""Texts of cells without a value."""

escape = html.escape

SCRIPT, STYLE = (Path(__file__).with_name(name) for name in ('charts.js', 'page.css'))


def write_page(path: Path | str, document: str) -> None:
    """Write a page whole, or not at all."""
    check_ending(path, PAGE_ENDINGS, ReportError)
    write_text(path, document, ReportError)


@dataclass(frozen=True)
class Cell:
    """One cell of a table: text, or finished HTML; number aligns right, mark colours it."""

    text: str
    is_number: bool = False
    mark: str = ''
    is_html: bool = False


def number(text: str, mark: str = '') -> Cell:
    """A cell that holds a number."""
    return Cell(text, is_number=True, mark=mark)


def code(text: str) -> Cell:
    """A cell that holds an identifier."""
    return Cell(f'<code>{escape(text)}</code>', is_html=True)


def page(title: str, parts: Sequence[str]) -> str:
    """The whole document; the plotting library is in it once, if there is a figure.

    If there are several chapters, links to them stand before the first.
    """
    inside, scripts = '\n'.join(chapter for chapter in parts if chapter), ''
    chapters = re.findall(r'<section id="([^"]+)"><h2>(.*?)</h2>', inside)
    if len(chapters) >= MIN_CHAPTERS:
        links = ''.join(f'<li><a href="#{name}">{words}</a></li>' for name, words in chapters)
        inside = inside.replace(
            '<section', f'<nav aria-label="Contents"><ol class="contents">{links}</ol></nav>\n'
            '<section', 1)
    if 'data-chart="' in inside:
        scripts = (f'<script type="application/octet-stream" id="plotly">{charts.library()}'
                   f'</script>\n<script>{SCRIPT.read_text(encoding="utf-8")}</script>\n')
    return (
        '<!doctype html>\n<html lang="en"><head><meta charset="utf-8">'
        '<meta name="viewport" content="width=device-width, initial-scale=1">'
        f'<link rel="icon" href="data:,"><title>{escape(title)}</title>'
        f'<style>\n{STYLE.read_text(encoding="utf-8")}</style></head>\n<body><main>\n'
        f'{inside}\n</main>\n{scripts}</body></html>\n')


def section(title: str, *parts: str) -> str:
    """A framed chapter; empty if it has no parts."""
    inside = '\n'.join(piece for piece in parts if piece)
    name = re.sub(r'\W+', '-', title.lower()).strip('-')
    return (f'<section id="{name}"><h2>{escape(title)}</h2>\n{inside}\n</section>' if inside
            else '')


def heading(text: str) -> str:
    """A heading inside a section."""
    return f'<h3>{escape(text)}</h3>'


def commands(lines: Sequence[str]) -> str:
    """Command lines to be copied; empty if there are none."""
    return f'<pre>{escape(chr(10).join(lines))}</pre>' if lines else ''


def paragraph(text: str, kind: str = '') -> str:
    """A paragraph of plain text, empty without one; a percentage is not broken between lines."""
    return f'<p{_class(kind)}>{escape(text)}</p>'.replace(' %', '\u00a0%') if text else ''


def found(kind: str, *parts: str) -> str:
    """The frame at the head of a page with what has been found; kind: of a verdict."""
    return f'<div class="verdict {kind}">' + '\n'.join(filter(None, parts)) + '</div>'


def verdict(kind: str, headline: str, *parts: str) -> str:
    """The frame of a verdict, which begins with what it means."""
    return found(kind, paragraph(verdict_line(kind).capitalize(), 'soft'),
                 paragraph(headline, 'headline'), *parts)


def bullets(lines: Sequence[str]) -> str:
    """A list of plain lines; empty if there are none."""
    items = ''.join(f'<li>{escape(line)}</li>' for line in lines)
    return f'<ul>{items}</ul>' if items else ''


def folded(title: str, *parts: str) -> str:
    """A chapter that opens at a click."""
    inside = '\n'.join(piece for piece in parts if piece)
    return f'<details><summary>{escape(title)}</summary>\n{inside}\n</details>' if inside else ''


def tiles(items: Sequence[tuple[str, str]]) -> str:
    """A row of big figures, each with its name."""
    shown = ''.join(f'<div class="tile"><b>{escape(value)}</b><span>{escape(words)}</span></div>'
                    for value, words in items)
    return f'<div class="tiles">{shown}</div>'


def table(head: Sequence[str | Cell], rows: Sequence[Sequence[str | Cell]],
          caption: str = '') -> str:
    """A table without its empty columns; empty if there are no rows.

    A column under a `number` holds numbers; only those with a mark need to say so themselves.
    """
    if not rows:
        return ''
    shown = [column for column in range(len(head))
             if any(_text(row[column]) not in NOTHING for row in rows)]
    head = [head[column] for column in shown]
    rows = [[number(cell) if isinstance(title, Cell) and isinstance(cell, str) else cell
             for title, cell in zip(head, (row[column] for column in shown), strict=True)]
            for row in rows]
    title = f'<caption>{escape(caption)}</caption>' if caption else ''
    top = ''.join(_cell(cell, 'th') for cell in head)
    columns = [[_plain(row[column]) for row in rows] for column in range(len(head))]
    is_wide = sum(max(map(len, cells)) for cells in columns) > PHONE_LETTERS
    names = [_plain(cell) if is_wide else '' for cell in head]
    body = ''.join('<tr>' + ''.join(
        _cell(cell, 'td', name) for cell, name in zip(row, names, strict=True)) + '</tr>'
        for row in rows)
    kind = ' class="wide"' if is_wide else ''
    return (f'<div class="scroll"><table{kind}>{title}<thead><tr>{top}</tr></thead>'
            f'<tbody>{body}</tbody></table></div>')


def picture(chart: Chart, name: str, caption: str) -> str:
    """A chart as picture and as data to draw it from; `name` is its file name."""
    data = base64.b64encode(drawn(chart)).decode()
    script = charts.as_script(charts.chart_of(chart), escape(name))
    return (f'<figure><img id="{escape(name)}" alt="{escape(caption)}" '
            f'src="data:image/png;base64,{data}">'
            f'<figcaption>{escape(caption)}</figcaption>{script}</figure>')


def drawn(chart: Chart) -> bytes:
    """A chart as a PNG file's bytes."""
    return png(draw(chart))


def pictures_of(document: str) -> dict[str, bytes]:
    """The PNG pictures inlined in a page, by name."""
    return {name: base64.b64decode(data) for name, data in re.findall(
        r'<img id="([^"]+)"[^>]*base64,([^"]+)"', document)}


def png(figure: Figure) -> bytes:
    """A figure as a PNG file's bytes.

    `Figure.savefig` would draw it twice, once for the layout alone.
    """
    figure.set_dpi(RESOLUTION)
    canvas, buffer = FigureCanvasAgg(figure), io.BytesIO()
    canvas.draw()
    seen = Image.frombytes('RGBA', canvas.get_width_height(), bytes(canvas.buffer_rgba()))
    seen.convert('RGB').quantize(COLOURS, method=Image.Quantize.FASTOCTREE).save(
        buffer, 'PNG', optimize=False)
    return buffer.getvalue()


def _text(cell: str | Cell) -> str:
    return cell.text if isinstance(cell, Cell) else cell


def _plain(cell: str | Cell) -> str:
    """The words of a cell without its tags."""
    return html.unescape(re.sub(r'<[^>]+>', ' ', _text(cell))).strip()


def _cell(given: str | Cell, tag: str, name: str = '') -> str:
    """A cell; name: of its column, which a phone shows beside it."""
    cell = given if isinstance(given, Cell) else Cell(given)
    kinds = ' '.join(filter(None, (
        'n' if cell.is_number else '', cell.mark, 'none' if cell.text in NOTHING else '')))
    text = cell.text if cell.is_html else escape(cell.text)
    beside = f' data-is="{escape(name)}"' if name else ''
    return f'<{tag}{_class(kinds)}{beside}>{text}</{tag}>'


def _class(kind: str) -> str:
    return f' class="{kind}"' if kind else ''


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
        picture(bars(outcomes, 'probability / %', 100.0), 'probabilities', 'Probability of '
                     'each cause, of no cause, and of an unknown one.') if outcomes else '',
        picture(tried, 'refits', 'Refits of the data under other conditions: '
                     f'{percent(document["stability"])} have the same first cause.')
        if refits and first else '',
        picture(bars(influences, 'share of the evidence / %'), 'influence', 'Evidence for '
                     'the causes by stretch of a run, the largest first. Red: a stretch against '
                     'them.') if influences else '',
        picture(bars(remainders, "rms / % of the channel's range"), 'remainder', 'Misfit '
                     'that fits no cause, by run and channel, with the coordinate that it follows '
                     'most.') if remainders else '']
    shown = '\n'.join(filter(None, pictures))
    return section('How certain the verdict is',
                        f'<div class="pair">{shown}</div>' if shown else '',
                        bullets(list(document.get('near_limit') or ())))


def bars(rows: Sequence[Row], label: str, top: float | None = None) -> charts.Chart:
    """One bar for each row, from the top down; top: end of the axis."""
    rows = rows[:MAX_ROWS]
    series = [charts.line([0.0, size], [place, place], colour, width=9.0)
              for place, (_, size, colour) in enumerate(rows)]
    return rows_down([row[0] for row in rows], series, label, (top,) if top else ())


def rows_down(words: Sequence[str], series: Sequence[charts.Series], label: str,
              ends: Sequence[float] = (), x_ticks: charts.Ticks | None = None) -> charts.Chart:
    """Series from the top down beside their words; ends: values that the axis reaches."""
    series = [*series, *(charts.markers([end], [len(words) + 4.0], '.', NOISE, size=0.1)
                         for end in ends)]
    lines = [fill(one, MAX_WORDS) for one in words]
    panel = charts.Panel(0, 0, label, '', tuple(series), x_ticks=x_ticks,
                         y_ticks=charts.Ticks(tuple(map(float, range(len(lines)))), tuple(lines)),
                         y_range=(len(lines) - 0.3, -0.7))
    count = sum(1 + one.count('\n') for one in lines)
    return charts.Chart((panel,), WIDTH, 0.9 + 0.27 * count)
