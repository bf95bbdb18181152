"""Lack of fit: tests of the residual on generic shapes with their own error rate.

Each family of shapes lives in one coordinate (drive, direction of the drive, its rate, time)
and one view; its statistic is the whitened misfit it takes after the model's own sensitivities are
projected off. The noise comes from stretches at rest, so what is tested cannot have been
swallowed by it.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np
from scipy.stats import f as fisher

from saddlering_ros.discrepancy.assumptions import Assumptions
from saddlering_ros.discrepancy.candidate import Fit
from saddlering_ros.discrepancy.change_scale import orthonormal
from saddlering_ros.discrepancy.experiment import sample_weights
from saddlering_ros.discrepancy.fast_bands import fast_bands
from saddlering_ros.discrepancy.metric import Metric
from saddlering_ros.discrepancy.system import Array, RunBlocks

WAVES_PER_RUN = 20
"""Half waves per run that are judged together, as slow structure."""

MAX_CHANCE = 0.01
"""A band counts if noise alone would leave as much less often than this."""


@dataclass(frozen=True)
class ShapeTest:
    """One family of shapes: how significant, and how large as a share of the view's range."""

    view: str
    coordinate: str
    p_value: float
    statistic: float
    dimensions: int
    visible: float


@dataclass(frozen=True)
class SlowResidual:
    """All slow structure left: whitened excess over what noise alone would leave, and its size.

    powers: mean square by view beyond what noise gives, the worst run's, as shares of range;
    sizes (R,): its root by view, run by run; chances: by channel and run, the chance that noise
    alone leaves as much there, with the number of channels and runs in it.
    """

    excess: float
    dimensions: int
    p_value: float
    visible: float
    where: str
    powers: Mapping[str, float]
    sizes: Mapping[str, Array]
    chances: Mapping[tuple[str, str], float]


@dataclass(frozen=True)
class FastResidual:
    """Structure too fast for `SlowResidual`: excess in all bands, and the largest that is real.

    Its view, run and frequency [Hz], the latter a guide only.
    """

    excess: float
    p_value: float
    visible: float
    view: str
    run: str
    frequency: float


