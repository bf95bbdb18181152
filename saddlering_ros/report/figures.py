"""The curves of a run and the figures of a report as charts, every axis with its unit."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import pairwise
from pathlib import Path
from typing import Any, cast

import numpy as np
from numpy.typing import NDArray

from saddlering_ros.diagnosis import ring_wording
from saddlering_ros.diagnosis.records import smooth_rate
from saddlering_ros.diagnosis.verdict import Verdict
from saddlering_ros.identification.uncertainty import joint_outline
from saddlering_ros.memory_operators import direction_of
from saddlering_ros.pages import charts
from saddlering_ros.pages.charts import Chart, markers, Panel, Series, ShadedBand, Ticks
from saddlering_ros.record.plateaus import plateaus
from saddlering_ros.record.record import Record
from saddlering_ros.rig import CHANNELS, FORCE_UNITS, MICRO_UNITS, MOTION, Rig
from saddlering_ros.rig.units import force_decimals, force_words

Array = NDArray[np.float64]

BLOCKS = 500
"""Largest number of means by which a dynamic run is shown."""

LOAD_LEVELS = 25
"""Steps into which the load is divided in a residual map, and where both branches are compared."""

FACTS = ('bag', 'test', 'elevation_deg', 'held_out', 'time_s', 'load_N', 'direction')
"""Columns of the CSV file that are no curves."""

MICRO = 1e6
"""Metres to micrometres, radians to microradians."""

SYMBOLS = {'delta_x': 'δx', 'delta_y': 'δy', 'gamma': 'γ', 'parity': 'parity'}

BROWN_TO_PURPLE = ('#7f3b08', '#b35806', '#e08214', '#fdb863', '#fee0b6', '#f7f7f7', '#d8daeb',
                   '#b2abd2', '#8073ac', '#542788', '#2d004b')
"""Colours by Cynthia Brewer (colorbrewer2.org), which colour-blind readers can distinguish."""

MAP_LIMIT = 10.0
"""Noise floors at which the colour of a residual map ends."""


@dataclass(frozen=True)
class RunCurves:
    """One run as a report shows it.

    time [s], load [N], direction (+1 load rises, -1 it falls), width [s] of the mean that a sample
    stands for: (N,) each; measured, before, after (4, N) [m, m, rad, m] in the order of CHANNELS:
    as measured, simulated by the model without causes, and by the extended model (the same array
    where there is none); noise: rms noise of a sample by channel, in the channel's unit; sound:
    the same with small errors of a sound ring, where they are known; force_unit: unit in which
    loads are shown, that of the rig file; base: what the model without causes is called.
    """

    name: str
    test: str
    elevation_deg: float
    held_out: bool
    time: Array
    width: Array
    load: Array
    direction: Array
    measured: Array
    before: Array
    after: Array
    noise: Mapping[str, float]
    force_unit: str = 't'
    sound: Mapping[str, float] = field(default_factory=dict)
    base: str = 'contact law alone'

    @property
    def load_in_unit(self) -> Array:
        """The load (N,) in `force_unit`."""
        return np.asarray(self.load / FORCE_UNITS[self.force_unit])

    @property
    def label(self) -> str:
        """'static_50: static, 50°, held out'."""
        role = 'held out' if self.held_out else 'fitted'
        return f'{self.name} ({self.test}, {self.elevation_deg:g}°, {role})'

    @property
    def is_extended(self) -> bool:
        return self.after is not self.before

    def residual(self, channel: str, *, extended: bool) -> Array:
        """Measured minus simulated (N,)."""
        row = CHANNELS.index(channel)
        return np.asarray(self.measured[row] - (self.after if extended else self.before)[row])


def curves_of(verdict: Verdict) -> list[RunCurves]:
    """The runs of a diagnosis."""
    curves, base = [], ring_wording.base_words(verdict.raceways)
    for figures in verdict.runs:
        run, test_run = figures.record.run, figures.record.test_run
        spans = dict(zip(figures.channels, np.ptp(figures.measured, axis=1), strict=False))
        noise = {name: channel.noise_floor * float(spans[name])
                 for name, channel in figures.channels.items()}
        curves.append(RunCurves(
            name=run.name, test=test_run.test, held_out=run.held_out, time=run.time,
            elevation_deg=float(np.degrees(test_run.elevation)), width=run.width,
            load=run.inputs['load'], measured=figures.measured, before=figures.before,
            direction=np.ones(run.time.size) if run.direction is None else run.direction,
            after=figures.after if verdict.diagnosis.causes else figures.before, noise=noise,
            force_unit=verdict.rig.force_unit, base=base,
            sound={name: float(np.hypot(noise[name], channel.sound * spans[name]))
                   for name, channel in figures.channels.items() if channel.sound}))
    return curves


def curves_of_run(rig: Rig, run: Record, measured: Array, before: Array, after: Array,
                  floors: Mapping[str, float | None], *, held_out: bool) -> RunCurves:
    """A run's curves from its channels (4, samples) at the load's stamps.

    A static run is shown by the means of its plateaus, a dynamic one by those of equal blocks.
    floors: noise floor by channel as a share of the channel's measured range; 0 where missing.
    """
    if run.test == 'static':
        holds = plateaus(run)
        edges = list(zip(holds.start, holds.stop, strict=True))
    else:
        places = np.linspace(0, len(run.time), min(BLOCKS, len(run.time) // 4) + 1).astype(int)
        edges = list(pairwise(places.tolist()))

    def means(values: Array) -> Array:
        """Means (..., N) of values (..., samples); NaN samples left out."""
        total, count = (np.stack([np.nansum(items[..., start:stop], axis=-1)
                                  for start, stop in edges], axis=-1)
                        for items in (values, np.isfinite(values)))
        return np.asarray(np.where(count > 0, total / np.maximum(count, 1), np.nan))

    seen, first, load = means(measured), means(before), means(run.load)
    direction = holds.direction if run.test == 'static' else direction_of(
        load, rig.limits.reversal_band)
    last = first if after is before else means(after)
    there = np.isfinite(seen).any(axis=1)  # The parity is unknown if a probe is absent.
    good = np.isfinite(seen + first + last)[there].all(axis=0)
    widths = means(np.gradient(run.time)) * [stop - start for start, stop in edges]
    noise = {name: (floors.get(name) or 0.0) * float(np.ptp(seen[row][good]))
             for row, name in enumerate(CHANNELS)}
    shown = first[:, good]
    return RunCurves(
        name=run.path.name, test=run.test, held_out=held_out, noise=noise,
        force_unit=rig.force_unit, elevation_deg=round(float(np.degrees(run.elevation)), 2),
        width=widths[good], time=means(run.time)[good], load=load[good], direction=direction[good],
        measured=seen[:, good], before=shown, after=shown if last is first else last[:, good])


def branches(load: Array, direction: Array, values: Array) -> Array:
    """Load [N], mean and half-difference (up - down) / 2 (3, M) where both branches are known."""
    span = max(float(np.ptp(load)), 1e-12)
    level = np.round((load - load.min()) / span * LOAD_LEVELS).astype(int)
    rows = []
    for here in (level == number for number in range(LOAD_LEVELS + 1)):
        up, down = here & (direction > 0.0), here & (direction < 0.0)
        if up.any() and down.any():
            rising, falling = values[up].mean(), values[down].mean()
            rows.append((load[here].mean(), 0.5 * (rising + falling), 0.5 * (rising - falling)))
    return np.array(rows).reshape(-1, 3).T


def spectrum(time: Array, values: Array) -> tuple[Array, Array]:
    """Frequency [Hz] and amplitude density [unit/√Hz] of samples, put on an even grid first.

    By Welch's method: segments that overlap by half, each without its mean and under a Hann
    window. By hand, because scipy.signal takes a second to import. Fewer than four samples of
    the grid have none.
    """
    step = float(np.median(np.diff(time)))
    even = np.arange(time[0], time[-1] + 0.5 * step, step)
    filled = np.interp(even, time, values)
    count = min(256, filled.size // 2)
    if count < 2:
        return np.empty(0), np.empty(0)
    window = 0.5 - 0.5 * np.cos(2.0 * np.pi * np.arange(count) / count)
    segments = np.lib.stride_tricks.sliding_window_view(filled, count)[::count - count // 2]
    segments = segments - segments.mean(axis=1, keepdims=True)
    power = np.abs(np.fft.rfft(window * segments)) ** 2
    density = power.mean(axis=0) * step / (window**2).sum()
    density[1:(count + 1) // 2] *= 2.0
    return np.asarray(np.fft.rfftfreq(count, step)[1:]), np.asarray(np.sqrt(density[1:]))


def curves_path(report: Path | str) -> Path:
    """'report_curves.csv' for 'report.html'."""
    path = Path(report)
    return path.parent / f'{path.stem}_curves.csv'


def curve_columns(curves: Sequence[RunCurves]) -> dict[str, list[Any]]:
    """Every run's curves as one table, one row per sample.

    Columns: FACTS, then each channel measured, simulated by the model without causes and, if any
    run has it, by the extended model: [m], gamma [rad].
    """
    versions = {'measured': 'measured', 'simulated': 'before'}
    if any(run.is_extended for run in curves):
        versions['simulated_extended'] = 'after'
    columns: dict[str, list[Any]] = {name: [] for name in (
        *FACTS, *(f'{name}_{kind}' for kind in versions for name in CHANNELS))}
    for run in curves:
        same = (run.name, run.test, run.elevation_deg, int(run.held_out))
        values = [*([value] * run.time.size for value in same), run.time.tolist(),
                  run.load.tolist(), run.direction.astype(int).tolist(),
                  *(row for attribute in versions.values()
                    for row in getattr(run, attribute).tolist())]
        for column, more in zip(columns.values(), values, strict=True):
            column += more
    return columns


def axis_label(channel: str) -> str:
    """Label of an axis that shows a channel."""
    return f'{SYMBOLS[channel]} / {MICRO_UNITS[channel]}'


def comparison(runs: Sequence[RunCurves]) -> Chart:
    """Runs side by side, static over load, dynamic over time, each with its residual below."""
    panels = [panel for column, run in enumerate(runs) for place, channel in enumerate(MOTION)
              for panel in _compared(run, channel, 2 * place, column)]
    return Chart(
        tuple(panels), width=min(11.4, 1.0 + 5.2 * len(runs)), height=1.0 + 3.0 * len(MOTION),
        heights=(charts.MAIN, charts.STRIP) * len(MOTION), columns=len(runs), shares_x=True,
        legend_columns=3 if len(runs) == 1 else 5)


def proof(run: RunCurves, channel: str) -> Chart:
    """One channel of one run, measured and simulated, with its residual below."""
    upper, below = _compared(run, channel, 0, 0)
    return Chart((replace(upper, title=''), below), width=9.4, height=4.4,
                 heights=(charts.MAIN, charts.STRIP), shares_x=True, legend_columns=3)


def _compared(run: RunCurves, channel: str, row: int, column: int, *,
              is_over_load: bool | None = None) -> list[Panel]:
    """A channel as measured and simulated, and the residual below; the first row has a title.

    is_over_load: against load or time; None: load for a static run, time for a dynamic one.
    """
    place = CHANNELS.index(channel)
    is_static = run.test == 'static'
    over, across = (run.load_in_unit, f'load / {run.force_unit}') if (
        is_static if is_over_load is None else is_over_load) else (run.time, 'time / s')
    measured, before, after = (MICRO * curves[place] for curves in (
        run.measured, run.before, run.after))
    up = run.direction > 0.0
    branches_of = ((up, '^', charts.UP, 'rising'), (~up, 'v', charts.DOWN, 'falling'))
    seen = [
        markers(over[here], measured[here], mark, colour, f'measured, load {words}', is_open=True)
        if is_static else
        charts.line(over, np.where(here, measured, np.nan), colour, f'measured, load {words}',
                    width=4.5, opacity=0.45)
        for here, mark, colour, words in branches_of]
    alone = f'simulated, {run.base}' if run.is_extended else 'simulated'
    simulated = [charts.line(over, before, charts.BEFORE, alone, width=1.0)]
    if run.is_extended:
        simulated.append(charts.line(over, after, charts.AFTER, 'simulated, extended model', '--',
                                     width=1.0))
    role = 'held out' if run.held_out else 'fitted'
    title = '' if row else f'{run.name}: {run.elevation_deg:g}°, {role}'
    upper, below = charts.compared(
        Panel(row, column, across, axis_label(channel), tuple(seen), title=title),
        MICRO_UNITS[channel], measured, simulated, _bands(run, channel))
    points = [
        markers(over[here], (measured - one.y)[here], mark, colour, size=4.0, is_open=True)
        for one in simulated for here, mark, colour, _ in branches_of if is_static]
    return [upper, replace(below, series=(*below.series, *points))]


def _bands(run: RunCurves, channel: str) -> tuple[ShadedBand, ...]:
    """Twice the noise floor, and twice what a sound ring may do beside it, in micro-units."""
    size = 2.0 * MICRO * run.noise[channel]
    bands = (ShadedBand(-size, size, name='± 2 × noise floor'),)
    if channel not in run.sound:
        return bands
    wide = 2.0 * MICRO * run.sound[channel]
    return (ShadedBand(-wide, wide, charts.LIGHT, name='± 2 × noise and sound ring'), *bands)


def of_run(run: RunCurves) -> Chart:
    """One run: every channel over load and over time, and its residual over time."""
    panels = []
    for row, channel in enumerate(MOTION):
        title = '' if row else f'{run.name}: {run.test}, {run.elevation_deg:g}°'
        over_load, _ = _compared(run, channel, row, 0, is_over_load=True)
        over_time, residual = _compared(run, channel, row, 1, is_over_load=False)
        panels += [replace(over_load, title=title), replace(over_time, title=''),
                   replace(residual, row=row, column=2)]
    return Chart(tuple(panels), width=12.0, height=9.0,
                 heights=(1.0,) * len(MOTION), columns=3, shares_x=True)


def over_time(time: Array, channels: Mapping[str, Array], title: str) -> Chart:
    """Channels (N,) [m, rad] over time [s], a panel each."""
    panels = [Panel(row, 0, 'time / s', axis_label(name),
                    (charts.line(time, MICRO * values, charts.MEASURED, width=0.9),),
                    levels=(0.0,), title='' if row else title)
              for row, (name, values) in enumerate(channels.items())]
    return Chart(tuple(panels), width=9.4,
                 height=1.0 + 1.8 * len(panels), heights=(1.0,) * len(panels), shares_x=True)


def misfit(document: ring_wording.VerdictDocument) -> Chart:
    """Misfit of a verdict's runs before and after, beside noise and a sound ring."""
    base = ring_wording.base_words(document.get('raceways', ()))
    is_extended = bool(ring_wording.causes_of(document))
    height, heights, words, series = 0.0, [], [], []
    for run in document['runs']:
        for name in [name for name in MOTION if name in run['channels']]:
            channel = cast(ring_wording.Shares, run['channels'][name])
            before, after, floor, sound = (
                100.0 * max(channel.get(key) or 0.0, 1e-6)
                for key in ('nrmse_before', 'nrmse_after', 'noise_floor', 'sound'))
            drawn = [
                charts.line([before, after], [height, height], '#cbd2d9', width=2.0),
                markers([floor], [height], '|', charts.NOISE, 'noise floor', size=12.0),
                markers([before], [height], 'o', charts.BEFORE, base, size=6.5),
                markers([after], [height], 'D', charts.AFTER, 'extended model', size=4.5)]
            series += drawn if is_extended else drawn[1:3]
            if channel.get('sound'):
                series.append(markers([float(np.hypot(floor, sound))], [height], '|', '#7b8794',
                                      'noise and sound ring', size=12.0))
            heights.append(height)
            role = ' (held out)' if run.get('held_out') else ''
            words.append(f'{ring_wording.bag_name(run["bag"])}{role}   {SYMBOLS[name]}')
            height += 1.0
        height += 0.6
    panel = Panel(
        0, 0, "rms misfit / % of the channel's range in the run", 'run and channel',
        tuple(series), x_is_log=True, y_ticks=Ticks(tuple(heights), tuple(words)),
        y_range=(height - 0.9, -0.8), shows_y_label=False, has_y_grid=False)
    return Chart((panel,), width=8.6, legend_columns=3,
                 height=1.2 + 0.235 * len(words) + 0.12 * len(document['runs']))


