"""Charts as plotly.js draws them: figures to zoom into and to read values off."""

import base64
from collections.abc import Sequence
from functools import lru_cache
import gzip
import json
import math
from typing import Any

import numpy as np

from saddlering_ros.pages import charts
from saddlering_ros.pages.charts import Array, Chart, HeatMap, Panel, Series, ShadedBand, Ticks

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
        'showlegend': bool(chart.named),
    }
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
        layout['shapes'] += _shapes(panel, suffix)
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
                'marker': {'symbol': 'square', 'size': 11, 'color': charts.NOISE},
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
    ticks = _log_ticks(values) if is_log else ticks
    if ticks is not None:
        words = [one.replace('\n', '<br>') for one in ticks.words]
        axis |= {'tickvals': list(ticks.at), 'ticktext': words, 'tickfont': {'size': 11}}
    return axis


def _log_ticks(values: Sequence[Array]) -> Ticks:
    """A number at each decade, and at 2 and 5 where there are few decades."""
    positive = np.concatenate([series[series > 0.0] for series in values] or [np.ones(1)])
    low, high = np.log10([positive.min(), positive.max()] if positive.size else [1.0, 1.0])
    digits = (1, 2, 5) if high - low <= charts.FEW_DECADES else (1,)
    at = tuple(float(f'{digit}e{power}') for power in range(math.floor(low), math.ceil(high) + 1)
               for digit in digits)
    return Ticks(at, tuple(f'{value:g}' for value in at))


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


def _shapes(panel: Panel, suffix: str) -> list[Plotly]:
    """Bands and straight lines across the whole of the panel."""
    place = {'xref': f'x{suffix} domain', 'yref': f'y{suffix}', 'x0': 0, 'x1': 1}
    return [
        *({'type': 'rect', **place, 'y0': band.low, 'y1': band.high, 'line': {'width': 0},
           'layer': 'below', 'fillcolor': charts.NOISE, 'opacity': band.opacity}
          for band in panel.bands),
        *({'type': 'line', **place, 'y0': level, 'y1': level,
           'line': {'color': charts.NOISE, 'width': 1}} for level in panel.levels)]


def _numbers(values: Array) -> list[float | None]:
    return [float(f'{value:.{DIGITS}g}') if np.isfinite(value) else None
            for value in np.asarray(values, dtype=np.float64).tolist()]
