"""Steady lines too slow for stretches at rest: looked for in what is left of every whole run.

A line below a few hertz has few periods in a stretch at rest. It is as strong while the load
moves, so it is looked for in the residual of the base fit. Rings sway at such frequencies too, and
a load that swings makes any misfit swing. A line counts therefore only if its strength stays the
same all along every run, and at rest, and if the drive has no line there or at a whole part of its
frequency.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from saddlering_ros.discrepancy.experiment import Experiment
from saddlering_ros.discrepancy.lines import amplitudes, find_line, Line, turns
from saddlering_ros.discrepancy.system import Array, RunBlocks
from saddlering_ros.estimation.rest import RestSegment

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

NOISE_SPREAD = 3.0
"""Standard deviations of noise that a strength may be off."""


@dataclass(frozen=True)
class SlowLine:
    """A steady line (its amplitude in the channels as they are), and the runs without it."""

    line: Line
    runs: tuple[RunBlocks, ...]
    segments: tuple[RestSegment, ...]


def find_slow_line(
    experiment: Experiment, runs: Sequence[RunBlocks], residuals: Sequence[Array],
    error_rate: float,
) -> SlowLine | None:
    """The strongest steady line in the residuals (C, N) of runs, if one is real."""
    segments = [_segment(run, left) for run, left in zip(runs, residuals, strict=True)]
    usable = [item for item in segments if item is not None]
    if not usable:
        return None
    longest = max(item.values.shape[1] * item.step for item in usable)
    least = MIN_PERIODS / longest
    search = find_line(usable, error_rate, (least, MAX_SHARE * 0.5 / min(
        item.step for item in usable)))
    line = search.line
    if line is None or not line.own.any() or _is_driven(runs, line.frequency, error_rate):
        return None
    shown = [item for item in usable if item.step * line.frequency <= 0.5 * MAX_SHARE
             and item.values.shape[1] * item.step * line.frequency >= PIECE_PERIODS]
    at_rest = [segment for run in experiment.runs for segment in run.rest]
    if not _is_steady(shown, line) or not _is_there_at_rest(at_rest, line):
        return None
    cleaned = [
        run if segment is None else _without(run, segment, line)
        for run, segment in zip(runs, segments, strict=True)
    ]
    whole = float(np.sinc(line.frequency * line.step))
    seen = replace(line, amplitude=line.amplitude / whole, deviation=line.deviation / whole)
    return SlowLine(seen, tuple(cleaned), tuple(shown))


def _segment(run: RunBlocks, residual: Array) -> RestSegment | None:
    """A run's residual as a stretch of even steps; None where its blocks are uneven.

    The last block may be a short one.
    """
    steps = np.diff(run.time)
    step = float(np.median(steps))
    if run.present is not None or np.abs(steps[:-1] - step).max() > 0.2 * step:
        return None
    return RestSegment(residual, step)


def _is_driven(runs: Sequence[RunBlocks], frequency: float, error_rate: float) -> bool:
    """Whether the drive itself swings at the frequency or at a whole part of it."""
    drives = [_segment(run, next(iter(run.inputs.values()))[None, :]) for run in runs]
    usable = [item for item in drives if item is not None]
    for part in range(1, HARMONICS + 1):
        wanted = frequency / part
        found = find_line(usable, error_rate, (0.9 * wanted, 1.1 * wanted)).line
        if found is not None and abs(found.frequency - wanted) < 0.05 * wanted:
            return True
    return False


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


def _without(run: RunBlocks, segment: RestSegment, line: Line) -> RunBlocks:
    """A run less the line, of its own phase in every channel; in the stretches at rest too."""
    channels = run.channels + _line_in(segment, line)
    rest = tuple(
        replace(item, values=item.values - _line_in(item, line)) for item in run.rest
    )
    return replace(run, channels=channels, rest=rest)


def _line_in(item: RestSegment, line: Line) -> Array:
    """The line as it is in a stretch (C, n): the best cosine and sine, nothing where it is not."""
    swings = turns(item, line.frequency)
    place = np.linspace(-1.0, 1.0, item.values.shape[1])
    shapes = np.column_stack([swings, np.ones_like(place), place])
    parts = np.linalg.lstsq(shapes, item.values.T, rcond=None)[0][:2]
    return np.asarray((swings @ (parts * line.own)).T)
