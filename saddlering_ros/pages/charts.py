"""A chart: its data, drawn by matplotlib, and as plotly.js draws it to zoom into."""

import base64
from collections.abc import Sequence
from contextlib import AbstractContextManager
from dataclasses import dataclass, replace
from functools import cache, lru_cache
import gzip
import json
import math
from typing import Any

import matplotlib
from matplotlib.axes import Axes
from matplotlib.colors import LinearSegmentedColormap
from matplotlib.figure import Figure
from matplotlib.font_manager import fontManager, get_font
from matplotlib.lines import Line2D
from matplotlib.patches import Patch
from matplotlib.text import Text
from matplotlib.ticker import FuncFormatter, LogLocator
import numpy as np
from numpy.typing import ArrayLike, NDArray

Array = NDArray[np.float64]

MEASURED = '#26323d'
BEFORE = '#d1495b'
AFTER = '#1f6fb2'
NOISE = '#9aa5b1'
UP, DOWN = '#c77700', '#00798c'

DARK, LIGHT = 0.45, 0.2
"""Opacities of a band of noise, and of a wider one that holds it."""

MAIN, STRIP = 3.0, 1.25
"""Heights of a channel and of its misfit below."""

USUAL_FONT = 'DejaVu Sans'
FONT = {
    'font.family': USUAL_FONT, 'font.size': 9.0, 'axes.titlesize': 10.0,
    'axes.labelsize': 9.0, 'legend.fontsize': 8.0, 'axes.grid': True, 'grid.color': '#e4e8ec',
    'grid.linewidth': 0.7, 'axes.edgecolor': '#7b8794', 'axes.linewidth': 0.8,
    'axes.axisbelow': True, 'axes.spines.top': False, 'axes.spines.right': False,
    'legend.frameon': False, 'lines.linewidth': 1.2, 'xtick.color': '#3e4c59',
    'ytick.color': '#3e4c59', 'axes.unicode_minus': True, 'text.parse_math': False,
}

FEW_DECADES, MANY_COLUMNS = 2.5, 3
"""A logarithmic axis over no more decades than this has ticks at 2 and 5 as well; grids of more
columns than this get smaller titles and ticks."""


def drawing() -> AbstractContextManager[None]:
    """The look of every figure, for the time of drawing it."""
    return matplotlib.rc_context(FONT)


@dataclass(frozen=True)
class Series:
    """One line or row of markers.

    dash: '-', '--', ':' or '' for none; marker: '^', 'v', 'o', 'D', '.', '|' or '' for none;
    width and size in points; name: in the legend, once for all series of that name ('': not).
    """

    x: Array
    y: Array
    colour: str
    name: str = ''
    dash: str = '-'
    marker: str = ''
    width: float = 1.2
    size: float = 4.5
    is_open: bool = False
    opacity: float = 1.0


@dataclass(frozen=True)
class ShadedBand:
    """A band of y across the whole panel; name: in the legend ('': not)."""

    low: float
    high: float
    opacity: float = DARK
    name: str = ''


@dataclass(frozen=True)
class Ticks:
    """Ticks with words instead of numbers; size of the words in points."""

    at: tuple[float, ...]
    words: tuple[str, ...]
    size: float = 8.0


@dataclass(frozen=True)
class HeatMap:
    """Values (R, C) from the top row down, NaN where there are none.

    colours: from `low` to `high`, evenly spaced; rows, columns: names that a hover shows;
    label: of the colour bar, drawn if not ''.
    """

    values: Array
    colours: tuple[str, ...]
    low: float
    high: float
    rows: tuple[str, ...]
    columns: tuple[str, ...]
    label: str = ''
    background: str = '#ffffff'


@dataclass(frozen=True)
class Panel:
    """One pair of axes at a place of the grid.

    x_label and y_label name the quantities; shows_x and shows_y: whether they stand at the
    axis, with its tick labels (a panel that shares an axis leaves them to its neighbour, and a
    heat map has words at its ticks alone). levels: heights of thin lines across the panel.
    """

    row: int
    column: int
    x_label: str
    y_label: str
    series: tuple[Series, ...] = ()
    bands: tuple[ShadedBand, ...] = ()
    levels: tuple[float, ...] = ()
    heat: HeatMap | None = None
    title: str = ''
    shows_x: bool = True
    shows_y: bool = True
    shows_y_label: bool = True
    x_ticks: Ticks | None = None
    y_ticks: Ticks | None = None
    x_is_log: bool = False
    y_is_log: bool = False
    y_range: tuple[float, float] | None = None
    has_y_grid: bool = True


