"""The figures of a report; each function draws one and returns it, every axis with its unit."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from functools import wraps
from typing import Any, ParamSpec

from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch
from matplotlib.ticker import FuncFormatter
import numpy as np

from saddlering_ros.report.curves import Array, branches, RunCurves, spectrum
from saddlering_ros.report.style import (
    AFTER,
    axis_label,
    BEFORE,
    DOWN,
    drawing,
    MEASURED,
    MICRO,
    MICRO_UNITS,
    NOISE,
    SYMBOLS,
    UP,
)
from saddlering_ros.rig import CHANNELS, TONNE

SHOWN = CHANNELS[:3]
"""Channels of the comparison; the published tests show delta_x and gamma only."""

Options = ParamSpec('Options')


def _styled(draw: Callable[Options, Figure]) -> Callable[Options, Figure]:
    @wraps(draw)
    def drawn(*args: Options.args, **kwargs: Options.kwargs) -> Figure:
        with drawing():
            return draw(*args, **kwargs)
    return drawn


@_styled
def comparison(runs: Sequence[RunCurves], channels: Sequence[str] = SHOWN) -> Figure:
    """Measured and simulated channels of some runs side by side, each with its residual below.

    A static run is drawn over its load, a dynamic one over time.
    """
    heights = [3.0, 1.25] * len(channels)
    figure = Figure(figsize=(min(11.4, 1.0 + 5.2 * len(runs)), 1.0 + 3.0 * len(channels)),
                    layout='constrained')
    grid = figure.subplots(2 * len(channels), len(runs), squeeze=False,
                           gridspec_kw={'height_ratios': heights}, sharex='col')
    for column, run in enumerate(runs):
        for row, channel in enumerate(channels):
            main, strip = grid[2 * row][column], grid[2 * row + 1][column]
            _compare(main, strip, run, channel)
        role = 'verification' if run.held_out else 'identification'
        grid[0][column].set_title(f'{run.name}: {run.elevation_deg:g}°, {role}')
        grid[-1][column].set_xlabel('load / t' if run.test == 'static' else 'time / s')
    handles, labels = grid[0][0].get_legend_handles_labels()
    figure.legend(handles, labels, loc='outside lower center', ncols=5)
    return figure


@_styled
def proof(run: RunCurves, channel: str) -> Figure:
    """One channel of one run, measured and simulated, with its residual below."""
    figure = Figure(figsize=(9.4, 4.4), layout='constrained')
    main, strip = figure.subplots(2, 1, gridspec_kw={'height_ratios': [3.0, 1.25]}, sharex=True)
    _compare(main, strip, run, channel)
    strip.set_xlabel('load / t' if run.test == 'static' else 'time / s')
    handles, labels = main.get_legend_handles_labels()
    figure.legend(handles, labels, loc='outside lower center', ncols=5)
    return figure


def _compare(main: Any, strip: Any, run: RunCurves, channel: str) -> None:
    row = CHANNELS.index(channel)
    over = run.load / TONNE if run.test == 'static' else run.time
    measured, before, after = (MICRO * item[row] for item in (run.measured, run.before, run.after))
    if run.test == 'static':
        up = run.direction > 0.0
        main.plot(over[up], measured[up], '^', ms=4.5, mfc='none', color=UP,
                  label='measured, load rising')
        main.plot(over[~up], measured[~up], 'v', ms=4.5, mfc='none', color=DOWN,
                  label='measured, load falling')
    else:
        main.plot(over, measured, color=MEASURED, lw=2.4, alpha=0.55, label='measured')
    alone = 'simulated, contact law alone' if run.is_extended else 'simulated'
    simulations = [(before, BEFORE, '-', alone)]
    if run.is_extended:
        simulations.append((after, AFTER, '--', 'simulated, extended model'))
    for values, colour, line, label in simulations:
        main.plot(over, values, line, color=colour, label=label)
        strip.plot(over, measured - values, color=colour, lw=0.9)
    band = 2.0 * MICRO * run.noise[channel]
    strip.axhspan(-band, band, color=NOISE, alpha=0.3, lw=0.0)
    strip.axhline(0.0, color=NOISE, lw=0.8)
    main.set_ylabel(axis_label(channel))
    strip.set_ylabel(f'misfit\n{MICRO_UNITS[channel]}')


@_styled
def misfit(runs: Sequence[Mapping[str, Any]], channels: Sequence[str] = CHANNELS[:3]) -> Figure:
    """Misfit before and after against the noise floor, for the `runs` of a verdict's JSON."""
    rows = [(run, name) for run in runs for name in channels if name in run['channels']]
    figure = Figure(figsize=(8.6, 0.9 + 0.235 * len(rows) + 0.12 * len(runs)),
                    layout='constrained')
    axes = figure.subplots()
    height, heights, ticks, previous = 0.0, [], [], None
    for run, name in rows:
        if previous is not None and run is not previous:
            height += 0.6
            axes.axhline(height - 0.8, color='#e4e8ec', lw=0.8)
        previous = run
        _misfit_row(axes, height, run['channels'][name])
        heights.append(height)
        ticks.append(f'{_short(run)}   {SYMBOLS[name]}')
        height += 1.0
    axes.set(yticks=heights, yticklabels=ticks, xscale='log', ylim=(height - 0.3, -0.8),
             xlabel="rms misfit / % of the channel's range in the run")
    axes.xaxis.set_major_formatter(FuncFormatter(lambda value, _: f'{value:g}'))
    axes.grid(axis='y', visible=False)
    _legend_once(figure, axes)
    return figure


