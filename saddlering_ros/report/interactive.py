"""Figures to zoom into: what matplotlib has drawn, said again as plotly.js wants it.

Each figure is drawn once. Its picture is what is printed, mailed and read without scripts; from
the same lines, bands and images a browser makes a figure to zoom into and to read values off.
"""

from __future__ import annotations

import base64
from functools import lru_cache
import gzip
import json
from typing import Any

from matplotlib.axes import Axes
from matplotlib.colors import to_hex
from matplotlib.figure import Figure
from matplotlib.legend import Legend
from matplotlib.lines import Line2D
from matplotlib.patches import Patch, Rectangle
import numpy as np
from numpy.typing import NDArray

PIXELS_PER_INCH = 100.0
DIGITS = 7
"""Significant digits of a coordinate: finer than any screen."""

SYMBOLS = {'^': 'triangle-up', 'v': 'triangle-down', 'o': 'circle', 'D': 'diamond', '.': 'circle',
           '|': 'line-ns'}
DASHES = {'-': 'solid', '--': 'dash', ':': 'dot', '-.': 'dashdot'}
GRID, EDGE, INK = '#e4e8ec', '#7b8794', '#26323d'

Chart = dict[str, Any]


def chart_of(figure: Figure) -> Chart:
    """`data`, `layout` and `height` [px] of a figure for plotly.js."""
    figure.draw_without_rendering()
    names = _names_by_colour(figure)
    drawn = [axes for axes in figure.axes if axes.get_label() != '<colorbar>']
    traces: list[Chart] = []
    layout: Chart = {
        'margin': {'l': 6, 'r': 6, 't': 34, 'b': 6}, 'paper_bgcolor': '#fff', 'shapes': [],
        'plot_bgcolor': '#fff', 'hovermode': 'closest', 'annotations': [],
        'font': {'size': 12, 'color': INK},
        'legend': {'orientation': 'h', 'x': 0.5, 'xanchor': 'center', 'y': 0.0,
                   'yanchor': 'bottom', 'yref': 'container'},
        'hoverlabel': {'align': 'left'},
    }
    said: set[str] = set()
    for number, axes in enumerate(drawn, start=1):
        suffix = '' if number == 1 else str(number)
        traces += _traces(axes, suffix, names, said)
        layout['shapes'] += _shapes(axes, suffix)
        layout['annotations'] += _title(axes)
        if axes.images:
            layout['plot_bgcolor'] = to_hex(axes.get_facecolor())
        layout[f'xaxis{suffix}'] = _axis(axes, 'x', suffix, drawn)
        layout[f'yaxis{suffix}'] = _axis(axes, 'y', suffix, drawn)
    traces += _patches(figure)
    _show_scale(figure, traces)
    layout['showlegend'] = bool(said)
    return {'data': traces, 'layout': layout,
            'height': round(float(figure.get_figheight()) * PIXELS_PER_INCH)}


def as_script(chart: Chart, name: str) -> str:
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


def _names_by_colour(figure: Figure) -> dict[str, str]:
    """What the figure's legends call a colour, for lines that carry no label."""
    names = {}
    for legend in _legends(figure):
        for handle, text in zip(legend.legend_handles, legend.get_texts(), strict=True):
            if isinstance(handle, Line2D):
                names[to_hex(handle.get_color())] = text.get_text()
    return names


def _show_scale(figure: Figure, traces: list[Chart]) -> None:
    """Put the figure's colour bar beside its last heat map."""
    bars = [axes for axes in figure.axes if axes.get_label() == '<colorbar>']
    maps = [trace for trace in traces if trace['type'] == 'heatmap']
    if not bars or not maps:
        return
    place = bars[0].get_position()
    maps[-1] |= {'showscale': True, 'colorbar': {
        'x': float(place.x0), 'xanchor': 'left', 'thickness': 12, 'outlinewidth': 0,
        'y': 0.5 * float(place.y0 + place.y1), 'len': float(place.height),
        'title': {'text': bars[0].get_ylabel(), 'side': 'right'}}}


def _patches(figure: Figure) -> list[Chart]:
    """Traces without points that put the bands' names into the legend."""
    return [
        {'type': 'scatter', 'x': [None], 'y': [None], 'mode': 'markers', 'name': text.get_text(),
         'marker': {'symbol': 'square', 'size': 11, 'color': to_hex(handle.get_facecolor())},
         'opacity': float(handle.get_alpha() or 1.0), 'hoverinfo': 'skip'}
        for legend in _legends(figure)
        for handle, text in zip(legend.legend_handles, legend.get_texts(), strict=True)
        if isinstance(handle, Patch)]