@dataclass(frozen=True)
class Chart:
    """Panels on a grid; width and height in inches, heights: ratios of its rows.

    shares_x: panels of one column share their x axis; only those of the last row show it.
    """

    panels: tuple[Panel, ...]
    width: float
    height: float
    heights: tuple[float, ...] = (1.0,)
    columns: int = 1
    shares_x: bool = False
    legend_columns: int = 5

    def __post_init__(self) -> None:
        if self.shares_x:
            object.__setattr__(self, 'panels', tuple(
                replace(panel, shows_x=panel.row == len(self.heights) - 1)
                for panel in self.panels))

    @property
    def named(self) -> list[Series | ShadedBand]:
        """Entries of the legend: the first series or band of each name."""
        entries: dict[str, Series | ShadedBand] = {}
        for panel in self.panels:
            items: list[Series | ShadedBand] = [*panel.series, *panel.bands]
            for entry in items:
                entries.setdefault(entry.name, entry)
        return [entry for name, entry in entries.items() if name]


def line(x: ArrayLike, y: ArrayLike, colour: str, name: str = '', dash: str = '-',
         width: float = 1.2, opacity: float = 1.0) -> Series:
    """A line through points."""
    return Series(np.asarray(x, float), np.asarray(y, float), colour, name, dash, '', width,
                  opacity=opacity)


def markers(x: ArrayLike, y: ArrayLike, marker: str, colour: str, name: str = '',
            size: float = 4.5, *, is_open: bool = False) -> Series:
    """Markers at points."""
    return Series(np.asarray(x, float), np.asarray(y, float), colour, name, '', marker, size=size,
                  is_open=is_open)


def strokes(x: Array, low: Array, high: Array, name: str = '', dash: str = '-',
            width: float = 1.2, colour: str = NOISE, opacity: float = 1.0) -> Series:
    """Upright strokes (N,) from `low` to `high`, as one line with NaN between them."""
    across, up = (np.stack([*ends, np.full(x.size, np.nan)], axis=1).ravel()
                  for ends in ((x, x), (low, high)))
    return line(across, up, colour, name, dash, width, opacity)


def compared(upper: Panel, unit: str, measured: Array, simulated: Sequence[Series],
             bands: tuple[ShadedBand, ...] = ()) -> tuple[Panel, Panel]:
    """A panel of a measured curve with its simulations, and the misfit of each below it.

    upper: the panel with the measured series and its labels; unit: of the misfit; measured (N,):
    the curve where the simulated ones are; bands: of the misfit.
    """
    misfits = tuple(line(one.x, measured - one.y, one.colour, width=0.9) for one in simulated)
    return (replace(upper, series=(*upper.series, *simulated)),
            Panel(upper.row + 1, upper.column, upper.x_label, f'misfit\n{unit}'.rstrip(), misfits,
                  bands=bands, levels=(0.0,)))


def _legible(text: str) -> str:
    """The text, with the code of each sign that no font has, as on a terminal that lacks it."""
    return ''.join(sign if sign.isascii() or _font_with(sign) else ascii(sign)[1:-1]
                   for sign in text)


@cache
def _font_with(sign: str) -> str:
    """The usual font if it has the sign, else an installed one, else ''."""
    return next((
        font.name for font in sorted(fontManager.ttflist, key=lambda one: one.name != USUAL_FONT)
        if 'Last Resort' not in font.name and ord(sign) in get_font(font.fname).get_charmap()), '')


def draw(chart: Chart) -> Figure:
    """The chart as a figure."""
    with drawing():
        figure = Figure(figsize=(chart.width, chart.height), layout='constrained')
        grid = figure.subplots(
            len(chart.heights), chart.columns, squeeze=False,
            gridspec_kw={'height_ratios': chart.heights}, sharex='col' if chart.shares_x else
            False)
        for panel in chart.panels:
            axes, heat = grid[panel.row][panel.column], panel.heat
            _draw_panel(axes, panel, is_small=chart.columns > MANY_COLUMNS)
            if heat is not None and heat.label:
                figure.colorbar(axes.images[0], ax=grid, shrink=0.7, pad=0.02, label=heat.label,
                                extend='both' if heat.low < 0.0 else 'neither')
        handles = [
            Patch(color=NOISE, alpha=entry.opacity, lw=0.0, label=name)
            if isinstance(entry, ShadedBand) else Line2D([], [], label=name, **_look(entry))
            for entry in chart.named for name in [_legible(entry.name)]]
        if handles:
            figure.legend(handles=handles, loc='outside lower center', ncols=chart.legend_columns)
        for text in figure.findobj(Text):
            # The usual font, and for each sign that it lacks an installed one.
            others = (_font_with(sign) for sign in text.get_text() if not sign.isascii())
            text.set_fontfamily([*dict.fromkeys([USUAL_FONT, *filter(None, others)])])
        return figure


