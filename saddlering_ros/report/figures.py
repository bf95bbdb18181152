"""The figures of a report as charts; each function describes one, every axis with its unit."""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from saddlering_ros.diagnosis.records import smooth_rate
from saddlering_ros.pages import charts
from saddlering_ros.pages.charts import Chart, HeatMap, markers, Panel, Series, ShadedBand, Ticks
from saddlering_ros.report.curves import Array, branches, RunCurves, spectrum
from saddlering_ros.rig import CHANNELS, force_decimals, FORCE_UNITS, force_words, MICRO_UNITS

MICRO = 1e6
"""Metres to micrometres, radians to microradians."""

SYMBOLS = {'delta_x': 'δx', 'delta_y': 'δy', 'gamma': 'γ', 'parity': 'parity'}

SHOWN = CHANNELS[:3]
"""Channels of the comparison; the published tests show delta_x and gamma only."""

BLUE_TO_PURPLE = ('#f7fcfd', '#e0ecf4', '#bfd3e6', '#9ebcda', '#8c96c6', '#8c6bb1', '#88419d',
                  '#810f7c', '#4d004b')
BROWN_TO_PURPLE = ('#7f3b08', '#b35806', '#e08214', '#fdb863', '#fee0b6', '#f7f7f7', '#d8daeb',
                   '#b2abd2', '#8073ac', '#542788', '#2d004b')
"""Colours by Cynthia Brewer (colorbrewer2.org), which colour-blind readers can distinguish."""

def axis_label(channel: str) -> str:
    """Label of an axis that shows a channel."""
    return f'{SYMBOLS[channel]} / {MICRO_UNITS[channel]}'


def comparison(runs: Sequence[RunCurves]) -> Chart:
    """Measured and simulated channels of some runs side by side, each with its residual below.

    A static run is drawn over its load, a dynamic one over time.
    """
    panels = []
    for column, run in enumerate(runs):
        for place, channel in enumerate(SHOWN):
            panels += _compared(run, channel, 2 * place, column, with_title=place == 0)
    return Chart(
        tuple(panels), width=min(11.4, 1.0 + 5.2 * len(runs)), height=1.0 + 3.0 * len(SHOWN),
        heights=(charts.MAIN, charts.STRIP) * len(SHOWN), columns=len(runs), shares_x=True)


def proof(run: RunCurves, channel: str) -> Chart:
    """One channel of one run, measured and simulated, with its residual below."""
    panels = _compared(run, channel, 0, 0, with_title=False)
    return Chart(tuple(panels), width=9.4, height=4.4,
                 heights=(charts.MAIN, charts.STRIP), shares_x=True)


def _compared(
    run: RunCurves, channel: str, row: int, column: int, *, with_title: bool,
    is_over_load: bool | None = None,
) -> list[Panel]:
    """A channel as measured and simulated, and the residual below.

    is_over_load: against load or time; None: load for a static run, time for a dynamic one.
    """
    place = CHANNELS.index(channel)
    is_static = run.test == 'static'
    over, across = run.time, 'time / s'
    if is_static if is_over_load is None else is_over_load:
        over, across = run.load_in_unit, f'load / {run.force_unit}'
    measured, before, after = (MICRO * item[place] for item in (
        run.measured, run.before, run.after))
    up = run.direction > 0.0
    branches_of = ((up, '^', charts.UP, 'rising'), (~up, 'v', charts.DOWN, 'falling'))
    seen = [
        markers(over[here], measured[here], mark, colour, f'measured, load {words}', is_open=True)
        if is_static else
        charts.line(over, np.where(here, measured, np.nan), colour, f'measured, load {words}',
                    width=4.5, opacity=0.45)
        for here, mark, colour, words in branches_of]
    alone = 'simulated, contact law alone' if run.is_extended else 'simulated'
    versions = [charts.Version(before, charts.BEFORE, alone)]
    if run.is_extended:
        versions.append(charts.Version(after, charts.AFTER, 'simulated, extended model', '--'))
    role = 'held out' if run.held_out else 'fitted'
    title = f'{run.name}: {run.elevation_deg:g}°, {role}' if with_title else ''
    upper, below = charts.compared(
        Panel(row, column, across, axis_label(channel), tuple(seen), title=title),
        MICRO_UNITS[channel], over, measured, versions, _bands(run, channel))
    points = [
        markers(over[here], (measured - one.values)[here], mark, colour, size=4.0, is_open=True)
        for one in versions for here, mark, colour, _ in branches_of if is_static]
    return [upper, replace(below, series=(*below.series, *points))]


