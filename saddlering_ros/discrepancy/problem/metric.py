"""The metric of the misfit: noise of every run and channel, and nuisance parameters.

It whitens by the noise and marginalises nuisance parameters. With noise covariance C = L L' per
run and channel and nuisance columns G of prior covariance S, the metric is (C + G S G')^-1. It is
applied as L^-1 followed by the symmetric operator I - U (1 - 1/sqrt(1 + s^2)) U', where U, s are
the singular vectors and values of L^-1 G S^(1/2).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from saddlering_ros.discrepancy.problem import system as systems
from saddlering_ros.discrepancy.problem.problem import NoiseByRun, Problem, shares_of_range
from saddlering_ros.discrepancy.problem.system import Array, Point, RunBlocks
from saddlering_ros.estimation.record_noise import with_model_error
from saddlering_ros.estimation.whitening import build_whitener, SharedErrors, Whitener


@dataclass(frozen=True)
class Metric:
    """Noise of every run and channel, with the nuisance parameters marginalised.

    noise: with the declared model error; sensors: without it; shared: the nuisance parameters,
    which the whitened residuals share. A metric is never changed: `marginalise` makes another one.
    """

    problem: Problem
    noise: NoiseByRun
    sensors: NoiseByRun
    whiteners: tuple[Whitener, ...]
    shared: SharedErrors

    @classmethod
    def of(cls, problem: Problem, noise: NoiseByRun, sensors: NoiseByRun) -> Metric:
        """The metric without nuisance parameters."""
        jitter = float((systems.JITTER * problem.channel_ranges.max()) ** 2)
        whiteners = []
        for index, channel, _ in problem.slices:
            run = problem.runs[index]
            present = None if run.present is None else run.present[channel]
            whiteners.append(build_whitener(
                noise[run.name, channel], run.time, run.width, run.hold, present, jitter))
        return cls(problem, noise, sensors, tuple(whiteners), SharedErrors.none(problem.size))

    def of_sensors(self) -> Metric:
        """The metric of the noise without declared model error, with offsets."""
        return Metric.of(self.problem, self.sensors, self.sensors).with_offsets()

    def marginalise(self, nuisances: Array) -> Metric:
        """The same noise with these nuisance parameters: columns (n, k) times their spreads."""
        return replace(self, shared=SharedErrors.of(self.whiten_noise(nuisances)))

    def with_offsets(self) -> Metric:
        """The same noise with offsets of every run and channel."""
        return self.marginalise(offset_columns(self.problem))

    def with_nuisances(self, point: Point, prediction: Array) -> Metric:
        """The same noise with every nuisance parameter marginalised, evaluated at a point."""
        return self.marginalise(nuisance_columns(self.problem, point, prediction))

    def whiten_noise(self, columns: Array) -> Array:
        """L^-1 on stacked columns (n, B) or (n,): noise alone."""
        out = np.empty_like(columns)
        for whitener, (_, _, part) in zip(self.whiteners, self.problem.slices, strict=True):
            out[part] = whitener.whiten(columns[part])
        return out

    def whiten(self, columns: Array) -> Array:
        """The whole metric on stacked columns (n, B) or (n,)."""
        return self.shared.apply(self.whiten_noise(columns))

    def without_nuisances(self, residual: Array) -> Array:
        """A stacked plain residual minus its part by nuisance parameters of usual size."""
        white = self.whiten_noise(residual)
        spreads = np.clip(self.shared.along(white), -systems.MAX_SPREADS, systems.MAX_SPREADS)
        white -= self.shared.directions @ (self.shared.strength * spreads)
        for whitener, (_, _, part) in zip(self.whiteners, self.problem.slices, strict=True):
            white[part] = whitener.colour(white[part])
        return white

    def alike(self, run: RunBlocks) -> RunBlocks:
        """The fitted run of this name, or else the one whose blocks are about as long."""
        width = np.log(np.median(run.width))
        return min(self.problem.runs, key=lambda one: (
            one.name != run.name, abs(float(np.log(np.median(one.width)) - width))))

    def noise_power(self, run: RunBlocks, view: str) -> float:
        """Mean square of the noise of a view in any run, without declared model error."""
        alike = self.alike(run).name
        return sum(
            float(weight) ** 2
            * float(np.mean(self.sensors[alike, channel].variances(run.width)))
            for channel, weight in enumerate(self.problem.system.views[view]) if weight)


def noise_metric(problem: Problem, prediction: Array | None = None) -> Metric:
    """The metric of the noise alone, without nuisance parameters.

    The noise is learnt from the runs and, if it is given, the residual of a prediction (n,).
    """
    residuals = None if prediction is None else problem.by_run(prediction - problem.measured)
    sensors = problem.assumptions.learn_noise(problem.runs, residuals)
    noise = dict(sensors)
    if problem.assumptions.allowed_error is not None:
        for run in problem.runs:
            step, duration = float(np.median(np.diff(run.time))), float(np.ptp(run.time))
            for channel, share in enumerate(problem.assumptions.allowed_error):
                noise[run.name, channel] = with_model_error(
                    sensors[run.name, channel], share, 1.0, step, duration)
    return Metric.of(problem, noise, sensors)


RATE_SHAPES = 4
"""Shapes over the drive of the error by its rate: a mean and three half waves."""


def nuisance_columns(problem: Problem, point: Point, prediction: Array) -> Array:
    """Every nuisance parameter as a column (n, k) at the prediction (n,) of a point."""
    return np.hstack([stand_columns(problem, prediction), system_columns(problem, point)])


def stand_columns(problem: Problem, prediction: Array) -> Array:
    """The nuisance parameters (n, k) of the test stand: offsets, model error and delays.

    Each channel has a small delay, in runs whose drive has a rate.
    """
    offsets, prior = offset_columns(problem), problem.assumptions.model_error
    if prior is None:
        return offsets
    moving = [(problem.runs[index], part) for index, _, part in problem.slices
              if problem.runs[index].rate is not None and np.any(problem.runs[index].rate)]
    delays = np.zeros((len(moving), problem.size))
    for column, (run, part) in zip(delays, moving, strict=True):
        column[part] = prior.instants * np.gradient(prediction[part], run.time)
    return np.hstack([offsets, model_error_columns(problem, prior), delays.T])


def offset_columns(problem: Problem) -> Array:
    """A constant for every run and channel, with a very wide spread where it is free."""
    free = systems.FREE_OFFSET * float(problem.channel_ranges.max())
    declared = problem.assumptions.offsets or [free] * len(problem.channel_ranges)
    columns = np.zeros((len(problem.slices), problem.size))
    for column, (_, channel, part) in zip(columns, problem.slices, strict=True):
        column[part] = declared[channel]
    return columns[columns.any(axis=1)].T


def model_error_columns(problem: Problem, prior: systems.ModelErrorPrior) -> Array:
    """Smooth model error over the drive, shared inside a group, in every channel."""
    widest = problem.channel_ranges.max()
    fastest = max(1e-300, *(
        0.0 if run.rate is None else float(np.abs(run.rate).max()) for run in problem.runs))
    columns: list[Array] = []
    for group in sorted({run.group for run in problem.runs}):
        members = [run for run in problem.runs if run.group == group]
        places = shares_of_range([next(iter(run.inputs.values())) for run in members])
        shapes = {}
        for run, place in zip(members, places, strict=True):
            still = np.zeros(run.time.size)
            rate = (still if run.rate is None else run.rate) / fastest
            direction = still if run.direction is None else run.direction
            # Each times its spread: smooth over the drive, with its direction, with its rate.
            shapes[run.name] = [
                *(prior.smooth * np.cos(np.pi * wave * place)
                  for wave in range(1, prior.degree + 1)),
                prior.loop * direction * 4.0 * place * (1.0 - place),
                *(prior.rate * rate * np.cos(np.pi * wave * place) for wave in range(RATE_SHAPES)),
            ]
        for channel, span in enumerate(problem.channel_ranges):
            scale = max(float(span), 0.2 * float(widest))
            for number in range(prior.degree + 1 + RATE_SHAPES):
                column = np.zeros(problem.size)
                for index, other, part in problem.slices:
                    run = problem.runs[index]
                    if other == channel and run.group == group:
                        column[part] = scale * shapes[run.name][number]
                columns.append(column)
    return np.column_stack(columns)


def system_columns(problem: Problem, point: Point) -> Array:
    """The system's own nuisance parameters as stacked columns (n, k)."""
    return np.concatenate([part.reshape(part.shape[0] * part.shape[1], part.shape[2])
                           for part in problem.system.nuisances(problem.runs, point)])


