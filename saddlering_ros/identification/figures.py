"""Figures of one run of a validation: simulated against measured, channel by channel.

The objective rating of two signals (corridor, phase, magnitude and slope) has the formulas and
constants of ISO/TS 18571:2014 (metric R = 0.4 Z + 0.2 E_P + 0.2 E_M + 0.2 E_S). The standard
requires 10 kHz and 1 ms averages of the slope; signals here are resampled to at most LONGEST
points over the compared span, and the slope is averaged over SLOPE_POINTS of them.
"""

from dataclasses import asdict, dataclass, field
import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from saddlering_ros.compiled import Compiler
from saddlering_ros.estimation.process import Array, ChannelNoise
from saddlering_ros.estimation.rest import Stretches
from saddlering_ros.files import Origin
from saddlering_ros.quantities import finite_json
from saddlering_ros.rig import CHANNELS

LONGEST, SLOPE_POINTS = 400, 9
"""Points of a rated signal, because the cost of time warping grows with their square; and points
over which its slope is averaged, as many as the standard's 1 ms at 10 kHz."""

INNER_CORRIDOR, OUTER_CORRIDOR = 0.05, 0.50
MAX_SHIFT = 0.2
MAX_MAGNITUDE_ERROR = 0.5
MAX_SLOPE_ERROR = 2.0
WARPING_WINDOW = 0.1
"""Constants of the standard: half widths of the corridors and window of the time warping as shares
of the highest reference and of the length; errors of shift, magnitude and slope that score 0."""

MAX_ZERO_ERROR = 3.0
"""Largest mean residual, in standard errors of the zero, that the zero explains."""

MAX_NOISE = 0.1
"""Largest noise over the range of a channel with which slope, loop, delay and rating of its curve
say something: a prediction without error is rated 0.8 or more up to a noise of 0.1. Slope and
delay are relative to the simulated curve, whose range has the same limit."""

MIN_RATED = 10
"""Smallest number of points of a rated curve: one more than the mean of a slope takes."""

LAG = 3
"""Samples over which a step of the residual at rest is taken, because neighbours share stamps."""


@dataclass(frozen=True)
class ChannelFigures:
    """Figures of one channel of one run; simulated against measured, in the channel's unit.

    None means that a figure has no meaning: of the parity, which is not simulated, and of the
    curve of a channel that hardly moves more than its noise, or hardly would by the simulation.
    E and u_val: ASME V&V 20 (noise and zero of the readings, covariance of the parameters, small
    errors of a sound ring).
    """

    unit: str
    range: float  # highest minus lowest reading measured (plateau means, or smoothed samples)
    zero_error: float  # mean residual, within three standard errors of the zero
    rmse: float  # over the compared samples, minus zero_error
    nrmse: float | None  # rmse over the range
    noise_floor: float | None  # rms noise over the range
    sound: float | None  # small errors of a sound ring over the range
    maximum: float  # largest residual
    bias: float  # mean of measured - simulated; zero_error included, as in all that follow
    slope_ratio: float | None  # slope of measured over simulated
    loop_area: float | None  # measured minus simulated area over load, as a share of both ranges
    loop_area_measured: float | None  # share of both ranges, as the next
    loop_area_simulated: float | None
    zero_return: float  # residual left at the end
    time_shift: float | None  # [s]: how much later the measurement is; None: a static run
    iso18571: float | None  # overall rating, 0 to 1
    iso18571_parts: dict[str, float] | None  # ratings of `Rating`, 0 to 1
    comparison_error: float  # E
    validation_uncertainty: float  # u_val
    e_over_uval: float | None  # E over u_val


@dataclass(frozen=True)
class RunValidation:
    """One run: its figures by channel, and their curves."""

    name: str
    test: str
    elevation: float  # [rad]
    channels: dict[str, ChannelFigures]
    time: Array = field(repr=False)  # (N,) [s]
    load: Array = field(repr=False)  # (N,) [N]
    measured: Array = field(repr=False)  # (4, N) in the order of CHANNELS [m, m, rad, m]
    simulated: Array = field(repr=False)  # (4, N)
    compared: NDArray[np.bool_] = field(repr=False)  # samples that count
    notes: tuple[str, ...] = ()
    origin: Origin = field(default_factory=lambda: Origin(''))

    def to_json(self) -> dict[str, Any]:
        """The form of a run in `diagnose --json`, each channel with all its figures."""
        return dict(finite_json({
            'bag': self.name,
            'elevation_deg': float(np.degrees(self.elevation)),
            'test': self.test,
            'channels': {name: asdict(figures) for name, figures in self.channels.items()},
            'notes': list(self.notes)}))