def _bands(run: RunCurves, channel: str) -> tuple[ShadedBand, ...]:
    """Twice the noise floor, and twice what a sound ring may do beside it, in micro-units."""
    size = 2.0 * MICRO * run.noise[channel]
    bands = (ShadedBand(-size, size, name='± 2 × noise floor'),)
    if channel not in run.sound:
        return bands
    wide = 2.0 * MICRO * run.sound[channel]
    return (ShadedBand(-wide, wide, opacity=0.12, name='± 2 × noise and sound ring'), *bands)


def of_run(run: RunCurves) -> Chart:
    """One run: every channel over load and over time, and its residual over time."""
    panels = []
    for row, channel in enumerate(SHOWN):
        over_load, _ = _compared(run, channel, row, 0, with_title=False, is_over_load=True)
        over_time, residual = _compared(run, channel, row, 1, with_title=False, is_over_load=False)
        panels += [over_load, over_time, replace(residual, row=row, column=2)]
    title = f'{run.name}: {run.test}, {run.elevation_deg:g}°'
    panels[0] = replace(panels[0], title=title)
    return Chart(tuple(panels), width=12.0, height=9.0,
                 heights=(1.0,) * len(SHOWN), columns=3, shares_x=True)


def over_time(time: Array, channels: Mapping[str, Array], title: str) -> Chart:
    """Channels (N,) [m, rad] over time [s], a panel each."""
    panels = [Panel(row, 0, 'time / s', axis_label(name),
                    (charts.line(time, MICRO * values, charts.MEASURED, width=0.9),),
                    levels=(0.0,), title='' if row else title)
              for row, (name, values) in enumerate(channels.items())]
    return Chart(tuple(panels), width=9.4,
                 height=1.0 + 1.8 * len(panels), heights=(1.0,) * len(panels), shares_x=True)


def misfit(
    runs: Sequence[Mapping[str, Any]], channels: Sequence[str] = CHANNELS[:3], *,
    is_extended: bool = True,
) -> Chart:
    """Misfit before and after against the noise floor, for the `runs` of a verdict's JSON."""
    height, heights, words, series = 0.0, [], [], []
    for run in runs:
        for name in channels:
            if name not in run['channels']:
                continue
            item = run['channels'][name]
            before, after, floor = (100.0 * max(item[key] or 0.0, 1e-6) for key in
                                    ('nrmse_before', 'nrmse_after', 'noise_floor'))
            at = [height]
            drawn = [charts.line([before, after], [height, height], '#cbd2d9', width=2.0),
                     markers([floor], at, '|', charts.NOISE, 'noise floor', size=12.0),
                     markers([before], at, 'o', charts.BEFORE, 'contact law alone', size=6.5),
                     markers([after], at, 'D', charts.AFTER, 'extended model', size=4.5)]
            series += drawn if is_extended else drawn[1:3]
            heights.append(height)
            words.append(f'{name_of(run["bag"])}{" (held out)" if run.get("held_out") else ""}'
                         f'   {SYMBOLS[name]}')
            height += 1.0
        height += 0.6
    panel = Panel(
        0, 0, "rms misfit / % of the channel's range in the run", 'run and channel',
        tuple(series), x_is_log=True, y_ticks=Ticks(tuple(heights), tuple(words)),
        y_range=(height - 0.9, -0.8), shows_y_label=False, has_y_grid=False)
    return Chart((panel,), width=8.6, height=1.2 + 0.235 * len(words) + 0.12 * len(runs),
                 legend_columns=3)


def name_of(bag: object) -> str:
    """The last part of a bag's path."""
    return str(bag).rstrip('/').rsplit('/', 1)[-1]


