"""A figure as data: panels with lines, bands and heat maps; and its picture by matplotlib.

The picture is printed, mailed and read without scripts. `interactive.py` makes the figure that a
browser zooms into; both show the same because both are made from the same `Chart`.
"""

from collections.abc import Sequence
from contextlib import AbstractContextManager
from dataclasses import dataclass, replace
from functools import cache
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


def compared(
    upper: Panel, unit: str, measured: Array, simulated: Sequence[Series],
    bands: tuple[ShadedBand, ...] = (),
) -> tuple[Panel, Panel]:
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
