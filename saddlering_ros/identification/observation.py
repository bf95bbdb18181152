"""Observations of an identification: plateau readings of static, block means of dynamic runs.

Both are an `Observation`: loads, displacement increments since zero, and the covariance of their
errors. All further code treats static and dynamic runs in the same way.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import cholesky
from scipy.linalg.blas import dtrmm

from saddlering_ros.estimation.whitening import SharedErrors, Whitener

Array = NDArray[np.float64]


@dataclass(frozen=True)
class LoadErrors:
    """M independent errors of a run's load of unit variance, in its readings and simulation.

    answers (M, 3, N): change of simulated increments by each error; loads (M, N) [N]: each
    error at the times of the readings; at_zero (M,) [N]: at the zero.
    """

    answers: Array
    loads: Array
    at_zero: Array

    @classmethod
    def of(
        cls, covariance: Array, answers: Array, in_zero: Array, at_zero: Array
    ) -> LoadErrors | None:
        """Errors of covariance (M, M) at M times, of which the first N are those of the readings.

        answers (3, N, M): change by each error; in_zero (M,): its share in the load of the
        zero; at_zero (3,): change of the zero by that load. None if these are not finite.
        """
        if not (np.all(np.isfinite(answers)) and np.all(np.isfinite(at_zero))):
            return None
        root = cholesky(covariance, lower=True)
        increments = answers - at_zero[:, None, None] * in_zero
        # The product with a triangle takes half of the time of one with a whole matrix.
        each = dtrmm(1.0, root.T, increments.reshape(-1, root.shape[0]).T)
        return cls(each.reshape(-1, *answers.shape[:2]), root[:answers.shape[1]].T,
                   in_zero @ root)


@dataclass(frozen=True)
class Observation:
    """One run, ready to be fitted.

    time [s] and load [N] (N,); zero_load [N]; displacement (3, N) increments since zero
    [m, m, rad]; branch (N,) +1 loading, -1 unloading, 0 neither; whitening turns each channel's
    noise into uncorrelated noise of unit variance, 0 where a reading is missing; correlation
    (3, 3) of these across channels; zero_error (3,): standard deviation of the zero, an error that
    all readings share; standard_error (3, N) of each reading, that of the zero included. A dynamic
    run is simulated on its finer grid, fine_time and fine_load (N * per_block,), and averaged over
    blocks of per_block; a static one likewise, averaged over spans (N, 2), start and stop of each
    plateau in the grid, since rings of much damping have not come to rest there. Without spans its
    readings are equilibria.
    load_errors: effect of the load cell's noise on it.
    doubtful_lag [s]: largest delay between load and probes that the readings leave open.
    longest_step [s] of the simulation; None leaves it to the fit.
    """

    name: str
    dynamic: bool
    elevation: float
    time: Array
    load: Array
    zero_load: float
    displacement: Array
    branch: Array
    whitening: tuple[Whitener, ...]
    correlation: Array
    zero_error: Array
    standard_error: Array
    fine_time: Array
    fine_load: Array
    per_block: int = 1
    spans: NDArray[np.intp] | None = None
    load_errors: LoadErrors | None = None
    doubtful_lag: float = 0.0
    longest_step: float | None = None

    def coarse(self, longest_step: float | None = None) -> Observation:
        """The same run, simulated at its readings only, which is enough for a swarm."""
        return replace(self, fine_time=self.time, fine_load=self.load, per_block=1, spans=None,
                       longest_step=longest_step)

    def at_rest(self, settling: Array) -> Observation:
        """A static run simulated by equilibria.

        settling (3, N): means of the moving ring on the plateaus minus equilibria; it is
        subtracted from the readings.
        """
        return replace(self.coarse(), displacement=self.displacement - settling)

    def with_load_less(self, errors: Array) -> Observation:
        """A dynamic run with its load corrected by errors (M + 3,) as in `shared_errors`.

        Their change of its increments is subtracted from the measured ones, so that a
        linear model keeps its residuals.
        """
        if self.load_errors is None or not self.dynamic:
            return self
        errors = errors[:len(self.load_errors.answers)]
        wrong = errors @ self.load_errors.loads
        return replace(
            self,
            displacement=self.displacement - np.tensordot(errors, self.load_errors.answers, 1),
            load=self.load - wrong,
            fine_load=self.fine_load - np.interp(self.fine_time, self.time, wrong),
            zero_load=self.zero_load - float(errors @ self.load_errors.at_zero),
        )

    def whiten(self, residuals: Array, channels: Sequence[int]) -> Array:
        """Residuals (B, C * N) of raw ones (B, C, N) for the given channels, with white noise.

        Errors of zero and load, which readings share, are still in them.
        """
        rows = np.array(residuals.transpose(1, 2, 0), order='C')
        for row, channel in zip(rows, channels, strict=True):
            self.whitening[channel].whiten_in_place(row)
        count, size, batch = rows.shape
        apart = self._unmixing(tuple(channels)) @ rows.reshape(count, -1)
        return np.ascontiguousarray(apart.reshape(count * size, batch).T)

    def _unmixing(self, channels: tuple[int, ...]) -> Array:
        """Matrix (C, C) that makes whitened channels uncorrelated, computed once."""
        known = self._unmixings.get(channels)
        if known is None:
            lower = cholesky(self.correlation[np.ix_(channels, channels)], lower=True)
            known = self._unmixings[channels] = np.linalg.inv(lower)
        return known

    @cached_property
    def _unmixings(self) -> dict[tuple[int, ...], Array]:
        return {}

    def shared_errors(self, channels: Sequence[int]) -> SharedErrors:
        """Errors of the load, and then of the zero, that the whitened residuals share."""
        parts = [] if self.load_errors is None else [self.load_errors.answers]
        if np.any(self.zero_error):
            root = cholesky(self.correlation, lower=True) * self.zero_error[:, None]
            parts.append(np.repeat(root.T[:, :, None], self.time.size, axis=2))
        if not parts:
            return SharedErrors.none(len(channels) * self.time.size)
        answers = np.concatenate(parts)[:, list(channels)]
        return SharedErrors.of_many(self.whiten(answers, channels).T)

    def readings(self, channel: int) -> int:
        """Number of readings of a channel that are not missing."""
        return int(np.count_nonzero(self.whitening[channel].present))