class LackOfFitTests:
    """Shapes laid out once for a set of runs; asked for every fit."""

    def __init__(self, metric: Metric, noise_pairs: int) -> None:
        self._metric = metric
        self._ranges = metric.experiment.view_ranges
        self._pairs = noise_pairs
        self._structure, self._counts = _structure_columns(metric)
        self._white = metric.whiten(self._structure)
        gram = self._white.T @ self._white
        self._gram = gram.copy()
        gram[np.diag_indices_from(gram)] *= 1.0 + 1e-9
        values, vectors = np.linalg.eigh(gram)
        kept = values > 1e-8 * values[-1]
        self._root = vectors[:, kept] / np.sqrt(values[kept])
        self._dimensions = int(kept.sum())
        self._bands = fast_bands(metric, WAVES_PER_RUN + 1)

    def fast(self, fit: Fit) -> FastResidual:
        """Structure faster than that of `structure`: the band that stands out most, and where.

        Its p-value carries the number of bands; of each band only what is beyond noise counts.
        """
        metric = self._metric
        left = metric.without_nuisances(fit.prediction - metric.experiment.measured)
        white = metric.whiten_noise(left)
        excess, found = 0.0, FastResidual(0.0, 1.0, 0.0, '', '', 0.0)
        for band in self._bands:
            parts = band.coefficients(white)
            free = sum(part.size for part in parts)
            statistic = float(sum(part @ part for part in parts))
            p_value = float(fisher.sf(statistic / free, free, self._pairs)) * len(self._bands)
            excess += max(statistic - free, 0.0)
            seen = band.seen(parts)
            width = metric.experiment.runs[band.run].width
            for view, weights in metric.experiment.system.views.items():
                power = float(np.average((weights @ seen) ** 2, weights=width))
                power -= float(weights**2 @ band.noise)
                size = max(power, 0.0) ** 0.5 / self._ranges[view]
                if p_value < MAX_CHANCE and size > found.visible:
                    strongest = int(np.argmax(np.sum([part**2 for part in parts], axis=0)))
                    frequency = 0.5 * (band.first + strongest) / band.duration
                    name = metric.experiment.runs[band.run].name
                    found = FastResidual(0.0, p_value, size, view, name, frequency)
        return replace(found, excess=excess)

    def slow(self, fit: Fit) -> SlowResidual:
        """Slow structure of the residual as a whole."""
        inner = self._root.T @ (self._white.T @ fit.whitened)
        free = max(self._dimensions - fit.theta_unit.size, 1)
        statistic = float(inner @ inner)
        p_value = float(fisher.sf(statistic / free, free, self._pairs))
        shape = self._structure @ (self._root @ inner)
        noise = self._structure @ self._root
        visible, where = 0.0, ''
        powers: dict[str, float] = {}
        sizes: dict[str, Array] = {}
        metric = self._metric
        for view in metric.experiment.system.views:
            seen = metric.experiment.view_residuals(shape, view)
            expected = _view_variance(metric, noise, view)
            own = []
            for run, part, variance in zip(metric.experiment.runs, seen, expected, strict=True):
                power = metric.experiment.mean_square(part, run, view) - variance
                size = float(np.sqrt(max(power, 0.0))) / self._ranges[view]
                own.append(size)
                powers[view] = max(powers.get(view, 0.0), size**2)
                if size > visible:
                    visible, where = size, f'{view} in {run.name}'
            sizes[view] = np.array(own)
        return SlowResidual(
            statistic - free, free, p_value, visible, where, powers, sizes, self._chances(fit)
        )

    def _chances(self, fit: Fit) -> dict[tuple[str, str], float]:
        """Chance that noise alone leaves as much slow structure in each channel of each run."""
        experiment = self._metric.experiment
        names = experiment.system.channel_names
        slopes = self._white.T @ fit.whitened
        chances, start = {}, 0
        for (index, channel, _), count in zip(experiment.slices, self._counts, strict=True):
            run = experiment.runs[index]
            own = slice(start, start + count)
            start += count
            gram = self._gram[own, own]
            statistic = float(slopes[own] @ np.linalg.lstsq(gram, slopes[own], rcond=1e-8)[0])
            pairs = min(self._pairs, max(self._metric.noise[run.name, channel].pairs, 1))
            chance = float(fisher.sf(statistic / count, count, pairs)) * len(self._counts)
            chances[names[channel], run.name] = min(1.0, chance)
        return chances

    def shapes(self, fit: Fit, white_columns: Array) -> list[ShapeTest]:
        """Every family, most significant first; p-values carry the number of families."""
        metric = self._metric
        orthogonal = orthonormal(white_columns)
        tests = []
        for coordinate, shapes in _families(
            metric.experiment.runs, metric.experiment.assumptions
        ).items():
            for view, weights in metric.experiment.system.views.items():
                columns = _spread(metric, shapes, weights)
                white = metric.whiten(columns)
                white = white - orthogonal @ (orthogonal.T @ white)
                values, vectors = np.linalg.eigh(white.T @ white)
                kept = values > 1e-8 * max(float(values[-1]), 1e-300)
                root = vectors[:, kept] / np.sqrt(values[kept])
                inner = root.T @ (white.T @ fit.whitened)
                count = int(kept.sum())
                statistic = float(inner @ inner)
                change = columns @ (root @ inner)
                sizes = [
                    metric.experiment.mean_square(seen, run, view) ** 0.5 / self._ranges[view]
                    for run, seen in zip(
                        metric.experiment.runs,
                        metric.experiment.view_residuals(change, view),
                        strict=True,
                    )
                ]
                p_value = float(fisher.sf(statistic / count, count, self._pairs))
                tests.append(ShapeTest(view, coordinate, p_value, statistic, count, max(sizes)))
        total = len(tests)
        return sorted(
            (
                ShapeTest(
                    item.view,
                    item.coordinate,
                    min(1.0, item.p_value * total),
                    item.statistic,
                    item.dimensions,
                    item.visible,
                )
                for item in tests
            ),
            key=lambda item: (item.p_value, -item.statistic / item.dimensions),
        )