def _legends(figure: Figure) -> list[Legend]:
    own = [axes.get_legend() for axes in figure.axes]
    return [*figure.legends, *(legend for legend in own if legend is not None)]


def _traces(axes: Axes, suffix: str, names: dict[str, str], said: set[str]) -> list[Chart]:
    traces = [
        _line(line, axes, suffix, names, said) for line in axes.get_lines()
        if line.get_transform() == axes.transData
    ]
    for image in axes.get_images():
        traces.append(_heat_map(axes, image, suffix))
    return traces


def _line(line: Line2D, axes: Axes, suffix: str, names: dict[str, str],
          said: set[str]) -> Chart:
    label = str(line.get_label())
    colour = to_hex(line.get_color())
    name = names.get(colour, '') if label.startswith('_') else label
    trace: Chart = {
        'type': 'scatter', 'x': _numbers(line.get_xdata()), 'y': _numbers(line.get_ydata()),
        'xaxis': f'x{suffix}', 'yaxis': f'y{suffix}', 'name': name, 'legendgroup': name,
        'showlegend': bool(name) and name not in said,
        'hovertemplate': f'{_hover_words(axes)}<extra>{name}</extra>',
    }
    said.update([name] if name else [])
    marker, style = str(line.get_marker()), str(line.get_linestyle())
    if marker in SYMBOLS:
        trace['marker'] = _marker(line, marker, colour)
    if style in DASHES:
        trace['line'] = {'color': colour, 'dash': DASHES[style],
                         'width': round(1.25 * float(line.get_linewidth()), 2)}
    trace['mode'] = '+'.join(
        part for part, here in (('lines', style in DASHES), ('markers', marker in SYMBOLS))
        if here) or 'lines'
    alpha = line.get_alpha()
    if alpha is not None:
        trace['opacity'] = float(alpha)
    return trace


def _marker(line: Line2D, marker: str, colour: str) -> Chart:
    is_open = str(line.get_markerfacecolor()) == 'none' or marker == '|'
    found: Chart = {
        'symbol': SYMBOLS[marker] + ('-open' if is_open else ''), 'color': colour,
        'size': round(1.3 * float(line.get_markersize()) * (0.7 if marker == '.' else 1.0), 1)}
    if marker == '|':
        found['line'] = {'width': 2}
    return found


def _heat_map(axes: Axes, image: Any, suffix: str) -> Chart:
    values = np.asarray(image.get_array(), dtype=np.float64)
    colours = [[float(place), to_hex(image.get_cmap()(place))]
               for place in np.linspace(0.0, 1.0, 9)]
    columns, rows = ([text.get_text() for text in axis.get_ticklabels()]
                     for axis in (axes.xaxis, axes.yaxis))
    low, high = image.get_clim()
    return {
        'type': 'heatmap', 'z': [_numbers(row) for row in values], 'zmin': low, 'zmax': high,
        'colorscale': colours, 'showscale': False, 'xaxis': f'x{suffix}', 'yaxis': f'y{suffix}',
        'x0': 0, 'dx': 1, 'y0': 0, 'dy': 1,
        'customdata': [[f'{_at(rows, i)}<br>{_at(columns, j)}' for j in range(values.shape[1])]
                       for i in range(values.shape[0])],
        'hovertemplate': '%{customdata}<br>%{z:.3g}<extra></extra>', 'hoverongaps': False,
    }


def _at(labels: list[str], place: int) -> str:
    return labels[place] if place < len(labels) else ''


def _hover_words(axes: Axes) -> str:
    """'load / t: 12.3' above 'δx / µm: 45.6', with labels of the column's foot and row's head."""
    across = axes.get_xlabel() or next(
        (other.get_xlabel() for other in axes.get_shared_x_axes().get_siblings(axes)
         if other.get_xlabel()), 'x')
    up = axes.get_ylabel().replace('\n', ' / ') or _left_label(axes) or 'y'
    value = '%{y:.4g}' if axes.yaxis.get_ticklabels() else '%{y}'
    return f'{across}: %{{x:.4g}}<br>{up}: {value}'


