"""Causes that are steady lines, at rest and too slow for stretches at rest.

A line below a few hertz has few periods in a stretch at rest. Its strength while the load moves is
the same, so that it is searched in the residual of the base fit. A ring can sway at such
frequencies too, and an oscillating load makes any misfit oscillate. A line therefore counts only
if its strength is constant along every run and at rest, and if the drive has no line there or at
an integer fraction of its frequency. A run with gaps is searched between the gaps. If only static
tests exist, the search uses their holds.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np

from saddlering_ros.discrepancy.problem.fits import Fit, Gain
from saddlering_ros.discrepancy.problem.problem import Metric, Problem
from saddlering_ros.discrepancy.problem.system import Array, Effect, RunBlocks
from saddlering_ros.discrepancy.search.evidence import Evidence
from saddlering_ros.discrepancy.search.limits import DetectionLimit
from saddlering_ros.discrepancy.verdict.lines import (
    amplitudes,
    find_line,
    Line,
    line_gain,
    MIN_FREQUENCY,
    MIN_SAMPLES,
    turns,
)
from saddlering_ros.discrepancy.verdict.results import Cause, Estimate
from saddlering_ros.estimation.rest import RestSegment

MAX_LINES = 3
"""Largest number of lines, searched one after the other. Chosen for cost: each is a search of all
runs."""

MIN_HOLDS, MIN_HOLD_SAMPLES = 8, 40
"""Number of holds of a static test, and of samples in each, that show a line: fewer holds do not
show that its strength is constant."""

MIN_PERIODS = 20.0
"""Periods of the slowest line in the longest run. Fewer periods are a drift or a sway."""

MAX_SHARE = 0.8
"""Share of half their rate up to which block means show lines: there the mean of a block has 76 %
of the amplitude."""

PIECES, PIECE_PERIODS = 8, 3.0
"""Pieces of a run, and periods in each, that show the strength of a line over time. Three periods
give a strength without the bias of a part of a period."""

MAX_UNSTEADY = 0.35
"""Deviation of the strength in a piece from its mean that is allowed beside noise. A line of 0.80
um at 3.7 Hz on all probes of four runs passes."""

HARMONICS = 5
"""Number of multiples of its frequency at which a line of the drive may show in the readings.
With more multiples, more real lines would match one by chance."""

DRIVEN_SHARE = 0.1
"""Share of a line below which the swing of the drive does not cause the line."""

NOISE_SPREAD = 3.0
"""Allowed deviation of a strength in standard deviations of noise: three, as usual for a few
dozen comparisons."""


@dataclass(frozen=True)
class SlowLine:
    """A steady line (its plain amplitude in the channels), and where it was found."""

    line: Line
    segments: tuple[RestSegment, ...]


@dataclass(frozen=True)
class Stretch:
    """A part [first, last) of a run with evenly spaced blocks."""

    run: int
    first: int
    last: int
    segment: RestSegment


def find_slow_lines(
    runs: Sequence[RunBlocks], residuals: Sequence[Array], error_rate: float,
) -> tuple[list[SlowLine], tuple[RunBlocks, ...]]:
    """Steady lines in the residuals (C, N) of runs, the strongest first; the runs without them."""
    lines: list[SlowLine] = []
    left, kept = list(residuals), tuple(runs)
    while len(lines) < MAX_LINES:
        stretches = stretches_of(kept, left)
        line = (_in_whole_runs(kept, stretches, error_rate) if stretches
                else _at_rest(kept, error_rate))
        if line is None:
            break
        lines.append(line)
        kept, left = _cleaned(kept, left, stretches, line)
    return lines, kept


def _in_whole_runs(
    runs: Sequence[RunBlocks], stretches: Sequence[Stretch], error_rate: float,
) -> SlowLine | None:
    """The strongest line of whole runs, if it is steady."""
    usable = [stretch.segment for stretch in stretches]
    longest = max(segment.values.shape[1] * segment.step for segment in usable)
    most = MAX_SHARE * 0.5 / min(segment.step for segment in usable)
    line = find_line(usable, error_rate, (MIN_PERIODS / longest, most)).line
    if line is None or not line.own.any() or _is_driven(runs, line, error_rate):
        return None
    shown = [segment for segment in usable if segment.step * line.frequency <= 0.5 * MAX_SHARE
             and segment.values.shape[1] * segment.step * line.frequency >= PIECE_PERIODS]
    at_rest = [segment for run in runs if not run.held_out for segment in run.rest]
    if not _is_steady(shown, line) or not _is_there_at_rest(at_rest, line):
        return None
    whole = float(np.sinc(line.frequency * line.step))
    seen = replace(line, amplitude=line.amplitude / whole, deviation=line.deviation / whole)
    return SlowLine(seen, tuple(shown))


def _at_rest(runs: Sequence[RunBlocks], error_rate: float) -> SlowLine | None:
    """The strongest line of the holds of static tests, if no run is evenly spaced."""
    usable = [segment for run in runs if not run.held_out for segment in run.rest
              if segment.values.shape[1] >= MIN_HOLD_SAMPLES]
    if len(usable) < MIN_HOLDS:
        return None
    longest = max(segment.values.shape[1] * segment.step for segment in usable)
    least = PIECE_PERIODS / longest
    line = find_line(usable, error_rate, (least, MIN_FREQUENCY), MIN_HOLD_SAMPLES).line
    if line is None or not line.own.any() or not _is_steady(usable, line):
        return None
    return SlowLine(line, tuple(usable))


def stretches_of(runs: Sequence[RunBlocks], values: Sequence[Array]) -> list[Stretch]:
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
        stretches += [
            Stretch(number, first, last, RestSegment(own[:, first:last], step))
            for first, last in pairwise(edges)
            if last - first >= MIN_SAMPLES
        ]
    return stretches


def _is_driven(runs: Sequence[RunBlocks], line: Line, error_rate: float) -> bool:
    """Whether the drive oscillates strongly at the frequency or at an integer fraction of it.

    The corners of a load course that is cut short have a spectrum too, which is not steady.
    """
    drives = [next(iter(run.inputs.values()))[None, :] for run in runs]
    usable = [stretch.segment for stretch in stretches_of(runs, drives)]
    # The least amplitude of the drive whose linear response is a share of the line.
    ranges = np.max([np.ptp(run.channels, axis=1) for run in runs], axis=0)
    shares = line.amplitude[line.own] / np.maximum(ranges[line.own], 1e-300)
    least = DRIVEN_SHARE * max(float(np.ptp(own)) for own in drives) * float(shares.max())
    for part in range(1, HARMONICS + 1):
        wanted = line.frequency / part
        swing = find_line(usable, error_rate, (0.9 * wanted, 1.1 * wanted)).line
        if swing is None or abs(swing.frequency - wanted) >= 0.05 * wanted:
            continue
        if float(swing.amplitude[0]) >= least and _is_steady(usable, swing):
            return True
    return False


def _is_steady(segments: Sequence[RestSegment], line: Line) -> bool:
    """Whether a line is equally strong in every piece of every run, and continues in between.

    A line that no run shows for a few periods is not known to be steady.
    """
    if not segments:
        return False
    strengths, spreads, whole = [], [], []
    for segment in segments:
        periods = segment.values.shape[1] * segment.step * line.frequency
        pieces = max(1, min(PIECES, int(periods / PIECE_PERIODS)))
        own = []
        for part in np.array_split(np.arange(segment.values.shape[1]), pieces):
            strength, spread = _strength(replace(segment, values=segment.values[:, part]), line)
            own.append(strength)
            strengths.append(strength)
            spreads.append(spread)
        together, _ = _strength(segment, line)
        whole.append(together / max(float(np.mean(own)), 1e-300))
    usual = float(np.median(strengths))
    off = np.abs(np.array(strengths) - usual) - NOISE_SPREAD * np.array(spreads)
    return bool(np.all(off <= MAX_UNSTEADY * usual) and min(whole) >= 1.0 - MAX_UNSTEADY)


def _is_there_at_rest(rest: Sequence[RestSegment], line: Line) -> bool:
    """Whether stretches at rest of sufficient length show the line with the same strength."""
    usual = float(np.linalg.norm(line.amplitude[line.own]))
    whole = float(np.sinc(line.frequency * line.step))
    strengths, spreads = [], []
    for segment in rest:
        periods = segment.values.shape[1] * segment.step * line.frequency
        if periods < PIECE_PERIODS or segment.step * line.frequency > 0.4:
            continue
        strength, spread = _strength(segment, line)
        strengths.append(strength * whole)
        spreads.append(spread)
    if not strengths:
        return True
    spread = NOISE_SPREAD * float(np.median(spreads))
    return abs(float(np.median(strengths)) - usual) <= MAX_UNSTEADY * usual + spread


def _strength(segment: RestSegment, line: Line) -> tuple[float, float]:
    """Amplitude over all channels with the line, and its standard deviation."""
    size, deviation = amplitudes(segment, line.frequency)
    own = line.own
    return float(np.linalg.norm(size[own])), float(np.linalg.norm(deviation[own]))


def _cleaned(
    runs: Sequence[RunBlocks], residuals: Sequence[Array], stretches: Sequence[Stretch],
    slow_line: SlowLine,
) -> tuple[tuple[RunBlocks, ...], list[Array]]:
    """Runs and residuals minus the line, with a phase of its own in every channel and stretch."""
    channels = [run.channels.copy() for run in runs]
    left = [residual.copy() for residual in residuals]
    for stretch in stretches:
        part = slice(stretch.first, stretch.last)
        swing = _line_in(stretch.segment, slow_line.line)
        channels[stretch.run][:, part] += swing  # The residual is prediction minus measurement.
        left[stretch.run][:, part] -= swing
    cleaned = []
    for run, own in zip(runs, channels, strict=True):
        rest = tuple(replace(segment, values=segment.values - _line_in(segment, slow_line.line))
                     for segment in run.rest)
        cleaned.append(replace(run, channels=own, rest=rest))
    return tuple(cleaned), left


def _line_in(segment: RestSegment, line: Line) -> Array:
    """The line in a stretch (C, n): the best cosine and sine; 0 in channels without the line."""
    swings = turns(segment, line.frequency)
    place = np.linspace(-1.0, 1.0, segment.values.shape[1])
    shapes = np.column_stack([swings, np.ones_like(place), place])
    parts = np.linalg.lstsq(shapes, segment.values.T, rcond=None)[0][:2]
    return np.asarray((swings @ (parts * line.own)).T)


@dataclass(frozen=True)
class SteadyLines:
    """Lines that are causes, lines that are too small, and the detection limit."""

    causes: tuple[Cause, ...]
    immaterial: tuple[Evidence, ...]
    limits: tuple[DetectionLimit, ...]


def find_steady_lines(problem: Problem, trials: int) -> SteadyLines:
    """Lines in the stretches at rest of the fitted runs, for every effect that is a line."""
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
        search = find_line(rest, settings.error_rate / trials)
        seen = bool(np.isfinite(search.limit))
        limits.append(DetectionLimit(
            effect.id, float(seen), search.limit, search.limit, material, effect.size.unit, seen))
        if search.line is None:
            continue
        cause = _cause(problem, effect, search.line, rest, held_out)
        if cause.visible >= settings.materiality:
            causes.append(cause)
        else:
            immaterial.append(_evidence(cause))
    return SteadyLines(tuple(causes), tuple(immaterial), tuple(limits))


@dataclass(frozen=True)
class Swings:
    """Slow steady lines that are causes, and all runs without them."""

    causes: tuple[Cause, ...]
    runs: tuple[RunBlocks, ...]


def find_swings(metric: Metric, base: Fit, trials: int) -> Swings | None:
    """The material slow lines in the residual of the base fit, in motion or not."""
    problem = metric.problem
    runs, settings = problem.all_runs, problem.settings
    effect = next((effect for effect in problem.system.effects if effect.line), None)
    if effect is None:
        return None
    left = metric.without_nuisances(base.prediction - problem.measured)
    fitted = dict(zip([run.name for run in problem.runs], problem.by_run(left), strict=True))
    residuals = [
        fitted[run.name] if run.name in fitted
        else problem.system.predict_many(run, [base.point])[0] - run.channels for run in runs]
    slow_lines, cleaned = find_slow_lines(runs, residuals, settings.error_rate / trials)
    causes = [_cause(problem, effect, own.line, own.segments, ()) for own in slow_lines]
    causes = [replace(cause, gain=replace(cause.gain, how='in the residual, its phase free'))
              for cause in causes]
    material = tuple(cause for cause in causes if cause.visible >= settings.materiality)
    return Swings(material, cleaned) if material else None


def _cause(
    problem: Problem, effect: Effect, line: Line, rest: Sequence[RestSegment],
    held_out: Sequence[RestSegment],
) -> Cause:
    """The line as a cause, in the variant whose channels are closest to those with the line."""
    hit = {int(channel) for channel in np.flatnonzero(line.own)}
    variant = min(range(len(effect.line)),
                  key=lambda number: len({*effect.line[number]} ^ hit))
    own = line.amplitude * line.own
    largest = max(float(np.abs(weights) @ own) / problem.view_ranges[view]
                  for view, weights in problem.system.views.items())
    left = line_gain(held_out, line.frequency, own) if held_out else None
    gain = Gain(line_gain(rest, line.frequency, own), left, 'at rest, its phase free')
    return Cause(
        effect=effect.id, definition=effect, variant=variant, group=(effect.id,),
        parameters=_parameters(effect, variant, line), p_value=line.p_value,
        delta_bic=line.delta_bic, visible=float(largest / np.sqrt(2.0)), gain=gain)


def _parameters(effect: Effect, variant: int, line: Line) -> dict[str, Estimate]:
    channels = np.zeros(line.amplitude.size)
    channels[list(effect.line[variant])] = 1.0
    amplitude = float(channels @ line.amplitude / channels.sum())
    deviation = float(np.sqrt(channels @ line.deviation**2) / channels.sum())
    # Linear interpolation to common instants reduces a swing by up to this share.
    lost = (2.0 * np.pi * line.frequency * line.step) ** 2 / 8.0
    deviation = float(np.hypot(deviation, lost * amplitude))
    cosine, sine, frequency = effect.ordered
    return {
        cosine.name: Estimate(amplitude, deviation, cosine.unit),
        sine.name: Estimate(0.0, deviation, sine.unit),
        frequency.name: Estimate(line.frequency, 0.0, frequency.unit),
        **{key: Estimate(float(value), 0.0, '')
           for key, value in effect.variants[variant].items()},
    }


def _evidence(cause: Cause) -> Evidence:
    values = {key: number.value for key, number in cause.parameters.items()}
    return Evidence(
        step=0, effects=(cause.effect,), variants=(cause.variant,), misfit=0.0,
        delta_bic=cause.delta_bic, p_value=cause.p_value, visible=cause.visible,
        values={cause.effect: values})