def _draw_panel(axes: Axes, panel: Panel, *, is_small: bool) -> None:
    for band in panel.bands:
        axes.axhspan(band.low, band.high, color=NOISE, alpha=band.opacity, lw=0.0)
    for level in panel.levels:
        axes.axhline(level, color=NOISE, lw=0.8)
    for series in panel.series:
        axes.plot(series.x, series.y, **_look(series))
    if (heat := panel.heat) is not None:
        axes.imshow(heat.values, cmap=LinearSegmentedColormap.from_list('', list(heat.colours)),
                    vmin=heat.low, vmax=heat.high, aspect='auto')
        axes.set_facecolor(heat.background)
        axes.grid(visible=False)
        axes.tick_params(length=0)
    if panel.x_is_log:
        axes.set_xscale('log')
        low, high = axes.get_xlim()
        if high < 10.0**FEW_DECADES * low:
            axes.xaxis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
        axes.xaxis.set_major_formatter(FuncFormatter(lambda value, _: f'{value:g}'))
    if panel.y_is_log:
        axes.set_yscale('log')
    axes.minorticks_off()
    for axis, ticks in ((axes.xaxis, panel.x_ticks), (axes.yaxis, panel.y_ticks)):
        if ticks is not None:
            axis.set_ticks(list(ticks.at), list(map(_legible, ticks.words)), fontsize=ticks.size)
    if panel.y_range is not None:
        axes.set_ylim(*panel.y_range)
    if not panel.has_y_grid:
        axes.grid(axis='y', visible=False)
    axes.tick_params(labelbottom=panel.shows_x, labelleft=panel.shows_y)
    if is_small:
        axes.tick_params(labelsize=7.5)
    if panel.shows_x and panel.heat is None:
        axes.set_xlabel(panel.x_label)
    if panel.shows_y and panel.shows_y_label:
        axes.set_ylabel(panel.y_label)
    if panel.title:
        axes.set_title(_legible(panel.title), fontsize=9.0 if is_small else None)


def _look(series: Series) -> dict[str, Any]:
    return {
        'color': series.colour, 'linestyle': series.dash or 'none', 'lw': series.width,
        'marker': series.marker or 'none', 'ms': series.size, 'alpha': series.opacity,
        'mfc': 'none' if series.is_open else series.colour,
        'mew': 2.0 if series.marker == '|' else 0.6 if series.size < 3.0 else 1.0}


PIXELS_PER_INCH, DIGITS = 100.0, 7
"""DIGITS: significant digits of a coordinate, finer than any screen."""

MARKERS = {'^': 'triangle-up', 'v': 'triangle-down', 'o': 'circle', 'D': 'diamond', '.': 'circle',
           '|': 'line-ns'}
DASHES = {'-': 'solid', '--': 'dash', ':': 'dot', '-.': 'dashdot'}
GRID, EDGE, INK = '#e4e8ec', '#7b8794', '#26323d'
COLUMN_GAP, LABELLED_GAP, ROW_GAP, TITLED_GAP = 0.06, 0.085, 0.035, 0.075
"""Shares of the figure between panels; LABELLED_GAP: where a label stands between two columns."""

BAR, LEGEND_PIXELS = 0.085, 60.0
"""Share of the width that a colour bar takes, and room below the panels for labels and legend."""

Plotly = dict[str, Any]
Span = tuple[float, float]