def _left_label(axes: Axes) -> str:
    """The label of the axes at the left end of the same row."""
    place = axes.get_subplotspec()
    figure = axes.figure
    if place is None or figure is None:
        return ''
    for other in figure.axes:
        there = other.get_subplotspec()
        if (there is not None and there.rowspan == place.rowspan
                and there.get_gridspec() is place.get_gridspec() and other.get_ylabel()):
            return other.get_ylabel()
    return ''


def _shapes(axes: Axes, suffix: str) -> list[Chart]:
    """Bands and straight lines across the whole of the axes."""
    shapes: list[Chart] = []
    for patch in axes.patches:
        if isinstance(patch, Rectangle):
            low, size = float(patch.get_y()), float(patch.get_height())
            shapes.append({
                'type': 'rect', 'xref': f'x{suffix} domain', 'yref': f'y{suffix}', 'x0': 0,
                'x1': 1, 'y0': low, 'y1': low + size, 'line': {'width': 0}, 'layer': 'below',
                'fillcolor': to_hex(patch.get_facecolor()),
                'opacity': float(patch.get_alpha() or 1.0)})
    for line in axes.get_lines():
        if line.get_transform() != axes.transData:
            height = float(np.asarray(line.get_ydata(), dtype=np.float64)[0])
            shapes.append({
                'type': 'line', 'xref': f'x{suffix} domain', 'yref': f'y{suffix}', 'x0': 0,
                'x1': 1, 'y0': height, 'y1': height,
                'line': {'color': to_hex(line.get_color()), 'width': 1}})
    return shapes


def _title(axes: Axes) -> list[Chart]:
    text = axes.get_title()
    if not text:
        return []
    place = axes.get_position()
    return [{'text': text, 'xref': 'paper', 'yref': 'paper', 'showarrow': False,
             'x': 0.5 * (place.x0 + place.x1), 'y': place.y1, 'yanchor': 'bottom',
             'xanchor': 'center'}]


def _axis(axes: Axes, way: str, suffix: str, drawn: list[Axes]) -> Chart:
    own = axes.xaxis if way == 'x' else axes.yaxis
    place = axes.get_position()
    low, high = (place.x0, place.x1) if way == 'x' else (place.y0, place.y1)
    limits = axes.get_xlim() if way == 'x' else axes.get_ylim()
    is_log = own.get_scale() == 'log'
    parameters = own.get_tick_params()
    shown = parameters.get('labelbottom' if way == 'x' else 'labelleft', True)
    found: Chart = {
        'domain': [round(float(low), 5), round(float(high), 5)],
        'anchor': f'{"y" if way == "x" else "x"}{suffix}', 'showgrid': not axes.images,
        'gridcolor': GRID, 'linecolor': EDGE, 'showline': True, 'zeroline': False,
        'ticks': 'outside', 'ticklen': 3, 'showticklabels': bool(shown),
        'title': {'text': own.get_label_text().replace('\n', '<br>'), 'standoff': 4,
                  'font': {'size': 12}},
        'type': 'log' if is_log else 'linear',
        'range': [float(np.log10(end)) if is_log else float(end) for end in limits],
    }
    if is_log:
        decades = abs(np.log10(limits[1] / limits[0]))
        found |= {'dtick': 1 if decades > 2.0 else 'D2', 'exponentformat': 'none'}
    labels = [text.get_text() for text in own.get_ticklabels()]
    if _has_words(labels):
        found |= {'tickvals': [float(tick) for tick in own.get_ticklocs()], 'ticktext': labels,
                  'tickfont': {'size': 11}}
    if way == 'x':
        first = _first_sharing(axes, drawn)
        if first is not axes:
            number = drawn.index(first) + 1
            found['matches'] = 'x' if number == 1 else f'x{number}'
    return found


def _first_sharing(axes: Axes, drawn: list[Axes]) -> Axes:
    shared = axes.get_shared_x_axes()
    return next(other for other in drawn if other is axes or shared.joined(other, axes))


def _has_words(labels: list[str]) -> bool:
    return any(text and not text.lstrip('−-').replace('.', '').isdigit() and '$' not in text
               for text in labels)


def _numbers(values: Any) -> list[float | None]:
    found: NDArray[np.float64] = np.asarray(values, dtype=np.float64)
    return [float(f'{value:.{DIGITS}g}') if np.isfinite(value) else None
            for value in found.tolist()]
