"""Size of a change of the prediction, as a share of the range of a view."""

from __future__ import annotations

import numpy as np

from saddlering_ros.discrepancy.experiment import Experiment
from saddlering_ros.discrepancy.metric import Metric
from saddlering_ros.discrepancy.system import Array


def visible_falls(metric: Metric, less: Array, more: Array) -> dict[str, Array]:
    """Fall of the rms residual between two predictions (n,): per view one number per run.

    The fall is a difference of squares, as a share of the range of the view. Nuisance
    parameters are fitted to both residuals first, so that small errors of a sound system do
    not count.
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
    """Size of a change as a share of range, without noise and nuisance parameters.

    The part that the base parameters imitate, moved to the least rms over all runs and views,
    is subtracted first, because it is no misfit.
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
        """The same (B,) for stacked changes (n, B)."""
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
        """Changes (n, B) in every view and run; their squares add up to a mean square share."""
        experiment = self._experiment
        return np.concatenate([
            seen * (experiment.root_weights(run, view) / experiment.view_ranges[view])[:, None]
            for view in experiment.system.views
            for run, seen in zip(
                experiment.runs, experiment.view_residuals(changes, view), strict=True
            )
        ])


def orthonormal(columns: Array) -> Array:
    """Orthonormal basis of columns by a Gram matrix, without its weak directions."""
    if columns.shape[1] == 0:
        return columns
    scale = np.sqrt((columns**2).sum(axis=0))
    scaled = columns / np.where(scale > 0.0, scale, 1.0)
    values, vectors = np.linalg.eigh(scaled.T @ scaled)
    kept = values > 1e-10 * max(float(values[-1]), 1e-300)
    return np.asarray(scaled @ (vectors[:, kept] / np.sqrt(values[kept])))
