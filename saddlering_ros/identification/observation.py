"""Observations of an identification: plateau readings of static, block means of dynamic runs.

Both are an `Observation`: loads, displacement increments since zero, and the covariance of their
errors. All further code treats static and dynamic runs in the same way.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from itertools import pairwise
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import cholesky
from scipy.linalg.blas import dtrmm
from scipy.ndimage import uniform_filter1d

from saddlering_ros.estimation.noise import MIN_NOISE
from saddlering_ros.estimation.process import Array, block_means, ChannelNoise, filled
from saddlering_ros.estimation.record_noise import common_noise, COMMON_TIMES
from saddlering_ros.estimation.whitening import build_whitener, SharedErrors, Whitener
from saddlering_ros.identification import prepared
from saddlering_ros.identification.prepared import NoiseModel, PreparedRun
from saddlering_ros.rig import ContactParameters, Rig
from saddlering_ros.ring.sensitivity import load_sensitivity
from saddlering_ros.ring.simulator import static_response
from saddlering_ros.ring.small_errors import LOAD_WANDER


class LoadErrors(NamedTuple):
    """M independent errors of a run's load of unit variance, in its readings and simulation."""

    answers: Array  # (M, 3, N) [m, m, rad]: change of simulated increments by each error
    loads: Array  # (M, N) [N]: each error at the times of the readings
    at_zero: Array  # (M,) [N]: at the zero