def channel_figures(run: RunValidation, position: int, rests: Stretches, noise: ChannelNoise,
                    step: float, zero_lasting: float, input_variance: float,
                    sound: float) -> ChannelFigures:
    """All figures of the channel in row `position` of a run.

    rests: stretches in which the run is at rest; noise: of the channel; step [s] of the samples;
    zero_lasting [s]: length of the zero; input_variance: mean square error of the prediction;
    sound: rms that small errors of a sound ring add.
    """
    measured, simulated = run.measured[position], run.simulated[position]
    residual = measured - simulated
    compared = run.compared
    static = run.test == 'static'
    # A static run shows its shape by the means of its plateaus.
    shape_load, shape_measured, shape_simulated = (
        np.array([np.nanmean(values[start:stop]) for start, stop in rests]) if static
        else values[compared] for values in (run.load, measured, simulated))
    smooth = shape_measured
    if not static and len(smooth) > 400:  # else 0.5 % of the record are two samples at most
        width = len(smooth) // 200  # A running mean over 0.5 % of the record.
        smooth = np.convolve(smooth, np.ones(width) / width, mode='valid')
    extent = float(np.ptp(smooth))
    zero_noise = noise.deviation(zero_lasting)
    # The mean of the residual is error of the zero, within the limits of its noise.
    of_mean = noise.deviation(step * np.count_nonzero(compared)) ** 2
    share = zero_noise**2 / max(zero_noise**2 + of_mean, 1e-300)
    limit = MAX_ZERO_ERROR * zero_noise
    zero_error = float(np.clip(share * np.mean(residual[compared]), -limit, limit))
    rmse = float(np.sqrt(np.mean((residual[compared] - zero_error) ** 2)))
    reading_noise = noise.deviation(step)
    if static:
        lasting = step * np.array([stop - start for start, stop in rests], dtype=float)
        reading_noise = math.sqrt(float(np.mean(noise.variances(lasting))))
    error = float(np.sqrt(np.mean((shape_measured - shape_simulated) ** 2)))
    uncertainty = math.hypot(
        math.hypot(reading_noise, zero_noise), math.sqrt(max(0.0, input_variance)), sound)
    is_simulated = CHANNELS[position] != 'parity'
    noise_of_sample = _noise_of_sample(residual, rests, noise, step)
    moves, is_followed = (
        (reading_noise if static else noise_of_sample) <= MAX_NOISE * motion
        for motion in (extent, float(np.ptp(shape_simulated))))
    box = extent * float(np.ptp(shape_load))
    # Areas of the loops over the load, positive where the unloading branch lies above.
    steps = np.diff(shape_load, append=shape_load[0])
    areas = [_ratio(float(-np.sum(0.5 * (values + np.roll(values, -1)) * steps)), box)
             if moves else None for values in (shape_measured, shape_simulated)]
    centred = shape_simulated - shape_simulated.mean()
    is_rated = is_simulated and moves and len(shape_measured) >= MIN_RATED
    is_sloped = is_simulated and moves and is_followed
    rating = rate(shape_measured, shape_simulated) if is_rated else None
    return ChannelFigures(
        unit='rad' if CHANNELS[position] == 'gamma' else 'm', range=extent,
        zero_error=zero_error, rmse=rmse,
        nrmse=_ratio(rmse, extent),
        noise_floor=_ratio(noise_of_sample, extent),
        sound=_ratio(sound, extent),
        maximum=float(np.max(np.abs(shape_measured - shape_simulated))),
        bias=float(np.mean(residual[compared])),
        slope_ratio=(float(centred @ shape_measured) / float(centred @ centred)
                     if is_sloped else None),
        loop_area=None if areas[0] is None or areas[1] is None else areas[0] - areas[1],
        loop_area_measured=areas[0], loop_area_simulated=areas[1],
        zero_return=_zero_return(run, residual, rests),
        time_shift=_time_shift(run, position) if is_rated and is_sloped and not static else None,
        iso18571=None if rating is None else rating.overall,
        iso18571_parts=None if rating is None else asdict(rating), comparison_error=error,
        validation_uncertainty=uncertainty, e_over_uval=_ratio(error, uncertainty))


def _ratio(value: float, over: float) -> float | None:
    return value / over if over > 0.0 else None


def _noise_of_sample(residual: Array, rests: Stretches, noise: ChannelNoise, step: float) -> float:
    """Rms noise of a sample: half the mean square step over a short lag, plus the residual there.

    Interpolation between stamps smooths neighbours; over more than two samples it does not count.
    """
    steps = np.concatenate([
        residual[start + LAG:stop] - residual[start:max(stop - LAG, start)]
        for start, stop in rests
    ] or [np.zeros(0)])
    steps = steps[np.isfinite(steps)]
    if not len(steps):
        return noise.deviation(step)
    kept = noise.lasting(LAG * step)
    return math.sqrt(0.5 * float(np.mean(steps**2)) + kept)