def residuals(run: RunCurves) -> Chart:
    """The misfit of one run: every known channel over all that matters."""
    channels = [name for row, name in enumerate(CHANNELS) if np.isfinite(run.measured[row]).any()]
    panels = tuple(
        replace(panel, row=row, column=column, title='' if row else panel.title,
                shows_y_label=not column)
        for row, channel in enumerate(channels)
        for column, panel in enumerate(_views(run, channel)))
    return Chart(panels, width=11.4, height=8.0, heights=(1.0,) * len(channels),
                 columns=panels[-1].column + 1, shares_x=True, legend_columns=3)


def _views(run: RunCurves, channel: str) -> list[Panel]:
    """The misfit of a channel over load, by branch, over time and load rate, and its spectrum.

    All but the spectrum with bands of noise and of a sound ring.
    """
    shown = [
        (False, charts.BEFORE, run.base), (True, charts.AFTER, 'extended model'),
    ] if run.is_extended else [(False, charts.BEFORE, 'measured minus simulated')]
    load, unit, rate = run.load_in_unit, run.force_unit, smooth_rate(run.load_in_unit, run.time)
    over_load, by_branch, over_time, over_rate, over_frequency = (list[Series]() for _ in range(5))
    for extended, colour, name in shown:
        values = MICRO * run.residual(channel, extended=extended)
        over_load += [
            markers(load[here], values[here], mark, colour, size=2.6, is_open=True)
            for mark, here in (('^', run.direction > 0.0), ('v', run.direction < 0.0))]
        at, mean, half_difference = branches(run.load_in_unit, run.direction, values)
        by_branch += [charts.line(at, mean, colour),
                      charts.line(at, half_difference, colour, dash=':', width=1.8)]
        over_time.append(charts.line(run.time, values, colour, name, width=0.8))
        over_rate.append(markers(rate, values, '.', colour, size=2.2))
        frequency, density = spectrum(run.time, values)
        if frequency.size:
            over_frequency.append(charts.line(
                frequency, np.maximum(density, 1e-9), colour, width=1.0))
    views = [(f'load / {unit}', '▵ load rising, ▿ falling', over_load),
             (f'load / {unit}', '— mean, ··· half-difference', by_branch),
             ('time / s', 'over time', over_time),
             (f'load rate / ({unit}/s)', 'over load rate', over_rate)]
    label, bands = axis_label(channel), _bands(run, channel)
    panels = [Panel(0, 0, across, label, tuple(series), bands, title=title)
              for across, title, series in views
              if run.test != 'static' or series is not over_rate]
    if over_frequency:
        panels.append(Panel(
            0, 0, 'frequency / Hz', f'{label} / √Hz', tuple(over_frequency),
            title='spectrum, µm or µrad / √Hz', x_is_log=True, y_is_log=True))
    return panels