Index = NDArray[np.intp]


@dataclass(frozen=True)
class Block:
    """Columns `index` (k,) in one channel of one run: `plain` (N, k).

    `slot`: index in `Problem.slices`.
    """

    slot: int
    index: Index
    plain: Array


class BlockColumns:
    """Columns (n, m) as blocks, whitened once; several blocks may share a column.

    A column of a test or a law is zero but in few channels and runs: only these parts are stored.
    """

    def __init__(self, metric: Metric, blocks: Sequence[Block], count: int) -> None:
        self._metric, self.blocks, self.count = metric, tuple(blocks), count
        self._white = [metric.whiteners[block.slot].whiten(block.plain) for block in self.blocks]

    @cached_property
    def gram(self) -> Array:
        """Products (m, m) of the whitened columns, nuisance parameters marginalised."""
        total = np.zeros((self.count, self.count))
        for block, white in zip(self.blocks, self._white, strict=True):
            total[np.ix_(block.index, block.index)] += white.T @ white
        shrink = self._metric.shared.shrink
        return np.asarray(total - (self._along * (2.0 * shrink - shrink**2)) @ self._along.T)

    def products(self, columns: Array) -> Array:
        """Products (m, B) or (m,) with whitened stacked columns (n, B) or (n,)."""
        flat = columns.reshape(columns.shape[0], -1)
        seen = self._metric.shared.shrink[:, None] * (self._metric.shared.directions.T @ flat)
        answer = self.noise_products(flat) - self._along @ seen
        return answer.reshape(self.count, *columns.shape[1:])

    def combined(self, weights: Array) -> Array:
        """The plain columns times `weights` (m,): stacked (n,)."""
        total = np.zeros(self._metric.problem.size)
        for block in self.blocks:
            part = self._metric.problem.slices[block.slot][2]
            total[part] += block.plain @ weights[block.index]
        return total

    def size_beyond_noise(self, view: str, root: Array, inner: Array, imitated: Array) -> float:
        """Largest rms share of range of a fit in a run, less what noise alone would leave.

        root (m, k): of the covariance of the fit; inner (k,): its whitened slopes; imitated
        (n, m): the part of the columns that the sensitivities of the model take.
        """
        problem, powers = self._metric.problem, [0.0]
        for number, run in enumerate(problem.runs):
            seen = np.zeros((run.time.size, self.count))
            for block in self.blocks:
                index, channel, part = problem.slices[block.slot]
                if index == number:
                    weight = problem.system.views[view][channel]
                    seen[:, block.index] += weight * block.plain
                    seen -= weight * imitated[part]
            fits = problem.freed(seen @ root, run, view)
            powers.append(problem.mean_square(fits @ inner, run, view)
                          - problem.mean_square(np.linalg.norm(fits, axis=1), run, view))
        return max(powers) ** 0.5 / problem.view_ranges[view]

    @cached_property
    def _along(self) -> Array:
        """Products (m, K) with the directions of the nuisance parameters."""
        return self.noise_products(self._metric.shared.directions)

    def noise_products(self, columns: Array) -> Array:
        """Products (m, B) of the columns whitened by noise alone with stacked columns (n, B)."""
        total = np.zeros((self.count, columns.shape[1]))
        for block, white in zip(self.blocks, self._white, strict=True):
            part = self._metric.problem.slices[block.slot][2]
            total[block.index] += white.T @ columns[part]
        return total