def chart_of(chart: Chart) -> Plotly:
    """`data`, `layout` and `height` [px] of a chart for plotly.js."""
    height = chart.height * PIXELS_PER_INCH
    layout: Plotly = {
        'margin': {'l': 6, 'r': 6, 't': 48, 'b': 6}, 'paper_bgcolor': '#fff', 'shapes': [],
        'plot_bgcolor': next((panel.heat.background for panel in chart.panels if panel.heat),
                             '#fff'), 'hovermode': 'closest', 'annotations': [],
        'font': {'size': 12, 'color': INK}, 'hoverlabel': {'align': 'left'},
        'legend': {'orientation': 'h', 'x': 0.5, 'xanchor': 'center', 'y': 0.0,
                   'yanchor': 'bottom', 'yref': 'container'},
        'showlegend': bool(chart.named)}
    traces: list[Plotly] = []
    shown, first_of_column = set[str](), dict[int, str]()
    for number, panel in enumerate(chart.panels, start=1):
        suffix = '' if number == 1 else str(number)
        across, up = _domains(chart, panel, height)
        first = first_of_column.setdefault(panel.column, suffix)
        is_heat = panel.heat is not None
        x_axis = _axis(across, f'y{suffix}',
                       panel.x_label if panel.shows_x and not is_heat else '',
                       panel.x_ticks, [series.x for series in panel.series], is_log=panel.x_is_log)
        y_axis = _axis(up, f'x{suffix}',
                       panel.y_label if panel.shows_y and panel.shows_y_label else '',
                       panel.y_ticks, [series.y for series in panel.series], is_log=panel.y_is_log)
        x_axis |= {'showticklabels': panel.shows_x, 'showgrid': not is_heat}
        y_axis |= {'showticklabels': panel.shows_y, 'showgrid': panel.has_y_grid and not is_heat}
        if panel.y_range is not None:
            y_axis['range'] = list(panel.y_range)
        elif is_heat:
            y_axis['autorange'] = 'reversed'
        layout |= {f'xaxis{suffix}': x_axis, f'yaxis{suffix}': y_axis}
        if chart.shares_x and first != suffix:
            layout[f'xaxis{suffix}']['matches'] = f'x{first}'
        # Bands and straight lines across the whole of the panel.
        place = {'xref': f'x{suffix} domain', 'yref': f'y{suffix}', 'x0': 0, 'x1': 1}
        layout['shapes'] += [
            *({'type': 'rect', **place, 'y0': band.low, 'y1': band.high, 'line': {'width': 0},
               'layer': 'below', 'fillcolor': NOISE, 'opacity': band.opacity}
              for band in panel.bands),
            *({'type': 'line', **place, 'y0': level, 'y1': level,
               'line': {'color': NOISE, 'width': 1}} for level in panel.levels)]
        if panel.title:
            layout['annotations'].append({
                'text': panel.title, 'xref': 'paper', 'yref': 'paper', 'showarrow': False,
                'x': 0.5 * (across[0] + across[1]), 'y': up[1], 'yanchor': 'bottom',
                'xanchor': 'center'})
        if panel.heat is not None:
            traces.append(_heat_map(panel.heat, suffix))
        for series in panel.series:
            traces.append(_trace(series, panel, suffix, is_first=series.name not in shown))
            shown.add(series.name)
    # A trace without points puts the name of a band into the legend.
    traces += [{'type': 'scatter', 'x': [None], 'y': [None], 'mode': 'markers', 'name': band.name,
                'marker': {'symbol': 'square', 'size': 11, 'color': NOISE},
                'opacity': band.opacity, 'hoverinfo': 'skip'}
               for band in chart.named if isinstance(band, ShadedBand)]
    return {'data': traces, 'layout': layout, 'height': round(height)}


def as_script(chart: Plotly, name: str) -> str:
    """The chart as a zipped block of data in a page."""
    text = _zipped(json.dumps(chart, separators=(',', ':'), allow_nan=False))
    return f'<script type="application/octet-stream" data-chart="{name}">{text}</script>'


@lru_cache(maxsize=1)
def library() -> str:
    """plotly.js, zipped and in base64: a third of its size, unpacked by the browser."""
    from plotly.offline import get_plotlyjs

    return _zipped(get_plotlyjs())


def _zipped(text: str) -> str:
    return base64.b64encode(gzip.compress(text.encode(), 9, mtime=0)).decode()


def _domains(chart: Chart, panel: Panel, height: float) -> tuple[Span, Span]:
    """Where a panel lies in the figure, across and up, as shares."""
    has_bar = any(one.heat is not None and one.heat.label for one in chart.panels)
    right = 1.0 - BAR * has_bar
    has_labels = any(one.column and one.shows_y and one.shows_y_label for one in chart.panels)
    between = LABELLED_GAP if has_labels else COLUMN_GAP
    width = (right - between * (chart.columns - 1)) / chart.columns
    left = panel.column * (width + between)
    bottom = LEGEND_PIXELS / height if chart.named else 0.0
    is_titled = any(one.title for one in chart.panels if one.row)
    gap = (TITLED_GAP if is_titled else ROW_GAP) if len(chart.heights) > 1 else 0.0
    free = 1.0 - bottom - gap * (len(chart.heights) - 1)
    unit = free / sum(chart.heights)
    top = 1.0 - sum(unit * ratio + gap for ratio in chart.heights[:panel.row])
    low = top - unit * chart.heights[panel.row]
    return (round(left, 5), round(left + width, 5)), (round(low, 5), round(top, 5))