def residual_map(runs: Sequence[RunCurves]) -> Chart:
    """Mean misfit in noise floors: load across, runs and branches down, channel by channel."""
    versions = [(False, runs[0].base), (True, 'extended model')] if any(
        run.is_extended for run in runs) else [(False, 'measured minus simulated')]
    rows = [(run, sign) for run in runs for sign in (1.0, -1.0)]
    names = tuple(f'{run.name} {"rising" if sign > 0 else "falling"}' for run, sign in rows)
    top = max(float(run.load.max()) for run in runs)
    unit = runs[0].force_unit
    decimals = force_decimals(top, unit)
    loads = tuple(force_words(level * top / LOAD_LEVELS, unit, decimals)
                  for level in range(LOAD_LEVELS + 1))
    marks = tuple(float(level) for level in range(0, LOAD_LEVELS + 1, 5))
    x_ticks = Ticks(marks, tuple(force_words(mark * top / LOAD_LEVELS, unit, decimals - 1)
                                 for mark in marks), 7.5)
    y_ticks = Ticks(tuple(float(place) for place in range(len(rows))), names, 7.5)
    panels: list[Panel] = []
    for place, channel in enumerate(MOTION):
        is_last = place == len(MOTION) - 1
        for column, (extended, words) in enumerate(versions):
            values = np.full((len(rows), LOAD_LEVELS + 1), np.nan)
            for row, (run, sign) in enumerate(rows):
                misfit = run.residual(channel, extended=extended) / max(run.noise[channel], 1e-12)
                level = np.clip(np.round(run.load / top * LOAD_LEVELS).astype(int), 0, LOAD_LEVELS)
                here = np.sign(run.direction) == sign
                for number in np.unique(level[here]):
                    values[row, number] = misfit[(level == number) & here].mean()
            heat = charts.HeatMap(
                values, BROWN_TO_PURPLE, low=-MAP_LIMIT, high=MAP_LIMIT, rows=names, columns=loads,
                label='' if panels else 'mean misfit / noise floor', background='#dde3e9')
            panels.append(Panel(
                place, column, 'load', 'run and branch', heat=heat,
                title=f'{SYMBOLS[channel]}, {words}', shows_x=is_last, shows_y=column == 0,
                shows_y_label=False, x_ticks=x_ticks, y_ticks=y_ticks))
    return Chart(tuple(panels), width=11.4,
                 height=0.9 + len(MOTION) * (0.45 + 0.19 * len(rows)),
                 heights=(1.0,) * len(MOTION), columns=len(versions))


