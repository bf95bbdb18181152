"""Causes that are steady lines, such as mains pickup: at rest, and in motion where they are slow.

Block means remove a line, so that it cannot be fitted with the other effects. It is searched on
stretches at rest, at the original sampling rate. The statistic at a frequency is the sum over
stretches of windowed power over the level of the neighbouring frequencies. Under noise of any
smooth spectrum the statistic is an F ratio, with a Bonferroni correction over frequencies and
channels.

A line below a few hertz is searched in the residual of the base fit. A ring can sway too, so that
it counts only if its strength is constant along every run and at rest, and if the drive has no
line there or at an integer fraction of its frequency, which makes any misfit oscillate. A run with
gaps is searched between the gaps, and static tests alone in their holds.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import median_filter

from saddlering_ros.discrepancy.problem.fits import Fit, Gain
from saddlering_ros.discrepancy.problem.metric import Metric
from saddlering_ros.discrepancy.problem.problem import Problem
from saddlering_ros.discrepancy.problem.system import Array, Effect, Estimate, RunBlocks
from saddlering_ros.discrepancy.search.evidence import Evidence
from saddlering_ros.discrepancy.search.signatures import DetectionLimit, POWER_QUANTILE
from saddlering_ros.discrepancy.verdict.results import Cause
from saddlering_ros.estimation.process import fisher_chance, fisher_limit
from saddlering_ros.estimation.rest import RestSegment

MIN_FREQUENCY = 8.0
"""Frequency [Hz] below which the residual tests apply: slower swings may belong to the machine,
and a stretch at rest has too few of their periods."""

MIN_SAMPLES = 100
"""Samples of a stretch: three times the frequencies that give the level of the noise."""

NEIGHBOURS = 15
"""Independent frequencies on each side that give the level of the noise, to a fifth."""

WINDOW_WIDTH = 2.0
"""Independent frequencies that a Hann window combines into one."""

ROUNDING = 1e-12
"""Deviation from a straight line, as a share, below which values are still: rounding."""

MAX_LINES = 3
"""Lines searched one after the other. Chosen for cost: each is a search of all runs."""

MIN_HOLDS, MIN_HOLD_SAMPLES = 8, 40
"""Holds of a static test, and samples in each, that show a constant strength."""

MIN_PERIODS = 20.0
"""Periods of the slowest line in the longest run. Fewer periods are a drift or a sway."""

MAX_SHARE = 0.8
"""Share of half their rate up to which block means show 76 % of a line or more."""

PIECES, PIECE_PERIODS = 8, 3.0
"""Pieces of a run, and periods in each: three give a strength without bias."""

MAX_UNSTEADY = 0.35
"""Allowed deviation of a strength beside noise: a line of 0.80 um on four runs passes."""

FOLDED = 0.5
"""Error [Hz] of a line that block means fold: ten times what rests of one second leave."""

HARMONICS = 5
"""Number of multiples of its frequency at which a line of the drive may show in the readings.
With more multiples, more real lines would match one by chance."""

DRIVEN_SHARE = 0.1
"""Share of a line below which the swing of the drive does not cause the line."""

NOISE_SPREAD = 3.0
"""Allowed deviation of a strength over noise: three, for a few dozen comparisons."""


@dataclass(frozen=True)
class Line:
    """A steady line: frequency [Hz], amplitude (C,) in each channel, chance under noise.

    `own` (C,): channels in which the line alone is real; `deviation` (C,): of the amplitudes;
    `delta_bic`: evidence with its phases counted; `step` [s] of the record in which it was found.
    """

    frequency: float
    amplitude: Array
    deviation: Array
    own: NDArray[np.bool_]
    p_value: float
    delta_bic: float
    step: float


def find_line(segments: Sequence[RestSegment], error_rate: float,
              between: tuple[float, float] = (MIN_FREQUENCY, np.inf),
              min_samples: int = MIN_SAMPLES) -> tuple[Line | None, float]:
    """The strongest line that is real at `error_rate`, in the runs with the fastest sampling.

    With it the amplitude that would be found. between: lowest and highest frequency [Hz] of the
    search. A channel that is still in a stretch has no level of noise, and is not searched.
    """
    usable = [segment for segment in segments if segment.values.shape[1] >= min_samples]
    if not usable:
        return None, np.inf
    fastest = min(segment.step for segment in usable)
    usable = [segment for segment in usable if segment.step < 1.05 * fastest]
    lengths = [segment.values.shape[1] for segment in usable]
    # Channels (C,) whose values (C, n) leave a straight line by more than rounding.
    moving = np.all([
        _detrended(segment.values).std(axis=1) > ROUNDING * np.abs(segment.values).max(axis=1)
        for segment in usable], axis=0)
    if not moving.any():
        return None, np.inf
    step = float(np.median([segment.step for segment in usable]))
    size = 2 * 2 ** int(np.ceil(np.log2(max(lengths))))
    frequency = np.fft.rfftfreq(size, step)
    power, ratio, freedom = _ratios(usable, size)
    ratio[~moving] = 0.0
    edge = 4.0 / (step * min(lengths))
    inside = (frequency >= between[0]) & (frequency <= min(between[1], frequency[-1] - edge))
    if not inside.any():
        return None, np.inf
    trials, count = int(moving.sum()) * int(inside.sum()), len(usable)
    # The amplitude that is found nine times in ten in the quietest moving channel. Under a Hann
    # window, an amplitude a over n samples of noise s has a^2 n / (6 s^2) times its power.
    unit = np.mean([
        segment.values.shape[1] / (6.0 * _detrended(segment.values[moving]).var(axis=1))
        for segment in usable], axis=0).max()
    beyond = max(fisher_limit(error_rate / trials, 2 * count, freedom) - 1.0, 0.0)
    beyond += POWER_QUANTILE * np.sqrt((1.0 + 2.0 * beyond) / count)
    limit = float(np.sqrt(beyond / unit))
    chance = fisher_chance(ratio, 2 * count, freedom) * trials
    chance[:, ~inside] = np.inf
    # The chance of a very strong line is 0 at several frequencies; the ratio separates them.
    shown = np.where(inside, ratio, -np.inf)
    channel, place = np.unravel_index(int(np.argmax(shown)), shown.shape)
    p_value = float(chance[channel, place])
    if p_value >= error_rate:
        return None, limit
    around = np.log(power[channel, place - 1 : place + 2])
    bend = around[0] - 2.0 * around[1] + around[2]
    shift = 0.5 * (around[0] - around[2]) / bend if bend < 0.0 else 0.0
    at = float(frequency[place] + shift / (size * step))
    amplitude, deviation, worth = _measured(usable, at)
    own = chance[:, place - 1 : place + 2].min(axis=1) < error_rate
    line = Line(at, amplitude, deviation, own, min(1.0, p_value), worth, step)
    return line, limit


def _ratios(segments: Sequence[RestSegment], size: int) -> tuple[Array, Array, float]:
    """Summed power (C, F), power over the local level (C, F), and its degrees of freedom."""
    powers, relative = [], []
    for segment in segments:
        count = segment.values.shape[1]
        power = np.abs(np.fft.rfft(_detrended(segment.values) * np.hanning(count), size)) ** 2
        width = 2 * int(np.ceil(NEIGHBOURS * WINDOW_WIDTH * size / count)) + 1
        level = median_filter(power, (1, width), mode='mirror') / np.log(2.0)
        level = np.maximum(level, 1e-300)
        powers.append(power / level.mean(axis=1, keepdims=True))
        relative.append(power / level)
    freedom = 2.0 * NEIGHBOURS * len(segments)
    return np.sum(powers, axis=0), np.mean(relative, axis=0), freedom


def _detrended(values: Array) -> Array:
    """Values (C, n) minus their straight line."""
    place = np.linspace(-1.0, 1.0, values.shape[1])
    level = values - values.mean(axis=1, keepdims=True)
    return np.asarray(level - np.outer(level @ place / (place @ place), place))


def _turns(segment: RestSegment, frequency: float) -> Array:
    """Cosine and sine (n, 2) at a frequency."""
    phase = 2.0 * np.pi * frequency * segment.step * np.arange(segment.values.shape[1])
    return np.column_stack([np.cos(phase), np.sin(phase)])


def _measured(segments: Sequence[RestSegment], frequency: float) -> tuple[Array, Array, float]:
    """Amplitudes (C,) minus their bias by noise, their deviations (C,), and the delta BIC."""
    channels = segments[0].values.shape[0]
    total, noise, worth, weight = np.zeros(channels), np.zeros(channels), 0.0, 0
    for segment in segments:
        count = segment.values.shape[1]
        values, parts, left = _fitted(segment, frequency)
        total += count * (parts**2).sum(axis=0) - 4.0 * left
        noise += count * left
        weight += count
        gain = np.log(np.maximum((values**2).mean(axis=1), 1e-300) / np.maximum(left, 1e-300))
        worth += float(count * gain.sum() - 2.0 * channels * np.log(count))
    amplitude = np.sqrt(np.maximum(total / weight, 0.0))
    return amplitude, np.sqrt(2.0 * noise) / weight, worth


def _fitted(segment: RestSegment, frequency: float) -> tuple[Array, Array, Array]:
    """Values (C, n) of a stretch, the cosine and sine (2, C) in them, and the mean square left."""
    values, swings = _detrended(segment.values), _turns(segment, frequency)
    parts = np.linalg.lstsq(swings, values.T, rcond=None)[0]
    return values, parts, ((values.T - swings @ parts) ** 2).mean(axis=0)


def line_gain(segments: Sequence[RestSegment], frequency: float, amplitude: Array) -> float:
    """1 - rms without / rms with the line, its phase free, over the channels with the line."""
    before = after = 0.0
    having = amplitude > 0.0
    for segment in segments:
        values, parts, _ = _fitted(replace(segment, values=segment.values[having]), frequency)
        size = np.maximum(np.hypot(*parts), 1e-300)
        left = values.T - _turns(segment, frequency) @ (parts * (amplitude[having] / size))
        before += float((values**2).sum())
        after += float((left**2).sum())
    return max(0.0, 1.0 - float(np.sqrt(after / max(before, 1e-300))))


@dataclass(frozen=True)
class Stretch:
    """A part [first, last) of a run with evenly spaced blocks."""

    run: int
    first: int
    last: int
    segment: RestSegment


def _in_whole_runs(runs: Sequence[RunBlocks], stretches: Sequence[Stretch],
                   error_rate: float) -> tuple[Line, list[RestSegment]] | None:
    """The strongest line of whole runs, if it is steady, and the stretches that show it."""
    usable = [stretch.segment for stretch in stretches]
    longest = max(map(_duration, usable))
    most = MAX_SHARE * 0.5 / min(segment.step for segment in usable)
    line = find_line(usable, error_rate, (MIN_PERIODS / longest, most))[0]
    if line is None or not line.own.any() or _is_driven(runs, line, error_rate):
        return None
    shown = [segment for segment in usable if segment.step * line.frequency <= 0.5 * MAX_SHARE
             and _duration(segment) * line.frequency >= PIECE_PERIODS]
    at_rest = [segment for run in runs if not run.held_out for segment in run.rest]
    if fast := find_line(at_rest, error_rate)[0]:
        turns = fast.frequency * line.step  # Block means fold a faster line into a slow one.
        if turns > 0.5 and abs(abs(turns - round(turns)) / line.step - line.frequency) < FOLDED:
            return None
    if not _is_steady(shown, line) or not _is_there_at_rest(at_rest, line):
        return None
    whole = float(np.sinc(line.frequency * line.step))
    return replace(line, amplitude=line.amplitude / whole, deviation=line.deviation / whole), shown


def _in_holds(runs: Sequence[RunBlocks],
              error_rate: float) -> tuple[Line, list[RestSegment]] | None:
    """The strongest line of the holds of static tests, if it is steady, and the holds."""
    usable = [segment for run in runs if not run.held_out for segment in run.rest
              if segment.values.shape[1] >= MIN_HOLD_SAMPLES]
    if len(usable) < MIN_HOLDS:
        return None
    least = PIECE_PERIODS / max(map(_duration, usable))
    line = find_line(usable, error_rate, (least, MIN_FREQUENCY), MIN_HOLD_SAMPLES)[0]
    if line is None or not line.own.any() or not _is_steady(usable, line):
        return None
    return line, usable


def _duration(segment: RestSegment) -> float:
    """Duration [s] of a stretch."""
    return segment.values.shape[1] * segment.step


def _stretches_of(runs: Sequence[RunBlocks], values: Sequence[Array]) -> list[Stretch]:
    """Evenly spaced parts of runs (C, N) without a missing sample, each as a stretch."""
    stretches = []
    for number, (run, own) in enumerate(zip(runs, values, strict=True)):
        steps = np.diff(run.time)
        step = float(np.median(steps))
        # The last block may be shorter.
        uneven = np.append(np.abs(steps[:-1] - step) > 0.2 * step, False)
        if run.present is not None:
            whole = np.asarray(run.present.all(axis=0))
            uneven |= ~(whole[:-1] & whole[1:])
        edges = [0, *(np.flatnonzero(uneven) + 1).tolist(), run.time.size]
        stretches += [Stretch(number, first, last, RestSegment(own[:, first:last], step))
                      for first, last in pairwise(edges) if last - first >= MIN_SAMPLES]
    return stretches


def _is_driven(runs: Sequence[RunBlocks], line: Line, error_rate: float) -> bool:
    """Whether the drive oscillates strongly at the frequency or at an integer fraction of it.

    The corners of a load course that is cut short have a spectrum too, which is not steady.
    """
    drives = [next(iter(run.inputs.values()))[None, :] for run in runs]
    usable = [stretch.segment for stretch in _stretches_of(runs, drives)]
    # The least amplitude of the drive whose linear response is a share of the line.
    ranges = np.max([np.ptp(run.channels, axis=1) for run in runs], axis=0)
    shares = line.amplitude[line.own] / np.maximum(ranges[line.own], 1e-300)
    least = DRIVEN_SHARE * max(float(np.ptp(own)) for own in drives) * float(shares.max())
    for part in range(1, HARMONICS + 1):
        wanted = line.frequency / part
        swing = find_line(usable, error_rate, (0.9 * wanted, 1.1 * wanted))[0]
        if (swing is not None and abs(swing.frequency - wanted) < 0.05 * wanted
                and float(swing.amplitude[0]) >= least and _is_steady(usable, swing)):
            return True
    return False


def _is_steady(segments: Sequence[RestSegment], line: Line) -> bool:
    """Whether a line is equally strong in every piece of every run, and continues in between.

    A line that no run shows for a few periods is not known to be steady.
    """
    if not segments:
        return False
    found, whole = [], []
    for segment in segments:
        periods = _duration(segment) * line.frequency
        pieces = max(1, min(PIECES, int(periods / PIECE_PERIODS)))
        own = [_strength(replace(segment, values=part), line)
               for part in np.array_split(segment.values, pieces, axis=1)]
        found += own
        whole.append(_strength(segment, line)[0] / max(float(np.mean(own, axis=0)[0]), 1e-300))
    strengths, spreads = np.array(found).T
    usual = float(np.median(strengths))
    off = np.abs(strengths - usual) - NOISE_SPREAD * spreads
    return bool(np.all(off <= MAX_UNSTEADY * usual) and min(whole) >= 1.0 - MAX_UNSTEADY)


def _is_there_at_rest(rest: Sequence[RestSegment], line: Line) -> bool:
    """Whether stretches at rest of sufficient length show the line with the same strength."""
    found = [_strength(segment, line) for segment in rest
             if _duration(segment) * line.frequency >= PIECE_PERIODS
             and segment.step * line.frequency <= 0.4]
    if not found:
        return True
    strength, spread = np.median(found, axis=0)
    usual = float(np.linalg.norm(line.amplitude[line.own]))
    seen = strength * np.sinc(line.frequency * line.step)
    return bool(abs(seen - usual) <= MAX_UNSTEADY * usual + NOISE_SPREAD * spread)


def _strength(segment: RestSegment, line: Line) -> tuple[float, float]:
    """Amplitude over all channels with the line, and its standard deviation."""
    _, parts, left = _fitted(segment, line.frequency)
    deviation = np.sqrt(2.0 * left / segment.values.shape[1])
    return (float(np.linalg.norm(np.hypot(*parts)[line.own])),
            float(np.linalg.norm(deviation[line.own])))


def _cleaned(runs: Sequence[RunBlocks], residuals: Sequence[Array], stretches: Sequence[Stretch],
             line: Line) -> tuple[tuple[RunBlocks, ...], list[Array]]:
    """Runs and residuals minus the line, with a phase of its own in every channel and stretch."""
    channels = [run.channels.copy() for run in runs]
    left = [residual.copy() for residual in residuals]
    for stretch in stretches:
        part = slice(stretch.first, stretch.last)
        swing = _line_in(stretch.segment, line)
        # The residual is prediction minus measurement.
        channels[stretch.run][:, part] += swing
        left[stretch.run][:, part] -= swing
    return tuple(
        replace(run, channels=own, rest=tuple(
            replace(segment, values=segment.values - _line_in(segment, line))
            for segment in run.rest))
        for run, own in zip(runs, channels, strict=True)), left


def _line_in(segment: RestSegment, line: Line) -> Array:
    """The line in a stretch (C, n): the best cosine and sine; 0 in channels without the line."""
    swings = _turns(segment, line.frequency)
    place = np.linspace(-1.0, 1.0, segment.values.shape[1])
    shapes = np.column_stack([swings, np.ones_like(place), place])
    parts = np.linalg.lstsq(shapes, segment.values.T, rcond=None)[0][:2]
    return np.asarray((swings @ (parts * line.own)).T)


def find_steady_lines(problem: Problem,
                      trials: int) -> tuple[list[Cause], list[Evidence], list[DetectionLimit]]:
    """Lines in the stretches at rest of the fitted runs, for every effect that is a line.

    Lines that are causes, lines that are too small, and detection limits.
    """
    rest = [segment for run in problem.runs for segment in run.rest]
    held_out = [segment for run in problem.held_out for segment in run.rest]
    settings = problem.settings
    widest = max(float(np.abs(weights).max()) / problem.view_ranges[view]
                 for view, weights in problem.system.views.items())
    # Amplitude of a line with the smallest material rms in some view.
    material = float(settings.materiality * np.sqrt(2.0) / widest)
    causes, immaterial, limits = [], [], []
    for effect in problem.system.effects:
        if not effect.line:
            continue
        line, limit = find_line(rest, settings.error_rate / trials)
        seen = bool(np.isfinite(limit))
        limits.append(DetectionLimit(
            effect.id, float(seen), limit, limit, material, effect.size.unit, seen))
        if line is None:
            continue
        left = line_gain(held_out, line.frequency, line.amplitude * line.own) if held_out else None
        cause = _cause(problem, effect, line, rest, left, 'at rest, its phase free')
        if cause.visible >= settings.materiality:
            causes.append(cause)
        else:
            values = {key: number.value for key, number in cause.parameters.items()}
            immaterial.append(Evidence(
                step=0, effects=(cause.effect,), variants=(cause.variant,), misfit=0.0,
                delta_bic=cause.delta_bic, p_value=cause.p_value, visible=cause.visible,
                values={cause.effect: values}))
    return causes, immaterial, limits


def find_slow_lines(metric: Metric, base: Fit,
                    trials: int) -> tuple[list[Cause], tuple[RunBlocks, ...]]:
    """The material slow lines in the residual of the base fit, the strongest first.

    With them come all runs without slow lines.
    """
    problem = metric.problem
    kept, rate = tuple(problem.all_runs), problem.settings.error_rate / trials
    effect = next((effect for effect in problem.system.effects if effect.line), None)
    if effect is None:
        return [], kept
    left = metric.without_nuisances(base.prediction - problem.measured)
    fitted = dict(zip([run.name for run in problem.runs], problem.by_run(left), strict=True))
    residuals = [
        fitted[run.name] if run.name in fitted
        else problem.simulate(run, [base.point])[0] - run.channels for run in kept]
    causes: list[Cause] = []
    while len(causes) < MAX_LINES:
        stretches = _stretches_of(kept, residuals)
        # If no run is evenly spaced, the holds of static tests may be.
        found = _in_whole_runs(kept, stretches, rate) if stretches else _in_holds(kept, rate)
        if found is None:
            break
        line, shown = found
        causes.append(
            _cause(problem, effect, line, shown, None, 'in the residual, its phase free'))
        kept, residuals = _cleaned(kept, residuals, stretches, line)
    return [cause for cause in causes if cause.visible >= problem.settings.materiality], kept


def _cause(problem: Problem, effect: Effect, line: Line, segments: Sequence[RestSegment],
           held_out: float | None, how: str) -> Cause:
    """The line as a cause, in the variant whose channels are closest to those with the line.

    segments: where its gain is measured; held_out: its gain on held-out runs.
    """
    hit = {int(channel) for channel in np.flatnonzero(line.own)}
    variant = min(range(len(effect.line)), key=lambda number: len({*effect.line[number]} ^ hit))
    own = line.amplitude * line.own
    largest = max(float(np.abs(weights) @ own) / problem.view_ranges[view]
                  for view, weights in problem.system.views.items())
    channels = list(effect.line[variant])
    amplitude = float(line.amplitude[channels].mean())
    deviation = float(np.linalg.norm(line.deviation[channels])) / len(channels)
    # Linear interpolation to common instants reduces a swing by up to this share.
    lost = (2.0 * np.pi * line.frequency * line.step) ** 2 / 8.0
    deviation = float(np.hypot(deviation, lost * amplitude))
    cosine, sine, frequency = effect.ordered
    parameters = {
        cosine.name: Estimate(amplitude, deviation, cosine.unit),
        sine.name: Estimate(0.0, deviation, sine.unit),
        frequency.name: Estimate(line.frequency, 0.0, frequency.unit),
        **{key: Estimate(float(value), 0.0, '')
           for key, value in effect.variants[variant].items()}}
    return Cause(
        effect=effect.id, definition=effect, variant=variant, group=(effect.id,),
        parameters=parameters, p_value=line.p_value, delta_bic=line.delta_bic,
        visible=float(largest / np.sqrt(2.0)),
        gain=Gain(line_gain(segments, line.frequency, own), held_out, how))
