"""Charts as matplotlib figures, which can be printed, mailed and read without scripts."""

from __future__ import annotations

from typing import Any

from matplotlib.colors import LinearSegmentedColormap
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch
from matplotlib.ticker import FuncFormatter
import numpy as np

from saddlering_ros.report.charts import Chart, HeatMap, Panel, Series, ShadedBand
from saddlering_ros.report.style import drawing, NOISE

MANY_COLUMNS = 3
"""Grids of more columns than this get smaller titles and ticks."""


def draw(chart: Chart) -> Figure:
    """The chart as a figure."""
    with drawing():
        figure = Figure(figsize=(chart.width, chart.height), layout='constrained')
        grid = figure.subplots(
            len(chart.heights), chart.columns, squeeze=False,
            gridspec_kw={'height_ratios': chart.heights}, sharex='col' if chart.shares_x else
            False)
        for panel in chart.panels:
            _draw_panel(grid[panel.row][panel.column], panel,
                        is_small=chart.columns > MANY_COLUMNS)
        _colour_bar(figure, grid, chart)
        _legend(figure, chart)
        return figure


def _draw_panel(axes: Any, panel: Panel, *, is_small: bool) -> None:
    for band in panel.bands:
        axes.axhspan(band.low, band.high, color=band.colour, alpha=band.opacity, lw=0.0)
    for level in panel.levels:
        axes.axhline(level, color=NOISE, lw=0.8)
    for series in panel.series:
        axes.plot(series.x, series.y, **_look(series))
    if panel.heat is not None:
        _heat_map(axes, panel.heat)
    if panel.x_is_log:
        axes.set_xscale('log')
        axes.xaxis.set_major_formatter(FuncFormatter(lambda value, _: f'{value:g}'))
    if panel.y_is_log:
        axes.set_yscale('log')
    if panel.x_is_log or panel.y_is_log:
        axes.minorticks_off()
    for axis, ticks in ((axes.xaxis, panel.x_ticks), (axes.yaxis, panel.y_ticks)):
        if ticks is not None:
            axis.set_ticks(list(ticks.at), list(ticks.words), fontsize=ticks.size,
                           rotation=90 if ticks.is_upright else 0)
    if panel.y_range is not None:
        axes.set_ylim(*panel.y_range)
    if not panel.has_y_grid:
        axes.grid(axis='y', visible=False)
    axes.tick_params(labelbottom=panel.shows_x, labelleft=panel.shows_y)
    if is_small:
        axes.tick_params(labelsize=7.5)
    if panel.shows_x_label:
        axes.set_xlabel(panel.x_label)
    if panel.shows_y and panel.shows_y_label:
        axes.set_ylabel(panel.y_label)
    if panel.title:
        axes.set_title(panel.title, fontsize=9.0 if is_small else None)


def _look(series: Series) -> dict[str, Any]:
    return {
        'color': series.colour, 'linestyle': series.dash or 'none', 'lw': series.width,
        'marker': series.marker or 'none', 'ms': series.size, 'alpha': series.opacity,
        'mfc': 'none' if series.is_open else series.colour,
        'mew': 2.0 if series.marker == '|' else 0.6 if series.size < 3.0 else 1.0}


def _heat_map(axes: Any, heat: HeatMap) -> None:
    axes.imshow(heat.values, cmap=_colours(heat), vmin=heat.low, vmax=heat.high, aspect='auto')
    axes.set_facecolor(heat.background)
    axes.grid(visible=False)
    axes.tick_params(length=0)


def _colours(heat: HeatMap) -> LinearSegmentedColormap:
    return LinearSegmentedColormap.from_list('', list(heat.colours))


def _colour_bar(figure: Figure, grid: Any, chart: Chart) -> None:
    heats = [panel.heat for panel in chart.panels if panel.heat is not None and panel.heat.label]
    if not heats:
        return
    image = next(axes.images[0] for axes in np.ravel(grid) if axes.images)
    is_open = heats[0].low < 0.0
    bar = figure.colorbar(image, ax=grid, shrink=0.7, pad=0.02,
                          extend='both' if is_open else 'neither')
    bar.set_label(heats[0].label)


def _legend(figure: Figure, chart: Chart) -> None:
    handles = [_handle(item) for item in chart.named]
    if handles:
        figure.legend(handles=handles, loc='outside lower center', ncols=chart.legend_columns)


def _handle(item: Series | ShadedBand) -> Any:
    if isinstance(item, ShadedBand):
        return Patch(color=item.colour, alpha=item.opacity, lw=0.0, label=item.name)
    return Line2D([], [], label=item.name, **_look(item))
