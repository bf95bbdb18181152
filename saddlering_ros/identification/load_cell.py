"""The load cell's noise and its effect on the readings of a run."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from saddlering_ros.estimation.noise import MIN_NOISE
from saddlering_ros.estimation.process import ChannelNoise
from saddlering_ros.estimation.record_noise import common_noise, COMMON_TIMES
from saddlering_ros.identification.observation import LoadErrors, Observation
from saddlering_ros.identification.prepared import MAX_SAMPLES, PreparedRun
from saddlering_ros.rig import ContactParameters, Rig
from saddlering_ros.ring import static_response
from saddlering_ros.ring.sensitivity import load_sensitivity

Array = NDArray[np.float64]

ANSWER_STEP = 2e-3
"""Longest step [s] in the response of a dynamic run to errors of its load."""


def slow_cell_noise(
    rig: Rig, contact: ContactParameters, runs: Sequence[PreparedRun]
) -> ChannelNoise | None:
    """Noise [N] of the load cell that the misfit of the model shares with its readings.

    At rest the ring follows the load, and the simulation follows the cell. Only plateaus are
    used, because other stretches at rest are too short.
    """
    held = [one for one in runs if one.branch is not None]
    held = [one for one in held if abs(one.interval / held[0].interval - 1.0) <= 0.05]
    loads, errors, weights = [], [], []
    for one in held:
        left = [one.explained[:, a:b] - one.displacement[:, a:b] for a, b in one.rests]
        steps = np.concatenate([np.diff(part, axis=1) for part in left], axis=1)
        precision = 1.0 / np.maximum(np.nanmean(steps**2, axis=1), MIN_NOISE**2)
        level = np.array([float(np.mean(one.measured.load[a:b])) for a, b in one.rests])
        slopes = static_slopes(rig, contact, float(one.run.elevation), level)
        for (start, stop), part, slope in zip(one.rests, left, slopes.T, strict=True):
            good = np.all(np.isfinite(part), axis=0)
            if np.count_nonzero(good) < 4:
                continue
            weights.append(float(precision @ slope**2))
            errors.append((precision * slope / weights[-1]) @ part[:, good])
            loads.append(one.measured.load[start:stop][good])
    return common_noise(loads, errors, weights, held[0].interval) if loads else None


def cell_noise(one: PreparedRun, slow: ChannelNoise | None) -> ChannelNoise:
    """Noise [N] of the load cell in a run: white by its second differences, and the slow part."""
    load = one.measured.load
    white = float(np.mean(np.diff(load, 2) ** 2)) / 6.0 if len(load) > 2 else 0.0
    wander = np.zeros(COMMON_TIMES.size) if slow is None else slow.slow
    return ChannelNoise(white * one.interval, wander, 0.0, max(1, len(load) - 2), COMMON_TIMES)


def load_errors_of(
    rig: Rig, contact: ContactParameters, one: PreparedRun, seen: Observation, noise: ChannelNoise
) -> LoadErrors | None:
    """Effect of the load cell's noise on a run; None if it cannot be computed.

    There is none if the fit keeps every sample of a long record, if the model finds no motion,
    or if the load has no noise.
    """
    zero, readings = one.measured.zero, len(seen.time)
    at_zero = static_slopes(rig, contact, seen.elevation, np.array([seen.zero_load]))[:, 0]
    if readings > 2 * MAX_SAMPLES or not noise.deviation(one.interval) > 0.0:
        return None
    if not seen.dynamic:
        slopes = static_slopes(rig, contact, seen.elevation, seen.load)
        zero_time = float(np.mean(one.measured.time[zero.start:zero.end]))
        spans = [stop - start for start, stop in [*one.rests, (zero.start, zero.end)]]
        covariance = noise.covariance(
            np.append(seen.time, zero_time), one.interval * np.array(spans, dtype=float))
        answers = slopes[:, :, None] * np.eye(readings, readings + 1)
        return LoadErrors.of(covariance, answers, np.eye(readings + 1)[-1], at_zero)
    interval = float(seen.time[-1] - seen.time[0]) / (readings - 1)
    steps = readings * max(seen.per_block, int(np.ceil(interval / ANSWER_STEP)))
    time = seen.time[0] + interval * ((np.arange(steps) + 0.5) * readings / steps - 0.5)
    load = np.interp(time, seen.fine_time, seen.fine_load)
    answers = load_sensitivity(rig, contact, seen.elevation, time, load, readings)
    first, last = one.measured.time[[zero.start, zero.end - 1]]
    in_zero = ((seen.time >= first) & (seen.time <= last)).astype(np.float64)
    covariance = noise.covariance(seen.time, np.full(readings, interval))
    return LoadErrors.of(covariance, answers, in_zero / max(1.0, in_zero.sum()), at_zero)


def static_slopes(
    rig: Rig, contact: ContactParameters, elevation: float, load: Array
) -> Array:
    """Displacement per load (3, N) [m/N, m/N, rad/N] of equilibria at loads (N,) [N]."""
    step = rig.limits.slope_step
    both = static_response(
        rig, contact.to_array(), elevation, np.concatenate([load - step, load + step]))
    below, above = np.split(both, 2, axis=1)
    return np.asarray((above - below) / (2.0 * step))
