"""Consistency: whether the same parameters and laws fit in every run, channel and state.

A wrong cause can explain almost the whole misfit, so that the remainder is too small for a test of
all slow shapes. The remainder then resembles the change of the cause, or of the base parameters,
in proportions that differ from run to run, from channel to channel, or over state and time. Each
family of such shapes is small, so that a small remainder is significant.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from saddlering_ros.discrepancy.candidate import Fit
from saddlering_ros.discrepancy.experiment import Experiment
from saddlering_ros.discrepancy.lack_of_fit import ShapeTest, SlowResidual
from saddlering_ros.discrepancy.law_forms import changes_of_effects
from saddlering_ros.discrepancy.metric import Metric
from saddlering_ros.discrepancy.refit import Tangent
from saddlering_ros.discrepancy.system import Array
from saddlering_ros.estimation.statistics import fisher_chance

CAUSE_WAVES, PARAMETER_WAVES, STATE_WAVES = 2, 1, 3
"""Half waves over a state: for the change of a cause, the sensitivities, a channel."""

CAUSE_TIMES, PARAMETER_TIMES = 3, 2
"""Half waves over the time of a run, for the same three."""

MIN_LEFT = 1e-4
"""Smallest share of the square of a shape beside the parameters for the shape to count."""

MIN_LEVEL = 0.2
"""Smallest share of the learnt noise that is assumed."""

Columns = Callable[[int], Array]
"""Shapes (N, k) of a family in one channel of one run, by the index of the slice."""


def consistency_tests(
    metric: Metric, fit: Fit, tangent: Tangent, slow: SlowResidual, pairs: int
) -> list[ShapeTest]:
    """Every family of these runs; the number of families is counted in the p-values."""
    families = _Families(metric.experiment, fit, tangent).all()
    tests = [
        test
        for name, columns in families.items()
        if (test := _Test(metric, fit, tangent, columns).result(name, slow, pairs)) is not None
    ]
    return [replace(item, p_value=min(1.0, item.p_value * len(tests))) for item in tests]


class _Families:
    """Families of shapes about a fit, each evaluated for one channel of one run at a time."""

    def __init__(self, experiment: Experiment, fit: Fit, tangent: Tangent) -> None:
        self._experiment, self._plain = experiment, tangent.plain
        self._runs, self._names = experiment.runs, experiment.system.channel_names
        self._base = len(experiment.system.base_parameters)
        self._changes = changes_of_effects(experiment, fit)
        predicted = experiment.by_run(fit.prediction)
        self._seen = [_places([run[row] for run in predicted]) for row in range(len(self._names))]
        shared = [
            name for name in self._runs[0].inputs if all(name in run.inputs for run in self._runs)
        ]
        given = [_places([run.inputs[name] for run in self._runs]) for name in shared]
        self._states = [*self._seen, *given]
        self._times = [np.pi * (run.time - run.time[0]) / np.ptp(run.time) for run in self._runs]

    def all(self) -> dict[str, Columns]:
        """The families by the kind of their shapes."""
        families: dict[str, Columns] = {
            'state, as the parameters act': lambda slot: self._over_states(
                slot, self._sensitivities(slot)[:, : self._base], PARAMETER_WAVES),
            'time, as the parameters act': lambda slot: self._over_time(
                slot, self._sensitivities(slot)[:, : self._base], PARAMETER_TIMES),
            'the predicted state': self._of_channels,
        }
        if len(self._runs) > 1:
            families['the runs, as the parameters act'] = lambda slot: self._one_of(
                slot, self._experiment.slices[slot][0], len(self._runs))
        if len(self._names) > 1:
            families['the channels, as the parameters act'] = lambda slot: self._one_of(
                slot, self._experiment.slices[slot][1], len(self._names))
        if self._changes.size:
            families['state, as the cause acts'] = lambda slot: self._over_states(
                slot, self._own(self._changes, slot), CAUSE_WAVES)
            families['time, as the cause acts'] = lambda slot: self._over_time(
                slot, self._own(self._changes, slot), CAUSE_TIMES)
        return families

    def _own(self, stacked: Array, slot: int) -> Array:
        return np.asarray(stacked[self._experiment.slices[slot][2]])

    def _sensitivities(self, slot: int) -> Array:
        return self._own(self._plain, slot)

    def _over_states(self, slot: int, shapes: Array, waves: int) -> Array:
        run = self._experiment.slices[slot][0]
        return np.hstack([
            shapes * np.cos(wave * places[run])[:, None]
            for places in self._states
            for wave in range(1, waves + 1)
        ])

    def _over_time(self, slot: int, shapes: Array, waves: int) -> Array:
        time = self._times[self._experiment.slices[slot][0]]
        return np.hstack([
            shapes * np.cos(wave * time)[:, None] for wave in range(1, waves + 1)])

    def _one_of(self, slot: int, number: int, count: int) -> Array:
        """The sensitivities in one of `count` runs or channels, and none in the last."""
        own = self._sensitivities(slot)
        whole = np.zeros((own.shape[0], count - 1, own.shape[1]))
        if number < count - 1:
            whole[:, number] = own
        return whole.reshape(own.shape[0], -1)

    def _of_channels(self, slot: int) -> Array:
        """Shapes over the predicted channels, in this channel of any run."""
        run, channel, _ = self._experiment.slices[slot]
        waves = np.arange(1, STATE_WAVES + 1)
        own = np.hstack([np.cos(places[run][:, None] * waves) for places in self._seen])
        whole = np.zeros((own.shape[0], len(self._names), own.shape[1]))
        whole[:, channel] = own
        return whole.reshape(own.shape[0], -1)


def _places(values: Sequence[Array]) -> list[Array]:
    """A state (N,) of each run, scaled to the interval from 0 to pi."""
    low = min(float(item.min()) for item in values)
    high = max(float(item.max()) for item in values)
    return [np.pi * (item - low) / max(high - low, 1e-300) for item in values]


@dataclass(frozen=True)
class _Products:
    """Products of whitened shapes with each other, the tangents (k, p) and the residual (k,)."""

    gram: Array
    tangents: Array
    residual: Array


class _Test:
    """One family beside the sensitivities of the model."""

    def __init__(self, metric: Metric, fit: Fit, tangent: Tangent, columns: Columns) -> None:
        self._metric, self._tangent, self._columns = metric, tangent, columns
        self._products = _products(metric, fit, tangent, columns)

    def result(self, name: str, slow: SlowResidual, pairs: int) -> ShapeTest | None:
        """The test of the family; None if the parameters imitate every shape.

        Noise that is learnt from fast parts of a residual can be too large at slow times.
        The slow structure of the residual bounds its level from above.
        """
        products = self._products
        lengths = np.sqrt(np.maximum(np.diag(products.gram), 1e-300))
        white = self._tangent.white
        inverse = np.linalg.pinv(white.T @ white, rcond=1e-10, hermitian=True)
        imitated = inverse @ products.tangents.T
        gram = (products.gram - products.tangents @ imitated) / np.outer(lengths, lengths)
        values, vectors = np.linalg.eigh(gram)
        kept = values > MIN_LEFT
        count = int(kept.sum())
        if not count:
            return None
        root = vectors[:, kept] / np.sqrt(values[kept])
        inner = root.T @ (products.residual / lengths)
        statistic = float(inner @ inner)
        rest = max(slow.dimensions - count, 1)
        left = (slow.excess + slow.dimensions - statistic) / rest
        level = min(1.0, max(left, MIN_LEVEL)) if slow.dimensions > count else 1.0
        p_value = float(fisher_chance(statistic / count / level, count, pairs))
        weights = (root @ inner) / lengths
        view, size = self._largest(weights, imitated @ weights)
        beyond = max(statistic - count * level, 0.0) / max(statistic, 1e-300)
        return ShapeTest(view, name, p_value, statistic, count, size * beyond**0.5)

    def _largest(self, weights: Array, imitated: Array) -> tuple[str, float]:
        """The view in which the fitted shapes are largest, and their rms share of its range."""
        experiment = self._metric.experiment
        shape = np.empty(experiment.size)
        for slot, (_, _, part) in enumerate(experiment.slices):
            shape[part] = self._columns(slot) @ weights - self._tangent.plain[part] @ imitated
        sizes = {
            view: max(
                experiment.mean_square(seen, run, view) ** 0.5 / experiment.view_ranges[view]
                for run, seen in zip(
                    experiment.runs, experiment.view_residuals(shape, view), strict=True)
            )
            for view in experiment.system.views
        }
        view = max(sizes, key=lambda name: sizes[name])
        return view, sizes[view]


def _products(metric: Metric, fit: Fit, tangent: Tangent, columns: Columns) -> _Products:
    """Products of the shapes of a family, whitened one channel of one run at a time."""
    shared = metric.shared
    count = columns(0).shape[1]
    gram, residual = np.zeros((count, count)), np.zeros(count)
    tangents = np.zeros((count, tangent.white.shape[1]))
    along = np.zeros((count, shared.directions.shape[1]))
    for slot, (_, _, part) in enumerate(metric.experiment.slices):
        white = metric.whiteners[slot].whiten(columns(slot))
        gram += white.T @ white
        tangents += white.T @ tangent.white[part]
        residual += white.T @ fit.whitened[part]
        along += white.T @ shared.directions[part]
    shrink = shared.shrink
    return _Products(
        np.asarray(gram - (along * (2.0 * shrink - shrink**2)) @ along.T),
        np.asarray(tangents - along @ (shrink[:, None] * (shared.directions.T @ tangent.white))),
        np.asarray(residual - along @ (shrink * (shared.directions.T @ fit.whitened))),
    )