def _zero_return(run: RunValidation, residual: Array, rests: Stretches) -> float:
    """Residual at the end of the record: over its last stretch at rest, or its last hundredth."""
    count = max(1, len(residual) // 100)
    start = max(rests[-1][0], len(residual) - 50 * count) if rests else len(residual) - count
    stop = rests[-1][1] if rests else len(residual)
    last = residual[start:stop]
    if not np.any(np.isfinite(last)) or run.load[stop - 1] > 0.5 * np.max(run.load):
        return float('nan')
    return float(np.nanmean(last))


def _time_shift(run: RunValidation, position: int) -> float | None:
    """Least-squares delay [s] of the measurement against the simulation."""
    compared = run.compared
    time, simulated = run.time[compared], run.simulated[position][compared]
    rate_of_change = np.gradient(simulated, time)
    residual = run.measured[position][compared] - simulated
    design = np.stack([-rate_of_change, simulated, np.ones_like(simulated)], axis=1)
    size = np.linalg.norm(design, axis=0)
    if np.any(size == 0.0):
        return None
    answer, *_ = np.linalg.lstsq(design / size, residual, rcond=None)
    return float(answer[0] / size[0])


@dataclass(frozen=True, slots=True)
class Rating:
    """Scores from 0 to 1; overall above 0.94 is excellent, 0.80 good, 0.58 fair."""

    corridor: float
    phase: float
    magnitude: float
    slope: float

    @property
    def overall(self) -> float:
        """The weighted rating R."""
        return 0.4 * self.corridor + 0.2 * (self.phase + self.magnitude + self.slope)


def rate(reference: Array, signal: Array) -> Rating:
    """Rate `signal` (N,) against `reference` (N,), both on one even time grid."""
    reference, signal = _shortened(reference), _shortened(signal)
    peak = float(np.max(np.abs(reference)))
    if peak == 0.0:
        same = float(np.array_equal(reference, signal))
        return Rating(same, same, same, same)
    # The shift of the highest cross-correlation, at most a fifth of the record; 0 if none gains.
    shift, highest, largest = 0, -np.inf, int(MAX_SHIFT * len(reference))
    for tried in sorted(range(-largest, largest + 1), key=abs):
        first, second = _shifted(reference, signal, tried)
        norm = np.linalg.norm(first) * np.linalg.norm(second)
        correlation = float(first @ second / norm) if norm > 0.0 else -np.inf
        if correlation > highest + 1e-12:
            shift, highest = tried, correlation
    matched_reference, matched_signal = _shifted(reference, signal, shift)
    inner, outer = INNER_CORRIDOR * peak, OUTER_CORRIDOR * peak
    score = (outer - np.abs(reference - signal)) / (outer - inner)
    window = max(1, int(WARPING_WINDOW * len(matched_reference)))
    distance = float(_warping_distance(matched_reference, matched_signal, window))
    smooth = np.ones(SLOPE_POINTS) / SLOPE_POINTS
    first, second = (np.convolve(np.gradient(values), smooth, mode='valid')
                     for values in (matched_reference, matched_signal))
    size = float(np.sum(np.abs(first)))
    slope = float(np.array_equal(first, second)) if size == 0.0 else _score(
        float(np.sum(np.abs(first - second))) / size, MAX_SLOPE_ERROR)
    return Rating(
        corridor=float(np.mean(np.clip(score, 0.0, 1.0) ** 2)),
        phase=_score(abs(shift) / len(reference), MAX_SHIFT),
        magnitude=_score(distance / float(np.sum(np.abs(matched_reference))), MAX_MAGNITUDE_ERROR),
        slope=slope)


def _shortened(values: Array) -> Array:
    if len(values) <= LONGEST:
        return np.asarray(values, dtype=float)
    return np.interp(np.linspace(0, len(values) - 1, LONGEST), np.arange(len(values)), values)


def _score(error: float, largest: float) -> float:
    return float(max(0.0, 1.0 - error / largest))


def _shifted(reference: Array, signal: Array, shift: int) -> tuple[Array, Array]:
    """Both signals over their common span when `signal` is taken `shift` samples later."""
    if shift >= 0:
        return reference[: len(reference) - shift], signal[shift:]
    return reference[-shift:], signal[: len(signal) + shift]


@Compiler(__file__)()
def _warping_distance(reference: Array, signal: Array, window: int) -> float:
    """L1 distance along the best dynamic time warping path (squared local cost) in a window."""
    count = len(reference)
    cost = np.full((count + 1, count + 1), np.inf)
    distance = np.zeros((count + 1, count + 1))
    cost[0, 0] = 0.0
    for i in range(1, count + 1):
        for j in range(max(1, i - window), min(count, i + window) + 1):
            error = abs(reference[i - 1] - signal[j - 1])
            a, b = i - 1, j - 1
            if cost[i - 1, j] < cost[a, b]:
                a, b = i - 1, j
            if cost[i, j - 1] < cost[a, b]:
                a, b = i, j - 1
            cost[i, j] = cost[a, b] + error * error
            distance[i, j] = distance[a, b] + error
    return float(distance[count, count])