def residuals(run: RunCurves) -> Chart:
    """The misfit of one run: every channel over all that matters.

    The parity is left out if it is unknown, because a probe is absent.
    """
    channels = [name for row, name in enumerate(CHANNELS) if np.isfinite(run.measured[row]).any()]
    rows = [_views(run, channel) for channel in channels]
    panels = [
        replace(panel, row=row, column=column, title='' if row else panel.title,
                shows_y_label=not column)
        for row, views in enumerate(rows) for column, panel in enumerate(views)]
    return Chart(tuple(panels), width=11.4, height=8.0,
                 heights=(1.0,) * len(rows), columns=len(rows[0]), shares_x=True,
                 legend_columns=3)


def _views(run: RunCurves, channel: str) -> list[Panel]:
    """The misfit of a channel over load, by branch, over time and load rate, and its spectrum.

    All but the spectrum with bands of noise and of a sound ring.
    """
    shown = [(False, charts.BEFORE, 'measured minus simulated')]
    if run.is_extended:
        shown = [(False, charts.BEFORE, 'contact law alone'),
                 (True, charts.AFTER, 'extended model')]
    load, unit, rate = run.load_in_unit, run.force_unit, smooth_rate(run.load_in_unit, run.time)
    over_load, by_branch, over_time, over_rate, over_frequency = (list[Series]() for _ in range(5))
    for extended, colour, name in shown:
        values = MICRO * run.residual(channel, extended=extended)
        over_load += [
            markers(load[here], values[here], mark, colour, size=2.6, is_open=True)
            for mark, here in (('^', run.direction > 0.0), ('v', run.direction < 0.0))]
        found = branches(run.load, run.direction, values)
        at = found.load / FORCE_UNITS[unit]
        by_branch += [charts.line(at, found.mean, colour),
                      charts.line(at, found.half_difference, colour, dash=':', width=1.8)]
        over_time.append(charts.line(run.time, values, colour, name, width=0.8))
        over_rate.append(markers(rate, values, '.', colour, size=2.2))
        frequency, density = spectrum(run.time, values)
        over_frequency.append(
            charts.line(frequency, np.maximum(density, 1e-9), colour, width=1.0))
    views = [(f'load / {unit}', '▵ load rising, ▿ falling', over_load),
             (f'load / {unit}', '— mean, ··· half-difference', by_branch),
             ('time / s', 'over time', over_time),
             (f'load rate / ({unit}/s)', 'over load rate', over_rate)]
    label, bands = axis_label(channel), _bands(run, channel)
    return [
        *(Panel(0, 0, across, label, tuple(series), bands, title=title)
          for across, title, series in views if run.test != 'static' or series is not over_rate),
        Panel(0, 0, 'frequency / Hz', f'{label} / √Hz', tuple(over_frequency),
              title='spectrum, µm or µrad / √Hz', x_is_log=True, y_is_log=True)]


def look_alikes(cosines: Mapping[str, Mapping[str, float]]) -> Chart:
    """Heat map of how much the signatures of two effects look alike in these data."""
    labels, matrix = ordered_cosines(cosines)
    size = 2.6 + 0.165 * len(labels)
    places = tuple(float(place) for place in range(len(labels)))
    names = tuple(labels)
    heat = HeatMap(matrix, BLUE_TO_PURPLE, 0.0, 1.0, names, names,
                   '|cosine| between two signatures (1: cannot be told apart)')
    panel = Panel(0, 0, 'cause', 'cause', heat=heat, shows_x_label=False, shows_y_label=False,
                  x_ticks=Ticks(places, names, 7.5, is_upright=True),
                  y_ticks=Ticks(places, names, 7.5))
    return Chart((panel,), width=size + 1.0, height=size)


def ordered_cosines(cosines: Mapping[str, Mapping[str, float]]) -> tuple[list[str], Array]:
    """Labels with look-alikes side by side, and the cosines in that order (0 where left out)."""
    from scipy.cluster.hierarchy import leaves_list, linkage
    from scipy.spatial.distance import squareform

    labels = list(cosines)
    matrix = np.array([[1.0 if a == b else cosines[a].get(b, 0.0) for b in labels]
                       for a in labels])
    if len(labels) < 3:
        return labels, matrix
    distance = 1.0 - 0.5 * (matrix + matrix.T)
    order = leaves_list(linkage(squareform(distance, checks=False), 'average'))
    return [labels[place] for place in order], matrix[np.ix_(order, order)]