def _view_variance(metric: Metric, noise: Array, view: str) -> list[float]:
    """Mean square that noise alone gives the fitted structure, per run, in one view."""
    weights = metric.experiment.system.views[view]
    found, start = [], 0
    for run in metric.experiment.runs:
        count = run.channels.size
        block = noise[start : start + count].reshape(*run.channels.shape, -1)
        start += count
        combined = np.einsum('c,cnk->nk', weights, block)
        combined = metric.experiment.freed(combined, run, view)
        weights_of_time = sample_weights(metric.experiment.system, run, view)
        found.append(float(np.average((combined**2).sum(axis=1), weights=weights_of_time)))
    return found


def _structure_columns(metric: Metric) -> tuple[Array, list[int]]:
    """Cosines of time in every run and channel, and how many each has.

    Where a constant is a misfit it is one of them.
    """
    experiment = metric.experiment
    columns, counts = [], []
    for index, channel, part in experiment.slices:
        run = experiment.runs[index]
        waves = min(WAVES_PER_RUN, run.time.size // 4)
        share = (run.time - run.time[0]) / max(float(np.ptp(run.time)), 1e-300)
        present = 1.0 if run.present is None else run.present[channel]
        first = 1 if experiment.assumptions.frees_constant(channel) else 0
        for wave in range(first, waves + 1):
            column = np.zeros(experiment.size)
            column[part] = present * np.cos(np.pi * wave * share)
            columns.append(column)
        counts.append(waves + 1 - first)
    return np.column_stack(columns), counts


def _families(
    runs: tuple[RunBlocks, ...], assumptions: Assumptions
) -> dict[str, list[list[Array]]]:
    """Coordinate to shapes, one array per run each."""
    special, (first, others) = assumptions.special_inputs, assumptions.coordinate_waves
    shared = [name for name in runs[0].inputs if all(name in run.inputs for run in runs)]
    names = [name for name in shared if name not in special]
    families: dict[str, list[list[Array]]] = {}
    groups = sorted({run.group for run in runs})
    for number, name in enumerate(names):
        low = min(float(run.inputs[name].min()) for run in runs)
        high = max(float(run.inputs[name].max()) for run in runs)
        shares = [(run.inputs[name] - low) / max(high - low, 1e-300) for run in runs]
        families[name] = [
            [
                np.cos(np.pi * wave * share) * (run.group == group)
                for run, share in zip(runs, shares, strict=True)
            ]
            for wave in range(1, (first if number == 0 else others) + 1)
            for group in groups
        ]
        if number == 0 and 'direction' in special and 'direction' in shared:
            families['direction'] = [
                [
                    run.inputs['direction']
                    * (np.sin(np.pi * wave * share) if wave else 1.0)
                    * (run.group == group)
                    for run, share in zip(runs, shares, strict=True)
                ]
                for wave in range(3)
                for group in groups
            ]
    families['time'] = [
        [
            np.cos(np.pi * wave * (run.time - run.time[0]) / np.ptp(run.time)) * (run is other)
            for run in runs
        ]
        for wave in range(1, 9)
        for other in runs
    ]
    return families


def _spread(metric: Metric, shapes: list[list[Array]], weights: Array) -> Array:
    """Shapes in a view as stacked columns: the least change of channels that shows as 1 there."""
    pattern = weights / float(weights @ weights)
    return np.column_stack(
        [
            np.concatenate([(pattern[:, None] * part[None, :]).ravel() for part in shape])
            for shape in shapes
        ]
    )
