"""Residuals made comparable: whitened by the measured noise, freed of offsets and small unknowns.

With noise covariance C = L L' per run and channel and nuisance columns G of prior covariance S,
the likelihood's metric is (C + G S G')^-1. It is applied as L^-1 followed by the symmetric
operator I - U (1 - 1/sqrt(1 + s^2)) U', where U, s are the singular vectors and values of L^-1
G S^(1/2).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from scipy.linalg import cholesky, solve_triangular

from saddlering_ros.discrepancy.noise import (
    ChannelNoise,
    HeldSeries,
    measure_noise,
    TIME_CONSTANTS,
)
from saddlering_ros.discrepancy.system import (
    Array,
    DiscrepancyError,
    Point,
    RestSegment,
    Run,
    System,
)

USUAL_SPREADS = 2.5
"""A nuisance larger than so many of its standard deviations is no nuisance."""

OFFSET_STRENGTH = 1e3
"""A nuisance so many times the noise is left free already."""

SEEN_SHARE = 0.25
"""A stretch at rest shows noise of time constants up to this share of its length."""

FEW_STRETCHES = 10
"""Fewer stretches at rest than this tell nothing of noise slower than themselves."""

RATE_SHAPES = 4
"""Shapes over the drive of the error that goes with its rate."""


@dataclass(frozen=True)
class Allowance:
    """How wrong the simulator may be, smoothly, without that being a finding; share of range.

    smooth: over the drive; loop: with its direction; rate: at the fastest change of the drive.
    instants [s]: how well a channel's time is known beside the drive's, run by run.
    """

    smooth: float = 3e-4
    loop: float = 1e-4
    rate: float = 1.5e-3
    degree: int = 4
    instants: float = 7e-4


@dataclass
class Likelihood:
    """The runs that are fitted, their noise, and the metric in which misfit is counted.

    Stacked vectors run over runs, then channels, then samples.
    """

    system: System
    runs: tuple[Run, ...]
    noise: Mapping[tuple[str, int], ChannelNoise]
    ranges: Array
    factors: list[list[Array]] = field(default_factory=list)
    roots: list[list[Array]] = field(default_factory=list)
    strength: Array | None = None
    directions: Array | None = None
    shrink: Array | None = None
    simulations: int = 0

    def factor(self) -> None:
        """Inverse Cholesky factors of the noise covariance of every run and channel."""
        self.factors, self.roots = [], []
        for run in self.runs:
            hold = run.inputs.get('hold')
            row: list[Array] = []
            roots: list[Array] = []
            for channel in range(run.channels.shape[0]):
                matrix = self.noise[run.name, channel].covariance(run.time, run.width, hold)
                matrix += np.diag(np.full(run.time.size, (1e-6 * self.ranges.max()) ** 2))
                lower = cholesky(matrix, lower=True)
                roots.append(lower)
                row.append(solve_triangular(lower, np.eye(run.time.size), lower=True))
            self.factors.append(row)
            self.roots.append(roots)

    def relearn(self, prediction: Array) -> None:
        """Noise learnt again now that a residual tells how it wanders from hold to hold."""
        residual = prediction - self.measured()
        blocks, start = [], 0
        for run in self.runs:
            blocks.append(residual[start : start + run.channels.size].reshape(run.channels.shape))
            start += run.channels.size
        self.noise = learn_noise(self.runs, blocks)
        self.directions = self.shrink = None
        self.factor()

    @property
    def size(self) -> int:
        return sum(run.channels.size for run in self.runs)

    def slices(self) -> list[tuple[int, int, slice]]:
        """(run index, channel, slice of the stacked vector)."""
        parts, start = [], 0
        for index, run in enumerate(self.runs):
            for channel in range(run.channels.shape[0]):
                parts.append((index, channel, slice(start, start + run.time.size)))
                start += run.time.size
        return parts

    def measured(self) -> Array:
        return np.concatenate([run.channels.ravel() for run in self.runs])

    def predict(self, points: Sequence[Point]) -> Array:
        """Stacked channels (n, B)."""
        self.simulations += len(points)
        parts = []
        for run in self.runs:
            batch = self.system.predict_many(run, points)
            if batch.shape != (len(points), *run.channels.shape):
                raise DiscrepancyError(f'simulator: wrong shape {batch.shape} for run {run.name}')
            parts.append(batch.reshape(len(points), -1))
        return np.ascontiguousarray(np.concatenate(parts, axis=1).T)

    def whiten_plain(self, columns: Array) -> Array:
        """L^-1 on stacked columns (n, B) or (n,)."""
        matrix = columns if columns.ndim == 2 else columns[:, None]
        out = np.empty_like(matrix)
        for index, channel, part in self.slices():
            out[part] = self.factors[index][channel] @ matrix[part]
        return out if columns.ndim == 2 else out[:, 0]

    def whiten(self, columns: Array) -> Array:
        """The whole metric on stacked columns (n, B) or (n,)."""
        white = self.whiten_plain(columns)
        if self.directions is None or self.shrink is None:
            return white
        inner = self.directions.T @ white
        scale = self.shrink if columns.ndim == 1 else self.shrink[:, None]
        return np.asarray(white - self.directions @ (scale * inner))

    def free_of(self, nuisance: Array) -> None:
        """Take nuisance columns (n, k), already times their spreads, into the metric."""
        white = self.whiten_plain(nuisance)
        left, values, _ = np.linalg.svd(white, full_matrices=False)
        kept = values > 1e-3
        self.directions = np.ascontiguousarray(left[:, kept])
        self.shrink = 1.0 - 1.0 / np.sqrt(1.0 + values[kept] ** 2)
        self.strength = values[kept]

    def grown(self, factor: float, free: Array) -> Array:
        """Nuisance columns, whitened, `factor` times as large, and plain columns beside them.

        Offsets, whose spread is wide already, stay as they are.
        """
        white = self.whiten_plain(free)
        if self.directions is None or self.strength is None:
            return white
        larger = np.where(self.strength < OFFSET_STRENGTH, factor * self.strength, self.strength)
        return np.hstack([self.directions * larger, white])

    def without_nuisances(self, residual: Array) -> Array:
        """A stacked plain residual less what nuisances of a usual size make of it."""
        if self.directions is None or self.strength is None:
            return residual
        white = self.whiten_plain(residual)
        seen = self.directions.T @ white
        spreads = np.clip(
            self.strength / (1.0 + self.strength**2) * seen, -USUAL_SPREADS, USUAL_SPREADS
        )
        white = white - self.directions @ (self.strength * spreads)
        out = np.empty_like(white)
        for index, channel, part in self.slices():
            out[part] = self.roots[index][channel] @ white[part]
        return out

    @property
    def free_count(self) -> float:
        """Dimensions left after the nuisances have taken theirs."""
        taken = 0.0 if self.shrink is None else float((1.0 - (1.0 - self.shrink) ** 2).sum())
        return self.size - taken

    def view_residuals(self, residual: Array, view: str) -> list[Array]:
        """A stacked residual seen in one view, run by run, each freed of its mean."""
        weights = self.system.views[view]
        seen, start = [], 0
        for run in self.runs:
            block = residual[start : start + run.channels.size].reshape(run.channels.shape)
            start += run.channels.size
            combined = weights @ block
            seen.append(combined - np.average(combined, weights=run.width))
        return seen


def view_ranges(system: System, runs: Sequence[Run]) -> dict[str, float]:
    """Range that a misfit in each view is compared with.

    A view that ought to be empty (parity) is compared with the widest view made of channels it
    uses.
    """
    ranges = {
        name: max(float(np.ptp(weights @ run.channels)) for run in runs)
        for name, weights in system.views.items()
    }
    scaled: dict[str, float] = {}
    for name, weights in system.views.items():
        alike = [
            ranges[other] * float(np.abs(weights).sum() / np.abs(vector).sum())
            for other, vector in system.views.items()
            if np.any((weights != 0) & (vector != 0))
        ]
        scaled[name] = max(
            [ranges[name], 0.2 * max(alike)] if ranges[name] > 0.1 * max(alike) else [max(alike)]
        )
    return scaled


def learn_noise(
    runs: Sequence[Run], residuals: Sequence[Array] | None = None
) -> dict[tuple[str, int], ChannelNoise]:
    """Noise by run name and channel; runs sampled alike share what is learnt from all of them.

    `residuals` (C, N) per run, once there are some, tell the noise from hold to hold.
    """
    classes: dict[int, list[RestSegment]] = {}
    series: dict[int, list[HeldSeries]] = {}
    for number, run in enumerate(runs):
        for segment in run.rest:
            classes.setdefault(_sampling(run), []).append(segment)
        held = None if residuals is None else _held_series(run, residuals[number])
        if held is not None:
            series.setdefault(_sampling(run), []).append(held)
    if not classes:
        raise DiscrepancyError('noise: no stretch at rest in any run; hold the load somewhere')
    count = runs[0].channels.shape[0]
    usable = {
        key: segments
        for key, segments in classes.items()
        if sum(segment.values.shape[1] for segment in segments) >= 16
    }
    if not usable:
        raise DiscrepancyError('noise: the stretches at rest are too short to learn from')
    # Slow noise is a matter of the instrument, not of the rate: take it from who saw most of it.
    richest = max(usable, key=lambda key: len(usable[key]))
    learnt = {
        key: measure_noise(
            segments,
            count,
            series.get(key, ()),
            np.inf if key == richest else _longest_seen(segments),
        )
        for key, segments in usable.items()
    }
    if richest not in series and len(usable[richest]) < FEW_STRETCHES:
        learnt[richest] = [_going_on(item, usable[richest]) for item in learnt[richest]]
    for key in learnt:
        learnt[key] = [
            replace(
                own,
                slow=np.maximum(own.slow, np.where(TIME_CONSTANTS >= 0.3, best.slow, 0.0)),
            )
            for own, best in zip(learnt[key], learnt[richest], strict=True)
        ]
    noise: dict[tuple[str, int], ChannelNoise] = {}
    for run in runs:
        own = _sampling(run)
        key = own if own in learnt else next(iter(learnt))
        for channel in range(count):
            noise[run.name, channel] = learnt[key][channel]
    return noise


def _longest_seen(segments: Sequence[RestSegment]) -> float:
    """Time constant [s] up to which stretches at rest tell noise from a trend."""
    return SEEN_SHARE * max(segment.step * segment.values.shape[1] for segment in segments)


def _going_on(noise: ChannelNoise, segments: Sequence[RestSegment]) -> ChannelNoise:
    """Noise that at times longer than any stretch at rest is as large as at the longest seen."""
    span = max(segment.step * segment.values.shape[1] for segment in segments)
    longest = noise.deviation(0.25 * span) ** 2
    slow = np.where(span < TIME_CONSTANTS, np.maximum(noise.slow, longest), noise.slow)
    return replace(noise, slow=slow)


def _sampling(run: Run) -> int:
    """Class of sampling rates a run belongs to; -1 for one without rest."""
    return round(20 * np.log10(run.rest[0].step)) if run.rest else -1


def _held_series(run: Run, residual: Array) -> HeldSeries | None:
    """Means of a residual over consecutive holds, if the run is made of holds."""
    hold = run.inputs.get('hold')
    if hold is None:
        return None
    levels, place = np.unique(hold, return_inverse=True)
    if levels.size < 8 or levels.size > 0.6 * hold.size:
        return None
    weight = np.bincount(place, run.width)
    time = np.bincount(place, run.width * run.time) / weight
    order = np.argsort(time)
    means = np.array([np.bincount(place, run.width * row) / weight for row in residual])
    return HeldSeries(means[:, order], time[order], weight[order].astype(np.float64))


def build_likelihood(system: System, runs: Sequence[Run]) -> Likelihood:
    """Noise learnt and factored; offsets free. Other nuisances come in once the base is known."""
    count = len(system.channel_names)
    ranges = np.array(
        [max(float(np.ptp(run.channels[channel])) for run in runs) for channel in range(count)]
    )
    likelihood = Likelihood(system, tuple(runs), learn_noise(runs), ranges)
    likelihood.factor()
    likelihood.free_of(offset_columns(likelihood))
    return likelihood


def offset_columns(likelihood: Likelihood) -> Array:
    """A free constant for every run and channel, as columns with a very wide spread."""
    parts = likelihood.slices()
    columns = np.zeros((likelihood.size, len(parts)))
    for number, (_, _, part) in enumerate(parts):
        columns[part, number] = 10.0 * likelihood.ranges.max()
    return columns


def allowance_columns(likelihood: Likelihood, allowance: Allowance) -> Array:
    """Smooth model error over the drive, shared inside a group, in every channel."""
    groups = sorted({run.group for run in likelihood.runs})
    count = likelihood.runs[0].channels.shape[0]
    widest = likelihood.ranges.max()
    rates = [run.inputs['rate'] for run in likelihood.runs if 'rate' in run.inputs]
    fastest = max([1e-300, *(float(np.abs(rate).max()) for rate in rates)])
    columns: list[Array] = []
    for group in groups:
        members = [run for run in likelihood.runs if run.group == group]
        drives = {run.name: next(iter(run.inputs.values())) for run in members}
        low = min(float(drive.min()) for drive in drives.values())
        high = max(float(drive.max()) for drive in drives.values())
        for channel in range(count):
            scale = max(float(likelihood.ranges[channel]), 0.2 * float(widest))
            for degree in range(1, allowance.degree + 2 + RATE_SHAPES):
                column = np.zeros(likelihood.size)
                for index, other, part in likelihood.slices():
                    run = likelihood.runs[index]
                    if other != channel or run.group != group:
                        continue
                    place = (drives[run.name] - low) / max(high - low, 1e-300)
                    if degree <= allowance.degree:
                        shape = allowance.smooth * np.cos(np.pi * degree * place)
                    elif degree > allowance.degree + 1:
                        wave = degree - allowance.degree - 2
                        speed = run.inputs.get('rate', np.zeros(run.time.size)) / fastest
                        shape = allowance.rate * speed * np.cos(np.pi * wave * place)
                    else:
                        direction = run.inputs.get('direction', np.zeros(run.time.size))
                        shape = allowance.loop * direction * 4.0 * place * (1.0 - place)
                    column[part] = scale * shape
                columns.append(column)
    return np.column_stack(columns)


def instant_columns(likelihood: Likelihood, allowance: Allowance, prediction: Array) -> Array:
    """What a channel read a little late shows, in runs whose drive has a rate; columns (n, k)."""
    columns = []
    for index, _, part in likelihood.slices():
        run = likelihood.runs[index]
        if np.any(run.inputs.get('rate', 0.0)):
            column = np.zeros(likelihood.size)
            column[part] = allowance.instants * np.gradient(prediction[part], run.time)
            columns.append(column)
    return np.array(columns).reshape(-1, likelihood.size).T


def disturbance_columns(likelihood: Likelihood, point: Point) -> Array:
    """The system's own small unknowns as stacked columns (n, k)."""
    parts = likelihood.system.disturbances(likelihood.runs, point)
    return np.concatenate(
        [part.reshape(part.shape[0] * part.shape[1], part.shape[2]) for part in parts]
    )
