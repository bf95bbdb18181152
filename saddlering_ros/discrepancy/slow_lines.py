"""Steady lines too slow for stretches at rest: looked for in what is left of every whole run.

A line below a few hertz has few periods in a stretch at rest. It is as strong while the load
moves, so it is looked for in the residual of the base fit. Rings sway at such frequencies too, and
a load that swings makes any misfit swing. A line counts therefore only if its strength stays the
same all along every run, and at rest, and if the drive has no line there or at a whole part of its
frequency. A run with gaps is searched between them. Where only static tests were made, lines are
looked for in their holds.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np

from saddlering_ros.discrepancy.experiment import Experiment
from saddlering_ros.discrepancy.lines import (
    amplitudes,
    find_line,
    Line,
    MIN_FREQUENCY,
    MIN_SAMPLES,
    turns,
)
from saddlering_ros.discrepancy.system import Array, RunBlocks
from saddlering_ros.estimation.rest import RestSegment

MAX_LINES = 3
"""Lines looked for, one after the other."""

MIN_HOLDS, MIN_HOLD_SAMPLES = 8, 40
"""Holds of a static test, and samples of each, that show a line."""

MIN_PERIODS = 20.0
"""The longest run shows so many periods of the slowest line: fewer are a drift, or a sway."""

MAX_SHARE = 0.8
"""Block means show lines up to this share of half their rate."""

PIECES, PIECE_PERIODS = 8, 3.0
"""A run is cut into so many pieces, or fewer, of so many periods each, to see the line in each."""

MAX_UNSTEADY = 0.35
"""The line's strength in a piece may differ so far from its mean, noise apart."""

HARMONICS = 5
"""A drive's line may show in the readings at its frequency and at so many multiples."""

DRIVEN_SHARE = 0.1
"""A drive whose swing makes less than this share of a line does not make the line."""

NOISE_SPREAD = 3.0
"""Standard deviations of noise that a strength may be off."""


@dataclass(frozen=True)
class SlowLine:
    """A steady line (its amplitude in the channels as they are), and where it was seen."""

    line: Line
    segments: tuple[RestSegment, ...]


@dataclass(frozen=True)
class Stretch:
    """A part [first, last) of a run whose blocks follow each other in even steps."""

    run: int
    first: int
    last: int
    segment: RestSegment


def find_slow_lines(
    experiment: Experiment, runs: Sequence[RunBlocks], residuals: Sequence[Array],
    error_rate: float,
) -> tuple[list[SlowLine], tuple[RunBlocks, ...]]:
    """Steady lines in the residuals (C, N) of runs, the strongest first; the runs without them."""
    found: list[SlowLine] = []
    left, kept = list(residuals), tuple(runs)
    while len(found) < MAX_LINES:
        stretches = stretches_of(kept, left)
        line = (_in_whole_runs if stretches else _at_rest)(experiment, kept, stretches, error_rate)
        if line is None:
            break
        found.append(line)
        kept, left = _cleaned(kept, left, stretches, line)
    return found, kept


def _in_whole_runs(
    experiment: Experiment, runs: Sequence[RunBlocks], stretches: Sequence[Stretch],
    error_rate: float,
) -> SlowLine | None:
    """The strongest line of whole runs, if it is a steady one."""
    usable = [item.segment for item in stretches]
    longest = max(item.values.shape[1] * item.step for item in usable)
    most = MAX_SHARE * 0.5 / min(item.step for item in usable)
    line = find_line(usable, error_rate, (MIN_PERIODS / longest, most)).line
    if line is None or not line.own.any() or _is_driven(runs, line, error_rate):
        return None
    shown = [item for item in usable if item.step * line.frequency <= 0.5 * MAX_SHARE
             and item.values.shape[1] * item.step * line.frequency >= PIECE_PERIODS]
    at_rest = [segment for run in runs if not run.held_out for segment in run.rest]
    if not _is_steady(shown, line) or not _is_there_at_rest(at_rest, line):
        return None
    whole = float(np.sinc(line.frequency * line.step))
    seen = replace(line, amplitude=line.amplitude / whole, deviation=line.deviation / whole)
    return SlowLine(seen, tuple(shown))


def _at_rest(
    experiment: Experiment, runs: Sequence[RunBlocks], stretches: Sequence[Stretch],
    error_rate: float,
) -> SlowLine | None:
    """The strongest line of the holds of static tests, where no run has even steps."""
    usable = [segment for run in runs if not run.held_out for segment in run.rest
              if segment.values.shape[1] >= MIN_HOLD_SAMPLES]
    if len(usable) < MIN_HOLDS:
        return None
    longest = max(item.values.shape[1] * item.step for item in usable)
    least = PIECE_PERIODS / longest
    line = find_line(usable, error_rate, (least, MIN_FREQUENCY), MIN_HOLD_SAMPLES).line
    if line is None or not line.own.any() or not _is_steady(usable, line):
        return None
    return SlowLine(line, tuple(usable))