def proposed_law(term: Mapping[str, Any], force_unit: str) -> Chart:
    """What a proposed law adds to a channel over its coordinate, loads in `force_unit`."""
    curve = term['curve']
    newtons = FORCE_UNITS[force_unit]
    size, unit = {'N': (newtons, force_unit), 'N/s': (newtons, f'{force_unit}/s'),
                  '1': (1.0, '')}.get(curve['at_unit'], (1.0, curve['at_unit']))
    at = np.array(curve['at'], float) / size
    is_load, over = term['channel'] == 'hydraulic_load', curve.get('over', term['coordinate'])
    scale = 1.0 / newtons if is_load else MICRO
    values, spread = (scale * np.array(curve[key], float) for key in ('values', 'std'))
    shown = force_unit if is_load else MICRO_UNITS.get(term['channel'], 'µm')
    shown += ' per N' * (over == 'lag')
    across = over + (f' / {unit}' if unit else '')
    low, high = (values + side * spread for side in (-2.0, 2.0))
    series = (charts.line(at, values, charts.AFTER, 'proposed law'), *(
        charts.line(at, end, charts.AFTER, dash=':') for end in (low, high)))
    if over in ('reach', 'lag'):  # weights of plays or relaxations
        series = (markers(at, values, 'o', charts.AFTER, 'proposed law'),
                  charts.strokes(at, low, high, dash=':', colour=charts.AFTER))
    panel = Panel(0, 0, across, f'{term["channel"]} / {shown}', series, levels=(0.0,))
    return Chart((panel,), width=7.0, height=3.2)


def joint_regions(found: Mapping[str, Any]) -> Chart:
    """The joint 95 % region of K and n of each row, from the JSON of an identification."""
    panels = []
    for column, (key, region) in enumerate(found['joint'].items()):
        across, up = key.split(',')
        one, other = (found['parameters'][name] for name in (across, up))
        stiffness, exponent = one['value'], other['value']
        outline = joint_outline(stiffness, exponent, region)
        series = [charts.line(outline[0], outline[1], charts.AFTER, 'joint 95 % region')]
        intervals = ((one['interval'], [exponent] * 2), ([stiffness] * 2, other['interval']))
        series += [charts.line(x, y, charts.MEASURED, '95 % interval of one alone', '--')
                   for x, y in intervals if x and y]
        series.append(markers([stiffness], [exponent], 'o', charts.MEASURED, 'estimate'))
        panels.append(Panel(0, column, f'{across} / {one["unit"]}', up, tuple(series)))
    return Chart(tuple(panels), width=4.7 * len(panels), height=3.4, columns=len(panels))