MAP_LEVELS = 25
"""Steps of load in a residual map."""

MAP_LIMIT = 10.0
"""Noise floors at which the colour of a residual map ends."""


def residual_map(runs: Sequence[RunCurves]) -> Chart:
    """Mean misfit in noise floors: load across, runs and branches down, channel by channel."""
    versions = [(False, 'measured minus simulated')]
    if any(run.is_extended for run in runs):
        versions = [(False, 'contact law alone'), (True, 'extended model')]
    rows = [(run, sign) for run in runs for sign in (1.0, -1.0)]
    names = tuple(f'{run.name} {"rising" if sign > 0 else "falling"}' for run, sign in rows)
    top = max(float(run.load.max()) for run in runs)
    unit = runs[0].force_unit
    decimals = force_decimals(top, unit)
    loads = tuple(force_words(level * top / MAP_LEVELS, unit, decimals)
                  for level in range(MAP_LEVELS + 1))
    marks = tuple(float(level) for level in range(0, MAP_LEVELS + 1, 5))
    x_ticks = Ticks(marks, tuple(force_words(mark * top / MAP_LEVELS, unit, decimals - 1)
                                 for mark in marks), 7.5)
    y_ticks = Ticks(tuple(float(place) for place in range(len(rows))), names, 7.5)
    panels: list[Panel] = []
    for place, channel in enumerate(SHOWN):
        is_last = place == len(SHOWN) - 1
        for column, (extended, words) in enumerate(versions):
            values = np.full((len(rows), MAP_LEVELS + 1), np.nan)
            for row, (run, sign) in enumerate(rows):
                misfit = run.residual(channel, extended=extended) / max(run.noise[channel], 1e-12)
                level = np.clip(np.round(run.load / top * MAP_LEVELS).astype(int), 0, MAP_LEVELS)
                for number in np.unique(level[np.sign(run.direction) == sign]):
                    values[row, number] = misfit[
                        (level == number) & (np.sign(run.direction) == sign)].mean()
            heat = HeatMap(
                values, BROWN_TO_PURPLE, low=-MAP_LIMIT, high=MAP_LIMIT, rows=names, columns=loads,
                label='' if panels else 'mean misfit / noise floor', background='#dde3e9')
            panels.append(Panel(
                place, column, 'load', 'run and branch', heat=heat,
                title=f'{SYMBOLS[channel]}, {words}', shows_x=is_last, shows_x_label=False,
                shows_y=column == 0, shows_y_label=False, x_ticks=x_ticks, y_ticks=y_ticks))
    return Chart(tuple(panels), width=11.4,
                 height=0.9 + len(SHOWN) * (0.45 + 0.19 * len(rows)),
                 heights=(1.0,) * len(SHOWN), columns=len(versions))


def proposed_law(term: Mapping[str, Any], force_unit: str) -> Chart:
    """What a proposed law adds to a channel over its coordinate.

    force_unit: unit in which loads are shown.
    """
    curve = term['curve']
    newtons = FORCE_UNITS[force_unit]
    size, unit = {'N': (newtons, force_unit), 'N/s': (newtons, f'{force_unit}/s'),
                  '1': (1.0, '')}.get(curve['at_unit'], (1.0, curve['at_unit']))
    at = np.array(curve['at'], float) / size
    is_load = curve['unit'] == 'N'
    scale = 1.0 / newtons if is_load else MICRO
    values, spread = (scale * np.array(curve[key], float) for key in ('values', 'std'))
    shown = force_unit if is_load else MICRO_UNITS.get(term['channel'], 'µm')
    across = term['coordinate'] + (f' / {unit}' if unit else '')
    series = (charts.line(at, values, charts.AFTER, 'proposed law'),
              charts.line(at, values - 2.0 * spread, charts.AFTER, dash=':'),
              charts.line(at, values + 2.0 * spread, charts.AFTER, dash=':'))
    panel = Panel(0, 0, across, f'{term["channel"]} / {shown}', series, levels=(0.0,))
    return Chart((panel,), width=7.0, height=3.2)
