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
        self._edges = np.cumsum([
            run.time.size for _ in experiment.system.views for run in experiment.runs])[:-1]
        self._base = orthonormal(self._seen(base_plain))

    def beyond_base(self, change: Array) -> float:
        """Largest rms over runs and views of a stacked change (n,), as a share of range."""
        return float(self.beyond_base_of_each(change[:, None])[0])

    def beyond_base_of_each(self, changes: Array) -> Array:
        """The same (B,) of stacked changes (n, B)."""
        return np.asarray(self._sizes(changes).max(axis=0))

    def by_run(self, change: Array) -> dict[str, Array]:
        """Rms of a stacked change (n,) as a share of range: per view one number per run."""
        views = self._experiment.system.views
        sizes = self._sizes(change[:, None])[:, 0].reshape(len(views), -1)
        return dict(zip(views, sizes, strict=True))

    def _sizes(self, changes: Array) -> Array:
        """Rms (V R, B) of stacked changes (n, B) per view and run."""
        joined = self._seen(changes)
        left = joined - self._base @ (self._base.T @ joined)
        return np.array([np.linalg.norm(part, axis=0) for part in np.split(left, self._edges)])

    def _seen(self, changes: Array) -> Array:
        """Changes (n, B) seen in every view and run, squares adding up to a mean square share."""
        experiment = self._experiment
        return np.concatenate([
            seen * (experiment.root_weights(run, view) / experiment.view_ranges[view])[:, None]
            for view in experiment.system.views
            for run, seen in zip(
                experiment.runs, experiment.view_residuals(changes, view), strict=True
            )
        ])


def orthonormal(columns: Array) -> Array:
    """Orthonormal basis of columns, by a Gram matrix with its weak directions left out."""
    if columns.shape[1] == 0:
        return columns
    scale = np.sqrt((columns**2).sum(axis=0))
    scaled = columns / np.where(scale > 0.0, scale, 1.0)
    values, vectors = np.linalg.eigh(scaled.T @ scaled)
    kept = values > 1e-10 * max(float(values[-1]), 1e-300)
    return np.asarray(scaled @ (vectors[:, kept] / np.sqrt(values[kept])))