def _axis(domain: Span, anchor: str, label: str, ticks: Ticks | None,
          values: Sequence[Array], *, is_log: bool) -> Plotly:
    """An axis of a panel; values: of its series, which give a logarithmic axis its ticks."""
    axis: Plotly = {
        'domain': list(domain), 'anchor': anchor, 'gridcolor': GRID, 'linecolor': EDGE,
        'showline': True, 'zeroline': False, 'ticks': 'outside', 'ticklen': 3,
        'type': 'log' if is_log else 'linear',
        'title': {'text': label.replace('\n', '<br>'), 'standoff': 4, 'font': {'size': 12}}}
    if is_log:  # A number at each decade, and at 2 and 5 where there are few decades.
        positive = np.concatenate([series[series > 0.0] for series in values] or [np.ones(1)])
        low, high = np.log10([positive.min(), positive.max()] if positive.size else [1.0, 1.0])
        digits = (1, 2, 5) if high - low <= FEW_DECADES else (1,)
        at = tuple(float(f'{digit}e{power}')
                   for power in range(math.floor(low), math.ceil(high) + 1) for digit in digits)
        ticks = Ticks(at, tuple(f'{value:g}' for value in at))
    if ticks is not None:
        words = [one.replace('\n', '<br>') for one in ticks.words]
        axis |= {'tickvals': list(ticks.at), 'ticktext': words, 'tickfont': {'size': 11}}
    return axis


def _trace(series: Series, panel: Panel, suffix: str, *, is_first: bool) -> Plotly:
    name, value = series.name, '%{y:.4g}' if panel.y_ticks is None else '%{y}'
    words = f'{panel.x_label}: %{{x:.4g}}<br>{panel.y_label}: {value}'.replace('\n', ' / ')
    trace: Plotly = {
        'type': 'scatter', 'x': _numbers(series.x), 'y': _numbers(series.y),
        'xaxis': f'x{suffix}', 'yaxis': f'y{suffix}', 'name': name, 'legendgroup': name,
        'showlegend': bool(name) and is_first, 'hovertemplate': f'{words}<extra>{name}</extra>',
        'mode': '+'.join(mode for mode, here in (
            ('lines', series.dash), ('markers', series.marker)) if here) or 'lines'}
    if series.dash:
        trace['line'] = {'color': series.colour, 'dash': DASHES[series.dash],
                         'width': round(1.25 * series.width, 2)}
    if series.marker:
        is_line = series.marker == '|'
        trace['marker'] = {
            'symbol': MARKERS[series.marker] + ('-open' if series.is_open or is_line else ''),
            'color': series.colour,
            'size': round(1.3 * series.size * (0.7 if series.marker == '.' else 1.0), 1),
            **({'line': {'width': 2}} if is_line else {})}
    if series.opacity < 1.0:
        trace['opacity'] = series.opacity
    return trace


def _heat_map(heat: HeatMap, suffix: str) -> Plotly:
    last = len(heat.colours) - 1
    return {
        'type': 'heatmap', 'z': [_numbers(row) for row in heat.values], 'zmin': heat.low,
        'zmax': heat.high, 'colorscale': [
            [place / last, colour] for place, colour in enumerate(heat.colours)],
        'xaxis': f'x{suffix}', 'yaxis': f'y{suffix}', 'x0': 0, 'dx': 1, 'y0': 0, 'dy': 1,
        'customdata': [[f'{row}<br>{column}' for column in heat.columns] for row in heat.rows],
        'hovertemplate': '%{customdata}<br>%{z:.3g}<extra></extra>', 'hoverongaps': False,
        'showscale': bool(heat.label), 'colorbar': {
            'x': 1.0, 'xanchor': 'right', 'thickness': 12, 'outlinewidth': 0, 'len': 0.7,
            'title': {'text': heat.label, 'side': 'right'}}}


def _numbers(values: Array) -> list[float | None]:
    return [float(f'{value:.{DIGITS}g}') if np.isfinite(value) else None
            for value in np.asarray(values, dtype=np.float64).tolist()]