def stretches_of(runs: Sequence[RunBlocks], values: Sequence[Array]) -> list[Stretch]:
    """Parts of runs (C, N) with even steps and no missing sample, each as a stretch."""
    found = []
    for number, (run, own) in enumerate(zip(runs, values, strict=True)):
        steps = np.diff(run.time)
        step = float(np.median(steps))
        # The last block may be a short one.
        uneven = np.append(np.abs(steps[:-1] - step) > 0.2 * step, False)
        if run.present is not None:
            whole = np.asarray(run.present.all(axis=0))
            uneven |= ~(whole[:-1] & whole[1:])
        edges = [0, *(np.flatnonzero(uneven) + 1).tolist(), run.time.size]
        found += [
            Stretch(number, first, last, RestSegment(own[:, first:last], step))
            for first, last in pairwise(edges)
            if last - first >= MIN_SAMPLES
        ]
    return found


def _is_driven(runs: Sequence[RunBlocks], line: Line, error_rate: float) -> bool:
    """Whether the drive itself swings at the frequency, or at a whole part of it, strongly enough.

    The corners of a course that is cut short have a spectrum too, which is not steady.
    """
    drives = [next(iter(run.inputs.values()))[None, :] for run in runs]
    usable = [item.segment for item in stretches_of(runs, drives)]
    least = _least_swing(runs, drives, line)
    for part in range(1, HARMONICS + 1):
        wanted = line.frequency / part
        found = find_line(usable, error_rate, (0.9 * wanted, 1.1 * wanted)).line
        if found is None or abs(found.frequency - wanted) >= 0.05 * wanted:
            continue
        if float(found.amplitude[0]) >= least and _is_steady(usable, found):
            return True
    return False


def _least_swing(runs: Sequence[RunBlocks], drives: Sequence[Array], line: Line) -> float:
    """Amplitude of the drive whose straight response is a share of the line."""
    drive = max(float(np.ptp(own)) for own in drives)
    ranges = np.max([np.ptp(run.channels, axis=1) for run in runs], axis=0)
    shares = line.amplitude[line.own] / np.maximum(ranges[line.own], 1e-300)
    return DRIVEN_SHARE * drive * float(shares.max())


def _is_steady(segments: Sequence[RestSegment], line: Line) -> bool:
    """Whether a line is as strong in every piece of every run, and swings on in between."""
    strengths, spreads, whole = [], [], []
    for item in segments:
        periods = item.values.shape[1] * item.step * line.frequency
        pieces = max(1, min(PIECES, int(periods / PIECE_PERIODS)))
        own = []
        for part in np.array_split(np.arange(item.values.shape[1]), pieces):
            strength, spread = _strength(replace(item, values=item.values[:, part]), line)
            own.append(strength)
            strengths.append(strength)
            spreads.append(spread)
        together, _ = _strength(item, line)
        whole.append(together / max(float(np.mean(own)), 1e-300))
    usual = float(np.median(strengths))
    off = np.abs(np.array(strengths) - usual) - NOISE_SPREAD * np.array(spreads)
    return bool(np.all(off <= MAX_UNSTEADY * usual) and min(whole) >= 1.0 - MAX_UNSTEADY)


def _is_there_at_rest(rest: Sequence[RestSegment], line: Line) -> bool:
    """Whether stretches at rest, where they are long enough to say so, show the line as strong."""
    usual = float(np.linalg.norm(line.amplitude[line.own]))
    whole = float(np.sinc(line.frequency * line.step))
    strengths, spreads = [], []
    for item in rest:
        periods = item.values.shape[1] * item.step * line.frequency
        if periods < PIECE_PERIODS or item.step * line.frequency > 0.4:
            continue
        strength, spread = _strength(item, line)
        strengths.append(strength * whole)
        spreads.append(spread)
    if not strengths:
        return True
    spread = NOISE_SPREAD * float(np.median(spreads))
    return abs(float(np.median(strengths)) - usual) <= MAX_UNSTEADY * usual + spread


def _strength(item: RestSegment, line: Line) -> tuple[float, float]:
    """Amplitude over the channels that have the line, together, and its standard deviation."""
    size, deviation = amplitudes(item, line.frequency)
    own = line.own
    return float(np.linalg.norm(size[own])), float(np.linalg.norm(deviation[own]))


def _cleaned(
    runs: Sequence[RunBlocks], residuals: Sequence[Array], stretches: Sequence[Stretch],
    found: SlowLine,
) -> tuple[tuple[RunBlocks, ...], list[Array]]:
    """Runs and residuals less the line, of its own phase in every channel and stretch."""
    channels = [run.channels.copy() for run in runs]
    left = [item.copy() for item in residuals]
    for item in stretches:
        part = slice(item.first, item.last)
        swing = _line_in(item.segment, found.line)
        channels[item.run][:, part] += swing  # the residual is prediction less measurement
        left[item.run][:, part] -= swing
    cleaned = []
    for run, own in zip(runs, channels, strict=True):
        rest = tuple(
            replace(item, values=item.values - _line_in(item, found.line)) for item in run.rest
        )
        cleaned.append(replace(run, channels=own, rest=rest))
    return tuple(cleaned), left


def _line_in(item: RestSegment, line: Line) -> Array:
    """The line as it is in a stretch (C, n): the best cosine and sine, nothing where it is not."""
    swings = turns(item, line.frequency)
    place = np.linspace(-1.0, 1.0, item.values.shape[1])
    shapes = np.column_stack([swings, np.ones_like(place), place])
    parts = np.linalg.lstsq(shapes, item.values.T, rcond=None)[0][:2]
    return np.asarray((swings @ (parts * line.own)).T)