def _misfit_row(axes: Any, height: float, item: Mapping[str, float]) -> None:
    before, after, floor = (100.0 * max(item[key] or 0.0, 1e-6) for key in
                            ('nrmse_before', 'nrmse_after', 'noise_floor'))
    axes.plot([before, after], [height, height], color='#cbd2d9', lw=2.0, zorder=1)
    axes.plot(floor, height, '|', ms=12, mew=2.0, color=NOISE, label='noise floor', zorder=2)
    axes.plot(before, height, 'o', ms=6.5, color=BEFORE, label='contact law alone', zorder=3)
    axes.plot(after, height, 'D', ms=4.5, color=AFTER, label='extended model', zorder=4)


def _short(run: Mapping[str, Any]) -> str:
    name = str(run['bag']).rstrip('/').rsplit('/', 1)[-1]
    return f'{name}{" (held out)" if run.get("held_out") else ""}'


def _legend_once(figure: Figure, axes: Any) -> None:
    handles, labels = axes.get_legend_handles_labels()
    unique = dict(zip(labels, handles, strict=True))
    figure.legend(unique.values(), unique.keys(), loc='outside upper center', ncols=3)


@_styled
def residuals(run: RunCurves) -> Figure:
    """Where measurement and simulation part in one run: four channels over all that matters."""
    views = [_over_load, _both_branches, _over_time, _over_frequency]
    if run.test != 'static':
        views.insert(3, _over_rate)
    figure = Figure(figsize=(11.4, 8.0))
    grid = figure.subplots(len(CHANNELS), len(views), sharex='col')
    figure.subplots_adjust(left=0.062, right=0.995, bottom=0.095, top=0.945, wspace=0.27,
                           hspace=0.12)
    for row, channel in enumerate(CHANNELS):
        for column, view in enumerate(views):
            axes = grid[row][column]
            title, label = view(axes, run, channel)
            if row == 0:
                axes.set_title(title, fontsize=9.0)
            if row == len(CHANNELS) - 1:
                axes.set_xlabel(label)
            axes.tick_params(labelsize=7.5)
        grid[row][0].set_ylabel(axis_label(channel))
    figure.align_ylabels(grid[:, 0])
    handles: list[Any] = [Line2D([], [], color=colour, label=label)
                          for _, colour, label in _versions(run)]
    handles.append(Patch(color=NOISE, alpha=0.3, lw=0.0, label='± 2 × noise floor'))
    figure.legend(handles=handles, loc='lower center', ncols=3)
    return figure


def _versions(run: RunCurves) -> list[tuple[bool, str, str]]:
    if not run.is_extended:
        return [(False, BEFORE, 'measured less simulated')]
    return [(False, BEFORE, 'contact law alone'), (True, AFTER, 'extended model')]


def _misfits(run: RunCurves, channel: str) -> list[tuple[Array, str]]:
    return [(MICRO * run.residual(channel, extended=extended), colour)
            for extended, colour, _ in _versions(run)]


def _band(axes: Any, run: RunCurves, channel: str) -> None:
    size = 2.0 * MICRO * run.noise[channel]
    axes.axhspan(-size, size, color=NOISE, alpha=0.3, lw=0.0)


def _over_load(axes: Any, run: RunCurves, channel: str) -> tuple[str, str]:
    for values, colour in _misfits(run, channel):
        for sign, mark in ((1.0, '^'), (-1.0, 'v')):
            here = np.sign(run.direction) == sign
            axes.plot(run.load[here] / TONNE, values[here], mark, ms=2.6, mew=0.6, mfc='none',
                      color=colour)
    _band(axes, run, channel)
    return '▵ load rising, ▿ falling', 'load / t'


def _both_branches(axes: Any, run: RunCurves, channel: str) -> tuple[str, str]:
    for values, colour in _misfits(run, channel):
        found = branches(run.load, run.direction, values)
        axes.plot(found.load / TONNE, found.mean, '-', color=colour)
        axes.plot(found.load / TONNE, found.half_difference, ':', lw=1.8, color=colour)
    _band(axes, run, channel)
    return '— mean, ··· half-difference', 'load / t'


def _over_time(axes: Any, run: RunCurves, channel: str) -> tuple[str, str]:
    for values, colour in _misfits(run, channel):
        axes.plot(run.time, values, '-', lw=0.8, color=colour)
    _band(axes, run, channel)
    return 'over time', 'time / s'