@dataclass(frozen=True)
class Observation:
    """One run, ready to be fitted.

    A dynamic run is simulated on its finer grid and averaged over blocks of per_block. A static
    run is averaged over spans, because a ring with much damping has not come to rest there.
    Without spans its readings are equilibria. _unmixings: matrices (C, C), by the channels, that
    make whitened channels uncorrelated.
    """

    name: str
    dynamic: bool
    elevation: float  # [rad]
    time: Array  # (N,) [s]
    load: Array  # (N,) [N]
    zero_load: float  # [N]
    displacement: Array  # (3, N) increments since zero [m, m, rad]
    parity: Array  # (N,) [m]: increments since zero, NaN where missing
    branch: Array  # (N,) +1 loading, -1 unloading, 0 neither
    whitening: tuple[Whitener, ...]  # of each channel; 0 where a reading is missing
    correlation: Array  # (3, 3) of the whitened channels
    zero_error: Array  # (3,) [m, m, rad]: standard deviation of the zero, which readings share
    standard_error: Array  # (3, N) [m, m, rad] of each reading, that of the zero included
    fine_time: Array  # (N * per_block,) [s]
    fine_load: Array  # (N * per_block,) [N]
    per_block: int = 1
    spans: NDArray[np.intp] | None = None  # (N, 2), start and stop of plateaus in the fine grid
    load_errors: LoadErrors | None = None  # effect of the load cell's noise
    doubtful_lag: float = 0.0  # [s]: largest delay between load and probes that is left open
    longest_step: float | None = None  # [s] of the simulation; None leaves it to the fit
    _unmixings: dict[tuple[int, ...], Array] = field(default_factory=dict, init=False, repr=False)

    def coarse(self, longest_step: float | None = None) -> 'Observation':
        """The same run, simulated at its readings only (for a swarm), in steps [s]."""
        return replace(self, fine_time=self.time, fine_load=self.load, per_block=1, spans=None,
                       longest_step=longest_step)

    def with_load_less(self, errors: Array) -> 'Observation':
        """A dynamic run with its load corrected by errors (M + 3,) as in `shared_errors`.

        Their effect on the increments is subtracted: a linear model keeps its residuals.
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
            zero_load=self.zero_load - float(errors @ self.load_errors.at_zero))

    def whiten(self, residuals: Array, channels: Sequence[int]) -> Array:
        """Residuals (B, C * N) of raw ones (B, C, N) for the given channels, with white noise.

        Errors of zero and load, which readings share, are still in them.
        """
        rows = np.array(residuals.transpose(1, 2, 0), order='C')
        for row, channel in zip(rows, channels, strict=True):
            self.whitening[channel].whiten_in_place(row)
        count, size, batch = rows.shape
        key = tuple(channels)
        if key not in self._unmixings:
            lower = cholesky(self.correlation[np.ix_(channels, channels)], lower=True)
            self._unmixings[key] = np.linalg.inv(lower)
        apart = self._unmixings[key] @ rows.reshape(count, -1)
        return np.ascontiguousarray(apart.reshape(count * size, batch).T)

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


SETTLING_STEP = 0.1
"""Step [s] of the simulation of a static run with settling."""


def observe_prepared(runs: Sequence[PreparedRun], fit_rate: float | None) -> list[Observation]:
    """Observations without the noise of the load cell: a damped ring follows it at once.

    The noise is estimated from all runs of one sampling rate together.
    """
    return [
        _observe_static(one, noise) if one.branch is not None
        else _observe_dynamic(one, noise, fit_rate)
        for one, noise in zip(runs, prepared.noise_of(runs), strict=True)]


def observe_with_cell(runs: Sequence[PreparedRun], rig: Rig, fit_rate: float | None,
                      contact: ContactParameters) -> list[Observation]:
    """Observations with the noise of the load cell, evaluated at a first result."""
    explained = [one.explained_by(rig, contact) for one in runs]
    observed = observe_prepared(explained, fit_rate)
    cell = slow_cell_noise(rig, contact, explained)
    slow = np.zeros(COMMON_TIMES.size) if cell is None else cell.slow.copy()
    # With an exact cell, D answers to each small friction and creep of a rig.
    slow[-1] += max(0.0, (LOAD_WANDER * rig.full_scale_load) ** 2 - slow.sum())
    answers = []
    for one, seen in zip(explained, observed, strict=True):
        # Noise [N] of the cell: white by the second differences of the load, and the slow part.
        load = one.measured.load
        white = float(np.mean(np.diff(load, 2) ** 2)) / 6.0 if len(load) > 2 else 0.0
        noise = ChannelNoise(white * one.interval, slow, 0.0, max(1, len(load) - 2), COMMON_TIMES)
        answers.append(replace(seen, load_errors=load_errors_of(rig, contact, one, seen, noise)))
    return answers


def _observe_static(one: PreparedRun, noise: NoiseModel) -> Observation:
    measured = one.measured
    plateaus = [slice(start, stop) for start, stop in one.rests]
    lasting = one.interval * np.array([stop - start for start, stop in one.rests], dtype=float)
    step = max(1, int(round(SETTLING_STEP / one.interval)),
               -(-len(measured.load) // prepared.MAX_SIMULATED))
    # Start and stop (N, 2) of each plateau among blocks of `step` samples, at least one each.
    edges = np.array(one.rests, dtype=np.intp)
    starts = np.minimum(-(-edges[:, 0] // step), len(measured.load) // step - 1)
    spans = np.stack([starts, np.maximum(edges[:, 1] // step, starts + 1)], axis=1)
    return _observation(
        one, noise, np.array([float(np.mean(measured.time[span])) for span in plateaus]),
        np.array([float(np.nanmean(measured.load[span])) for span in plateaus]),
        np.stack([np.nanmean(_channels(one)[:, span], axis=1) for span in plateaus], axis=1),
        np.asarray(one.branch), lasting, block_means(measured.time, step),
        block_means(measured.load, step), spans=spans)


def _observe_dynamic(one: PreparedRun, noise: NoiseModel, fit_rate: float | None) -> Observation:
    measured = one.measured
    good = np.all(np.isfinite(one.displacement), axis=0)
    first, last = int(np.argmax(good)), len(good) - int(np.argmax(good[::-1]))
    inside = slice(*np.searchsorted(one.rows, [first, last]).tolist())
    rows, time = one.rows[inside], one.time[inside]
    size, per_block = prepared.block_sizes(one.interval, rows.size, fit_rate)
    load = block_means(measured.load[rows], size)
    means = block_means(np.take(_channels(one), rows, axis=1), size)
    fine = load.size * per_block
    seen = _observation(
        one, noise, block_means(time, size), load, means, np.sign(np.gradient(load)),
        np.full(load.size, size * one.interval), block_means(time, size // per_block)[:fine],
        block_means(one.load[rows], size // per_block)[:fine])
    return replace(seen, dynamic=True, displacement=filled(means[:3]), per_block=per_block,
                   doubtful_lag=one.run.doubtful_lag)


def _channels(one: PreparedRun) -> Array:
    """Displacement and parity (4, N), which is zero if a radial probe is absent; NaN: missing."""
    parity = np.nan_to_num(np.asarray(one.measured.displacement.parity))
    parity[~np.isfinite(one.displacement[0])] = np.nan
    return np.vstack([one.displacement, parity])


def _observation(one: PreparedRun, noise: NoiseModel, time: Array, load: Array, channels: Array,
                 branch: Array, lasting: Array, fine_time: Array, fine_load: Array,
                 spans: NDArray[np.intp] | None = None) -> Observation:
    """An observation of readings (4, N) that are means over `lasting` (N,) [s]; NaN: missing."""
    displacement, parity = channels[:3], channels[3]
    zero = one.measured.zero
    # The zero is a mean over its window.
    window = one.interval * max(1, zero.end - zero.start)
    zero_error = np.array([channel.deviation(window) for channel in noise.channels])
    error = np.sqrt([channel.variances(lasting) for channel in noise.channels])
    return Observation(
        name=str(one.run.path), dynamic=False, elevation=float(one.run.elevation),
        time=time, load=load, zero_load=zero.load, displacement=displacement, parity=parity,
        branch=branch, whitening=tuple(
            build_whitener(channel, time, lasting, present=np.isfinite(row))
            for channel, row in zip(noise.channels, displacement, strict=True)),
        correlation=noise.correlation, zero_error=zero_error,
        standard_error=np.hypot(error, zero_error[:, None]), fine_time=fine_time,
        fine_load=fine_load, spans=spans)


ANSWER_STEP = 2e-3
"""Longest step [s] in the response of a dynamic run to errors of its load."""

PAUSE = 10.0
"""Distance of two readings, in usual ones, from which on they are read about a pause."""

FOLLOWED = 1.0
"""Time [s] over which the mean motion of a ring follows the load at once."""


def slow_cell_noise(rig: Rig, contact: ContactParameters,
                    runs: Sequence[PreparedRun]) -> ChannelNoise | None:
    """Noise [N] of the load cell that the misfit of the model shares with its readings.

    At rest the ring follows the load, and the simulation follows the cell. Only plateaus are
    used, because other stretches at rest are too short.
    """
    held = [one for one in runs if one.branch is not None]
    held = [one for one in held if abs(one.interval / held[0].interval - 1.0) <= 0.05]
    loads, errors, weights = [], [], []
    for one in held:
        left = [one.explained[:, a:b] - one.displacement[:, a:b] for a, b in one.rests]
        steps = np.concatenate([np.diff(residual, axis=1) for residual in left], axis=1)
        precision = 1.0 / np.maximum(np.nanmean(steps**2, axis=1), MIN_NOISE**2)
        level = np.array([float(np.mean(one.measured.load[a:b])) for a, b in one.rests])
        slopes = static_slopes(rig, contact, float(one.run.elevation), level)
        count = max(1, round(FOLLOWED / one.interval))
        for (start, stop), residual, slope in zip(one.rests, left, slopes.T, strict=True):
            # The simulation follows fast noise late, which would look like slow noise.
            load = one.measured.load[start:stop]
            fast = slope[:, None] * load - one.explained[:, start:stop]
            residual = residual + fast - uniform_filter1d(fast, count, mode='nearest')
            good = np.all(np.isfinite(residual), axis=0)
            if np.count_nonzero(good) < 4:
                continue
            weights.append(float(precision @ slope**2))
            errors.append((precision * slope / weights[-1]) @ residual[:, good])
            loads.append(load[good])
    return common_noise(loads, errors, weights, held[0].interval) if loads else None


def load_errors_of(rig: Rig, contact: ContactParameters, one: PreparedRun, seen: Observation,
                   noise: ChannelNoise) -> LoadErrors | None:
    """Effect of the load cell's noise on a run; None if it cannot be computed.

    That is so for every sample of a long record, a model without motion, a load without noise.
    """
    zero, readings = one.measured.zero, len(seen.time)
    at_zero = static_slopes(rig, contact, seen.elevation, np.array([seen.zero_load]))[:, 0]
    if readings > 2 * prepared.MAX_SAMPLES or not noise.deviation(one.interval) > 0.0:
        return None
    # Change (3, N, M) of the readings by an error at each of M times, of which the first N are
    # theirs; in_zero (M,): its share in the load of the zero.
    if not seen.dynamic:
        slopes = static_slopes(rig, contact, seen.elevation, seen.load)
        zero_time = float(np.mean(one.measured.time[zero.start:zero.end]))
        spans = [stop - start for start, stop in [*one.rests, (zero.start, zero.end)]]
        covariance = noise.covariance(
            np.append(seen.time, zero_time), one.interval * np.array(spans, dtype=float))
        answers = slopes[:, :, None] * np.eye(readings, readings + 1)
        in_zero = np.eye(readings + 1)[-1]
    else:
        apart = np.diff(seen.time)
        pauses = np.flatnonzero(apart > PAUSE * np.median(apart))
        going = float(seen.time[-1] - seen.time[0]) - float(apart[pauses].sum())
        interval = going / (readings - 1 - pauses.size)
        finer = max(seen.per_block, int(np.ceil(interval / ANSWER_STEP)))
        answers = np.zeros((3, readings, readings))
        edges = [0, *(pauses + 1).tolist(), readings]
        for start, stop in pairwise(edges):
            count, steps = stop - start, (stop - start) * finer
            if count > 1:  # What an error before a pause moves is at rest after it.
                time = seen.time[start] + interval * (
                    (np.arange(steps) + 0.5) * count / steps - 0.5)
                load = np.interp(time, seen.fine_time, seen.fine_load)
                answers[:, start:stop, start:stop] = load_sensitivity(
                    rig, contact, seen.elevation, time, load, count)
        first, last = np.interp([zero.start, zero.end - 1], one.rows, one.time)
        in_zero = ((seen.time >= first) & (seen.time <= last)).astype(np.float64)
        in_zero = in_zero / max(1.0, in_zero.sum())
        covariance = noise.covariance(seen.time, np.full(readings, interval))
    if not (np.all(np.isfinite(answers)) and np.all(np.isfinite(at_zero))):
        return None
    root = cholesky(covariance, lower=True)
    increments = answers - at_zero[:, None, None] * in_zero
    # The product with a triangle takes half of the time of one with a whole matrix.
    each = dtrmm(1.0, root.T, increments.reshape(-1, root.shape[0]).T)
    return LoadErrors(each.reshape(-1, *answers.shape[:2]), root[:readings].T, in_zero @ root)


def static_slopes(rig: Rig, contact: ContactParameters, elevation: float, load: Array) -> Array:
    """Displacement per load (3, N) [m/N, m/N, rad/N] of equilibria at loads (N,) [N]."""
    step = rig.limits.slope_step
    both = static_response(
        rig, contact.to_array(), elevation, np.concatenate([load - step, load + step]))
    below, above = np.split(both, 2, axis=1)
    return np.asarray((above - below) / (2.0 * step))
