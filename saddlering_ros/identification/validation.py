"""Prediction of given runs by given parameters, channel by channel, compared with the noise.

A dynamic run is compared sample by sample. A static run is compared at its plateaus (settled
samples for rmse and noise floor, plateau means for the shape figures), because the load moves
faster in between than the recorder samples.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, field
import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from saddlering_ros.bags import refuse_repeats
from saddlering_ros.estimation.noise import (
    LEVEL_REACH,
    noise_alone,
    noise_by_class,
    NoiseRecord,
    parity_ratios,
    RestSource,
)
from saddlering_ros.estimation.process import ChannelNoise, EstimationError, QUIET
from saddlering_ros.estimation.rest import RestSegment, stretches_at_rest
from saddlering_ros.files import Origin, Provenance
from saddlering_ros.identification.checks import run_name
from saddlering_ros.identification.errors import IdentificationError
from saddlering_ros.identification.prepared import MIN_REST, parity_at_rest
from saddlering_ros.identification.rating import rate
from saddlering_ros.record.errors import BagError
from saddlering_ros.record.measured import displacement_of_run, MeasuredRun
from saddlering_ros.record.plateaus import plateaus
from saddlering_ros.record.record import Record
from saddlering_ros.rig import CHANNELS, Displacement, PARAMETER_NAMES, ParameterSet, Rig
from saddlering_ros.ring import simulate, static_batch

Array = NDArray[np.float64]
Spans = list[tuple[int, int]]

MAX_ZERO_ERROR = 3.0
"""Largest mean residual, in standard errors of the zero, that the zero explains."""

LAG = 3
"""Samples over which a step of the residual at rest is taken, because neighbours share stamps."""

UNITS = {'delta_x': 'm', 'delta_y': 'm', 'gamma': 'rad', 'parity': 'm'}


@dataclass(frozen=True)
class ChannelFigures:
    """Figures of one channel of one run; simulated against measured, in the channel's unit.

    range: highest less lowest reading measured (plateau means, or smoothed samples).
    zero_error: the part of the residual that is put down to the zero, a short reading with a noise
    of its own: the mean residual, at most three times the standard error of the zero.
    rmse: root mean square residual over the compared samples, less zero_error; nrmse and
    noise_floor: rmse and rms noise over the range. maximum: largest residual; bias: mean of
    measured - simulated, zero_error included, as in all that follow;
    slope_ratio: slope of measured over simulated; loop_area: measured minus simulated area of the
    loop over load, as a share of load range times channel range; zero_return: residual left at
    the end; time_shift [s]: how much later the measurement is (None for a static run);
    iso18571: overall rating 0..1; comparison_error E and validation uncertainty u_val after ASME
    V&V 20 (noise and zero of the readings, covariance of the parameters), and E over u_val.
    None means that a figure has no meaning, for instance for the parity, which is not simulated.
    """

    unit: str
    range: float
    zero_error: float
    rmse: float
    nrmse: float | None
    noise_floor: float | None
    maximum: float
    bias: float
    slope_ratio: float | None
    loop_area: float | None
    loop_area_measured: float | None
    loop_area_simulated: float | None
    zero_return: float
    time_shift: float | None
    iso18571: float | None
    iso18571_parts: dict[str, float] | None
    comparison_error: float
    validation_uncertainty: float
    e_over_uval: float | None


@dataclass(frozen=True)
class RunValidation:
    """One run: its figures by channel, and their curves.

    time [s], load [N] (N,); measured and simulated (4, N) in the order of CHANNELS; compared:
    mask of the samples that count; readings of a static run: load (M,), measured and simulated
    (4, M).
    """

    name: str
    test: str
    elevation: float
    channels: dict[str, ChannelFigures]
    time: Array = field(repr=False)
    load: Array = field(repr=False)
    measured: Array = field(repr=False)
    simulated: Array = field(repr=False)
    compared: NDArray[np.bool_] = field(repr=False)
    reading_load: Array = field(repr=False)
    reading_measured: Array = field(repr=False)
    reading_simulated: Array = field(repr=False)
    notes: tuple[str, ...] = ()
    origin: Origin = field(default_factory=lambda: Origin(''))


@dataclass(frozen=True)
class Validation:
    """All runs of a validation."""

    runs: tuple[RunValidation, ...]
    parameters: ParameterSet

    def to_json(self) -> dict[str, Any]:
        """`runs` in the form of diagnose --json, each channel with all its figures."""
        contact = self.parameters.contact
        return {
            'runs': [_run_json(run) for run in self.runs],
            'parameters': {name: float(getattr(contact, name)) for name in PARAMETER_NAMES},
            'undetermined': dict(self.parameters.source.undetermined),
            'provenance': Provenance(tuple(run.origin for run in self.runs)).as_dict(),
        }


def _run_json(run: RunValidation) -> dict[str, Any]:
    return {
        'bag': run.name,
        'elevation_deg': float(np.degrees(run.elevation)),
        'test': run.test,
        'channels': {
            name: {key: _plain(value) for key, value in asdict(figures).items()}
            for name, figures in run.channels.items()
        },
        'notes': list(run.notes),
    }


def _plain(value: Any) -> Any:
    if isinstance(value, float) and not math.isfinite(value):
        return None
    return value


def validate(
    runs: Sequence[Record], rig: Rig, parameters: ParameterSet,
    before_run: Callable[[int], None] | None = None,
) -> Validation:
    """Compare simulation and measurement; IdentificationError if a run cannot be compared.

    before_run is called with the index of each run; an exception ends the validation.
    """
    if not runs:
        raise IdentificationError('no runs to validate on: give at least one bag')
    refuse_repeats(runs)
    compared = []
    for number, run in enumerate(runs):
        if before_run is not None:
            before_run(number)
        compared.append(_compare(run, rig, parameters))
    noise = _noise_of(compared)
    return Validation(
        tuple(one.judged(rig, parameters, own) for one, own in zip(compared, noise, strict=True)),
        parameters)


@dataclass(frozen=True)
class _Comparison:
    """A run beside its simulation, without figures; rests: its stretches at rest.

    channels: those that are measured, all but the parity if a radial probe is absent.
    """

    run: RunValidation
    measured: MeasuredRun
    rests: Spans
    channels: tuple[str, ...]

    @property
    def interval(self) -> float:
        """Usual spacing of the samples [s]."""
        return float(np.median(np.diff(self.run.time)))

    def quiet(self) -> RestSource:
        """Noise of the channels of the run."""
        rows = slice(len(self.channels))
        residual = self.run.measured[rows] - self.run.simulated[rows]
        segments = [residual[:, start:stop] for start, stop in self.rests]
        segments = [part[:, np.all(np.isfinite(part), axis=0)] for part in segments]
        segments = [part for part in segments if part.shape[1] >= MIN_REST]
        rests = [RestSegment(part, self.interval) for part in segments]
        parity = parity_at_rest(self.measured)
        ratios = parity_ratios([parity], [parity[a:b] for a, b in self.rests], segments)
        if ratios is None:
            return RestSource(rests)
        whole = RestSegment(parity[None, :], self.interval)
        return RestSource(rests, record=NoiseRecord([whole], ratios))

    def judged(
        self, rig: Rig, parameters: ParameterSet, noise: Sequence[ChannelNoise]
    ) -> RunValidation:
        """The run with all its figures."""
        zero = self.measured.zero
        variance = _input_variance(rig, parameters, self.run, zero.load)
        lasting = self.interval * max(1, zero.end - zero.start)
        for position, (channel, own) in enumerate(zip(self.channels, noise, strict=True)):
            self.run.channels[channel] = _figures(
                self.run, position, self.rests, own, self.interval, lasting, variance[position])
        return self.run


def _noise_of(compared: Sequence[_Comparison]) -> list[Sequence[ChannelNoise]]:
    """Noise of the channels of each run.

    Runs whose parity is noise alone share their knowledge of slow noise. In other runs the
    misfit of the model may move a channel at rest, so that each run has its own noise.
    """
    shown = [one.quiet() for one in compared]
    count = len(compared[0].channels)
    silent = {number: quiet for number, quiet in enumerate(shown)
              if quiet.record is not None and quiet.is_usable}
    learnt = noise_by_class(silent, count, LEVEL_REACH) if silent else {}
    return [learnt[number] if number in learnt else _alone(quiet, count)
            for number, quiet in enumerate(shown)]


def _alone(quiet: RestSource, count: int) -> list[ChannelNoise]:
    answers = []
    for row in range(count):
        own = [segment.values[row] for segment in quiet.segments]
        try:
            answers.append(noise_alone(own, quiet.segments[0].step if own else 1.0))
        except EstimationError:
            answers.append(QUIET)
    return answers


def _compare(run: Record, rig: Rig, parameters: ParameterSet) -> _Comparison:
    name = run_name(run)
    run = run.without_spikes()
    try:
        measured = displacement_of_run(rig, run)
        found = plateaus(run) if run.test == 'static' else None
    except BagError as problem:
        raise IdentificationError(f'{name}: {problem}') from problem
    actual = _stack(measured.displacement)
    simulated = _simulated(rig, parameters, run, measured)
    channels = CHANNELS[:-1] if rig.probes.absent else CHANNELS
    known = np.all(np.isfinite(actual + simulated)[:len(channels)], axis=0)
    if found is None:
        rests = stretches_at_rest(
            measured.time, measured.load, rig.limits.rest_band)
        rests = rests or [(measured.zero.start, measured.zero.end)]
        readings: Spans = []
        compared = known
    else:
        rests = readings = list(zip(found.start.tolist(), found.stop.tolist(), strict=True))
        compared = _inside(readings, len(measured.time))
        compared &= known
    if np.count_nonzero(compared) < 5:
        raise IdentificationError(
            f'{name}: fewer than 5 samples can be compared: check that load and probes overlap'
        )
    result = RunValidation(
        name=name, test=run.test, elevation=float(run.elevation), channels={},
        time=measured.time, load=measured.load, measured=actual, simulated=simulated,
        compared=compared,
        reading_load=_means(measured.load[None, :], readings)[0],
        reading_measured=_means(actual, readings),
        reading_simulated=_means(simulated, readings),
        notes=(*run.notes, *(
            () if measured.zero.near_preload else ('the record does not start near preload',))),
        origin=run.origin,
    )
    return _Comparison(result, measured, rests, channels)


def _stack(motion: Displacement) -> Array:
    return np.stack([np.asarray(getattr(motion, name), dtype=float) for name in CHANNELS])


def _simulated(rig: Rig, parameters: ParameterSet, run: Record, measured: MeasuredRun) -> Array:
    """Simulated channels (4, N) at the measured times."""
    out = simulate(rig, parameters, run.elevation, measured.time, measured.load)
    values = _stack(out.displacement)
    if values.shape[1] == len(measured.time) and np.array_equal(out.time, measured.time):
        return values
    return np.stack(
        [np.interp(measured.time, out.time, row, left=np.nan, right=np.nan) for row in values]
    )


def _inside(spans: Spans, samples: int) -> NDArray[np.bool_]:
    mask = np.zeros(samples, dtype=bool)
    for start, stop in spans:
        mask[start:stop] = True
    return mask


def _means(values: Array, spans: Spans) -> Array:
    """Means (C, M) over spans of values (C, N); NaN of an unknown parity."""
    if not spans:
        return np.zeros((len(values), 0))
    means = np.full((len(values), len(spans)), np.nan)
    there = np.isfinite(values).any(axis=1)
    means[there] = np.stack(
        [np.nanmean(values[there, start:stop], axis=1) for start, stop in spans], axis=1)
    return means


def _input_variance(
    rig: Rig, parameters: ParameterSet, run: RunValidation, zero_load: float
) -> Array:
    """Mean square uncertainty (4,) of the prediction from the parameters' covariance.

    From static sensitivities at about 25 loads of the run; zero where no covariance is given.
    """
    covariance = parameters.source.covariance
    variance = np.zeros(len(CHANNELS))
    if covariance is None or not np.all(np.isfinite(covariance)):
        return variance
    contact = parameters.contact.to_array()
    steps = np.diag(1e-4 * contact)
    loads = np.quantile(run.load[run.compared], np.linspace(0.0, 1.0, 25))
    still = static_batch(
        rig, np.concatenate([contact + steps, contact - steps]), run.elevation,
        np.append(loads, zero_load),
    )
    increments = still[:, :, :-1] - still[:, :, -1:]
    slopes = (increments[:6] - increments[6:]) / (2.0 * np.diag(steps))[:, None, None]
    determined = [PARAMETER_NAMES.index(name) for name in ('K1', 'n1', 'K2', 'n2')]
    inner = covariance[np.ix_(determined, determined)]
    spread = np.einsum('icl,ij,jcl->cl', slopes[determined], inner, slopes[determined])
    variance[:3] = np.mean(np.maximum(spread, 0.0), axis=1)
    return variance


def _figures(
    run: RunValidation, position: int, rests: Spans, noise: ChannelNoise, step: float,
    zero_lasting: float, input_variance: float,
) -> ChannelFigures:
    measured, simulated = run.measured[position], run.simulated[position]
    residual = measured - simulated
    compared = run.compared
    static = run.reading_load.size > 0
    if static:
        shape_load, shape_measured = run.reading_load, run.reading_measured[position]
        shape_simulated = run.reading_simulated[position]
    else:
        shape_load, shape_measured = run.load[compared], measured[compared]
        shape_simulated = simulated[compared]
    extent = float(np.ptp(shape_measured if static else _smooth(shape_measured)))
    zero_noise = noise.deviation(zero_lasting)
    zero_error = _zero_error(residual[compared], noise, step, zero_noise)
    rmse = float(np.sqrt(np.mean((residual[compared] - zero_error) ** 2)))
    reading_noise = math.hypot(
        _noise_of_means(noise, rests, step) if static else noise.deviation(step), zero_noise)
    error = float(np.sqrt(np.mean((shape_measured - shape_simulated) ** 2)))
    uncertainty = math.hypot(reading_noise, math.sqrt(max(0.0, input_variance)))
    is_simulated = CHANNELS[position] != 'parity'
    areas = _loop_areas(shape_load, shape_measured, shape_simulated, extent)
    rating = rate(shape_measured, shape_simulated) if is_simulated else None
    return ChannelFigures(
        unit=UNITS[CHANNELS[position]],
        range=extent,
        zero_error=zero_error,
        rmse=rmse,
        nrmse=_ratio(rmse, extent),
        noise_floor=_ratio(_noise_of_sample(residual, rests, noise, step), extent),
        maximum=float(np.max(np.abs(shape_measured - shape_simulated))),
        bias=float(np.mean(residual[compared])),
        slope_ratio=_slope_ratio(shape_measured, shape_simulated) if is_simulated else None,
        loop_area=None if areas is None else areas[0] - areas[1],
        loop_area_measured=None if areas is None else areas[0],
        loop_area_simulated=None if areas is None else areas[1],
        zero_return=_zero_return(run, residual, rests),
        time_shift=None if static or not is_simulated else _time_shift(run, position),
        iso18571=None if rating is None else rating.overall,
        iso18571_parts=None if rating is None else asdict(rating),
        comparison_error=error,
        validation_uncertainty=uncertainty,
        e_over_uval=_ratio(error, uncertainty),
    )


def _ratio(value: float, over: float) -> float | None:
    return value / over if over > 0.0 else None


def _noise_of_sample(
    residual: Array, rests: Spans, noise: ChannelNoise, step: float
) -> float:
    """Rms noise of a sample: half the mean square step over a short lag, plus the residual there.

    Interpolation between stamps smooths readings below the fitted noise; a step over more than
    two samples is that of readings without smoothing.
    """
    steps = np.concatenate([
        residual[start + LAG:stop] - residual[start:stop - LAG] for start, stop in rests
    ] or [np.zeros(0)])
    steps = steps[np.isfinite(steps)]
    if not len(steps):
        return noise.deviation(step)
    kept = noise.lasting(LAG * step)
    return math.sqrt(0.5 * float(np.mean(steps**2)) + kept)


def _noise_of_means(noise: ChannelNoise, rests: Spans, step: float) -> float:
    """Rms noise of the means over stretches at rest."""
    lasting = step * np.array([stop - start for start, stop in rests], dtype=float)
    return math.sqrt(float(np.mean(noise.variances(lasting)))) if rests else 0.0


def _zero_error(
    residual: Array, noise: ChannelNoise, step: float, zero_noise: float
) -> float:
    """Error of the zero from the mean of a residual (N,), within the limits of its noise."""
    own = noise.deviation(step * len(residual)) ** 2
    share = zero_noise**2 / max(zero_noise**2 + own, 1e-300)
    limit = MAX_ZERO_ERROR * zero_noise
    return float(np.clip(share * np.mean(residual), -limit, limit))


def _smooth(samples: Array) -> Array:
    """Running mean of samples over 0.5 % of the record."""
    if len(samples) <= 400:
        return samples
    width = len(samples) // 200
    return np.convolve(samples, np.ones(width) / width, mode='valid')


def _slope_ratio(measured: Array, simulated: Array) -> float | None:
    centred = simulated - simulated.mean()
    size = float(centred @ centred)
    return float(centred @ measured) / size if size > 0.0 else None


def _loop_areas(
    load: Array, measured: Array, simulated: Array, extent: float
) -> tuple[float, float] | None:
    """Areas of both loops over load, positive when the unloading branch lies above."""
    box = extent * float(np.max(load) - np.min(load))
    if box <= 0.0:
        return None
    return _closed_area(load, measured) / box, _closed_area(load, simulated) / box


def _closed_area(load: Array, values: Array) -> float:
    steps = np.diff(load, append=load[0])
    mean = 0.5 * (values + np.roll(values, -1))
    return float(-np.sum(mean * steps))


def _zero_return(run: RunValidation, residual: Array, rests: Spans) -> float:
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
