"""How large a change of the prediction is, as a share of a view's range."""

from __future__ import annotations

import numpy as np

from saddlering_ros.discrepancy.experiment import Experiment
from saddlering_ros.discrepancy.metric import Metric
from saddlering_ros.discrepancy.system import Array


def visible_falls(metric: Metric, less: Array, more: Array) -> dict[str, Array]:
    """Fall of the rms residual between two predictions (n,): per view one number per run.

    Taken in quadrature, as a share of the view's range, after the nuisances took what they can of
    either: what is beyond a sound system's own small errors.
    """
    experiment = metric.experiment
    measured = experiment.measured
    less, more = (measured + metric.without_nuisances(item - measured) for item in (less, more))
    falls: dict[str, Array] = {}
    for view in experiment.system.views:
        seen = zip(
            experiment.runs,
            experiment.view_residuals(less - measured, view),
            experiment.view_residuals(more - measured, view),
            strict=True,
        )
        powers = [
            experiment.mean_square(before, run, view) - experiment.mean_square(after, run, view)
            for run, before, after in seen
        ]
        falls[view] = np.sqrt(np.maximum(powers, 0.0)) / experiment.view_ranges[view]
    return falls


class ChangeScale:
    """How large a change is as a share of range, noise and nuisances apart.

    What the base parameters, moved to the least rms over all runs and views, make of a change is
    taken off first: it is no misfit.
    """

    def __init__(self, experiment: Experiment, base_plain: Array) -> None:
        self._experiment = experiment
        self._base = orthonormal(
            np.column_stack([np.concatenate(self._seen(column)) for column in base_plain.T])
        )

    def beyond_base(self, change: Array) -> float:
        """Largest rms over runs and views of a stacked change (n,), as a share of range."""
        return max(float(sizes.max()) for sizes in self.by_run(change).values())

    def by_run(self, change: Array) -> dict[str, Array]:
        """Rms of a stacked change (n,) as a share of range: per view one number per run."""
        parts = self._seen(change)
        joined = np.concatenate(parts)
        left = joined - self._base @ (self._base.T @ joined)
        edges = np.cumsum([part.size for part in parts])[:-1]
        sizes = np.array([np.linalg.norm(part) for part in np.split(left, edges)])
        views = self._experiment.system.views
        return dict(zip(views, sizes.reshape(len(views), -1), strict=True))

    def _seen(self, change: Array) -> list[Array]:
        """One part per view and run, its squares adding up to the mean square share of range."""
        experiment = self._experiment
        return [
            seen * experiment.root_weights(run, view) / experiment.view_ranges[view]
            for view in experiment.system.views
            for run, seen in zip(
                experiment.runs, experiment.view_residuals(change, view), strict=True
            )
        ]


def orthonormal(columns: Array) -> Array:
    """Orthonormal basis of columns, by a Gram matrix with its weak directions left out."""
    if columns.shape[1] == 0:
        return columns
    scale = np.sqrt((columns**2).sum(axis=0))
    scaled = columns / np.where(scale > 0.0, scale, 1.0)
    values, vectors = np.linalg.eigh(scaled.T @ scaled)
    kept = values > 1e-10 * max(float(values[-1]), 1e-300)
    return np.asarray(scaled @ (vectors[:, kept] / np.sqrt(values[kept])))