def _over_rate(axes: Any, run: RunCurves, channel: str) -> tuple[str, str]:
    rate = np.gradient(run.load, run.time)
    size = max(1, round(0.1 / float(np.median(np.diff(run.time)))))
    rate = np.convolve(rate, np.ones(size) / size, mode='same') / TONNE
    for values, colour in _misfits(run, channel):
        axes.plot(rate, values, '.', ms=2.2, color=colour)
    _band(axes, run, channel)
    return 'over load rate', 'load rate / (t/s)'


def _over_frequency(axes: Any, run: RunCurves, channel: str) -> tuple[str, str]:
    for values, colour in _misfits(run, channel):
        frequency, density = spectrum(run.time, values)
        axes.loglog(frequency, np.maximum(density, 1e-9), color=colour, lw=1.0)
    axes.minorticks_off()
    return 'spectrum, µm or µrad / √Hz', 'frequency / Hz'


@_styled
def look_alikes(cosines: Mapping[str, Mapping[str, float]]) -> Figure:
    """Heat map of how much the signatures of two effects look alike in these data."""
    labels, matrix = ordered_cosines(cosines)
    size = 2.6 + 0.165 * len(labels)
    figure = Figure(figsize=(size + 1.0, size), layout='constrained')
    axes = figure.subplots()
    shown = axes.imshow(matrix, cmap='BuPu', vmin=0.0, vmax=1.0)
    places = range(len(labels))
    axes.set_xticks(places, labels, rotation=90, fontsize=7.5)
    axes.set_yticks(places, labels, fontsize=7.5)
    axes.grid(visible=False)
    axes.tick_params(length=0)
    bar = figure.colorbar(shown, ax=axes, shrink=0.6, pad=0.02)
    bar.set_label('|cosine| between two signatures (1: cannot be told apart)')
    return figure


def ordered_cosines(cosines: Mapping[str, Mapping[str, float]]) -> tuple[list[str], Array]:
    """Labels with look-alikes side by side, and the cosines in that order (0 where left out)."""
    from scipy.cluster.hierarchy import leaves_list, linkage
    from scipy.spatial.distance import squareform

    labels = list(cosines)
    matrix = np.array([
        [1.0 if a == b else cosines[a].get(b, 0.0) for b in labels] for a in labels
    ])
    if len(labels) < 3:
        return labels, matrix
    distance = 1.0 - 0.5 * (matrix + matrix.T)
    order = leaves_list(linkage(squareform(distance, checks=False), 'average'))
    return [labels[place] for place in order], matrix[np.ix_(order, order)]


MAP_LEVELS = 25
"""Steps of load in a residual map."""

MAP_LIMIT = 10.0
"""Noise floors at which the colour of a residual map ends."""


@_styled
def residual_map(runs: Sequence[RunCurves], channels: Sequence[str] = CHANNELS[:3]) -> Figure:
    """Mean misfit in noise floors: load across, runs and branches down, channel by channel."""
    versions = [(False, 'measured less simulated')]
    if any(run.is_extended for run in runs):
        versions = [(False, 'contact law alone'), (True, 'extended model')]
    rows = [(run, sign) for run in runs for sign in (1.0, -1.0)]
    figure = Figure(figsize=(11.4, 0.9 + len(channels) * (0.45 + 0.19 * len(rows))),
                    layout='constrained')
    grid = figure.subplots(len(channels), len(versions), squeeze=False)
    shown: Any = None
    top = max(float(run.load.max()) for run in runs)
    for place, channel in enumerate(channels):
        for column, (extended, words) in enumerate(versions):
            axes = grid[place][column]
            values = np.array([_map_row(*row, channel, extended, top) for row in rows])
            shown = axes.imshow(values, cmap='PuOr', vmin=-MAP_LIMIT, vmax=MAP_LIMIT,
                                aspect='auto')
            axes.set_facecolor('#dde3e9')
            ticks = range(0, MAP_LEVELS + 1, 5)
            labels = [f'{tick * top / TONNE / MAP_LEVELS:.0f} t' for tick in ticks]
            axes.set_xticks(list(ticks), labels, fontsize=7.5)
            names = [f'{run.name} {"rising" if sign > 0 else "falling"}' for run, sign in rows]
            axes.set_yticks(range(len(rows)), names, fontsize=7.5)
            axes.tick_params(labelleft=column == 0)
            axes.grid(visible=False)
            axes.set_title(f'{SYMBOLS[channel]}, {words}')
            axes.set_xlabel('load / t' if place == len(channels) - 1 else '')
    bar = figure.colorbar(shown, ax=grid, shrink=0.8, pad=0.02, extend='both')
    bar.set_label('mean misfit / noise floor')
    return figure


def _map_row(run: RunCurves, sign: float, channel: str, extended: bool, top: float) -> Array:
    """Mean misfit over noise at each load level of one branch; NaN where nothing was measured."""
    here = np.sign(run.direction) == sign
    level = np.clip(np.round(run.load / top * MAP_LEVELS).astype(int), 0, MAP_LEVELS)
    values = run.residual(channel, extended=extended) / max(run.noise[channel], 1e-12)
    found = np.full(MAP_LEVELS + 1, np.nan)
    for number in range(MAP_LEVELS + 1):
        cell = here & (level == number)
        if cell.any():
            found[number] = values[cell].mean()
    return found
