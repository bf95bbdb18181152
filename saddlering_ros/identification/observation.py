"""What identification fits: plateau readings of static runs, block averages of dynamic ones.

Both become an `Observation`: loads, displacement increments since zero, and how their errors
hang together, so that everything after this module treats all runs alike.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import cholesky
from scipy.ndimage import uniform_filter1d

from saddlering_ros.bags import BagError, displacement_of_run, MeasuredRun, plateaus, TestRun
from saddlering_ros.identification.errors import IdentificationError
from saddlering_ros.identification.noise import (
    ChannelNoise,
    fit_common,
    fit_noise,
    NoiseModel,
    parity_ratios,
    ParityNoise,
    SMALLEST_NOISE,
)
from saddlering_ros.identification.whitening import Whitening
from saddlering_ros.rig import ContactParameters, ParameterSet, Rig
from saddlering_ros.ring import simulate, static_response
from saddlering_ros.ring.load_sensitivity import load_sensitivity

Array = NDArray[np.float64]

CHANNEL_COUNT = 3
"""delta_x, delta_y, gamma."""

MOST_SAMPLES = 1000
"""Longest fit grid of one dynamic run; longer records get a coarser grid."""

SIMULATION_RATE = 250.0
"""Rate [Hz] of the loads a dynamic run is simulated with in a fit; faster records are averaged."""

SETTLING_STEP = 0.1
"""Step [s] in which a static run is simulated where the rings' settling counts."""

FEWEST_READINGS = 5
LEAST_SEEN = 0.3
"""Plateaus of a static run, and share of a dynamic one, that all four probes must have read."""

ANSWER_STEP = 2e-3
"""Longest step [s] in which a dynamic run's answer to errors of its load is followed."""

REST_SECONDS = 0.25
SETTLING_SECONDS = 0.3
"""What counts as a stretch at rest in a dynamic run, and how long it settles after a movement."""


@dataclass(frozen=True)
class LoadErrors:
    """M independent errors of a run's load of unit variance, in its readings and simulation.

    answers (M, 3, N): what each does to simulated increments; loads (M, N) [N]: what it is at each
    reading's time; at_zero (M,) [N]: at the zero.
    """

    answers: Array
    loads: Array
    at_zero: Array

    @classmethod
    def of(
        cls, covariance: Array, answers: Array, in_zero: Array, at_zero: Array
    ) -> LoadErrors | None:
        """Errors of covariance (M, M) at M times, of which the first N are the readings'.

        answers (3, N, M): to each; in_zero (M,): its share in the zero's load; at_zero (3,): what
        that does to the zero. None where these are no numbers.
        """
        if not (np.all(np.isfinite(answers)) and np.all(np.isfinite(at_zero))):
            return None
        root = cholesky(covariance, lower=True)
        increments = answers - at_zero[:, None, None] * in_zero
        return cls((increments @ root).transpose(2, 0, 1), root[:answers.shape[1]].T,
                   in_zero @ root)


@dataclass(frozen=True)
class Observation:
    """One run, ready to be fitted.

    time [s] and load [N] (N,); zero_load [N]; displacement (3, N) increments since zero
    [m, m, rad]; branch (N,) +1 loading, -1 unloading, 0 neither; whitening turns each channel's
    errors into uncorrelated ones of unit variance; correlation (3, 3) of these across channels;
    standard_error (3, N) of each reading. A dynamic run is simulated on its finer grid,
    fine_time and fine_load (N * per_block,), and averaged over blocks of per_block; a static one
    likewise, averaged over spans (N, 2), start and stop of each plateau in the grid, since rings
    of much damping have not come to rest there. Without spans its readings are equilibria. weight
    (3, N) is 0 where a reading is missing. load_errors: what the load cell's noise does to it.
    """

    name: str
    dynamic: bool
    elevation: float
    time: Array
    load: Array
    zero_load: float
    displacement: Array
    branch: Array
    whitening: tuple[Whitening, ...]
    correlation: Array
    standard_error: Array
    fine_time: Array
    fine_load: Array
    per_block: int = 1
    spans: NDArray[np.intp] | None = None
    weight: Array | float = 1.0
    load_errors: LoadErrors | None = None

    def coarse(self) -> Observation:
        """The same run simulated at its readings alone: for a swarm, which needs no more."""
        return replace(self, fine_time=self.time, fine_load=self.load, per_block=1, spans=None)

    def with_load_less(self, errors: Array) -> Observation:
        """A dynamic run whose load is corrected by errors (M,) in units of `load_errors`.

        What these do to its increments is taken off the measured ones: where the model is linear
        its residuals stay as they were.
        """
        if self.load_errors is None or not self.dynamic:
            return self
        wrong = errors @ self.load_errors.loads
        return replace(
            self,
            displacement=self.displacement - np.tensordot(errors, self.load_errors.answers, 1),
            load=self.load - wrong,
            fine_load=self.fine_load - np.interp(self.fine_time, self.time, wrong),
            zero_load=self.zero_load - float(errors @ self.load_errors.at_zero),
        )

    def whiten(self, residuals: Array, channels: Sequence[int]) -> Array:
        """Uncorrelated residuals (B, C * N) of raw ones (B, C, N) for the given channels."""
        weight = np.broadcast_to(self.weight, (CHANNEL_COUNT, residuals.shape[-1]))
        rows = np.stack(
            [
                self.whitening[channel].apply(residuals[:, position] * weight[channel])
                for position, channel in enumerate(channels)
            ],
            axis=1,
        )
        lower = cholesky(self.correlation[np.ix_(channels, channels)], lower=True)
        mixed = np.einsum('cd,bdn->bcn', np.linalg.inv(lower), rows)
        return np.asarray(mixed.reshape(len(residuals), -1))


@dataclass(frozen=True)
class _Prepared:
    """A run with its displacement and where it is at rest (start, stop index pairs).

    load (N,) that the model is driven with; explained (3, N): what it explains of the displacement
    at rest.
    """

    run: TestRun
    measured: MeasuredRun
    displacement: Array
    load: Array
    explained: Array
    rests: list[tuple[int, int]]
    branch: Array | None
    interval: float


def observe(
    runs: Sequence[TestRun], rig: Rig, *, fit_rate: float | None,
    contact: ContactParameters | None = None,
) -> list[Observation]:
    """Observations of runs; IdentificationError where a run cannot be used to identify.

    The noise is estimated from all runs of one sampling rate together. contact: a first finding,
    by which the load cell's noise is followed as a damped ring follows it; else it is taken to
    follow at once, in proportion.
    """
    if not runs:
        raise IdentificationError('no runs to identify from: give at least one bag')
    prepared = [_prepare(run, rig, fit_rate, contact) for run in runs]
    observed = [
        _observe_dynamic(one, prepared, fit_rate)
        if one.branch is None
        else _observe_static(one, prepared, fit_rate)
        for one in prepared
    ]
    if contact is None:
        return observed
    slow = _slow_cell_noise(rig, contact, prepared)
    return [
        replace(seen, load_errors=_load_errors(rig, contact, one, seen, _cell_noise(one, slow)))
        for one, seen in zip(prepared, observed, strict=True)
    ]


def _prepare(
    run: TestRun, rig: Rig, fit_rate: float | None, contact: ContactParameters | None
) -> _Prepared:
    name = run_name(run)
    check_run(run, rig)
    try:
        measured = displacement_of_run(rig, run)
    except BagError as problem:
        raise IdentificationError(f'{name}: {problem}') from problem
    motion = measured.displacement
    displacement = np.stack([motion.delta_x, motion.delta_y, motion.gamma])
    displacement[:, np.any(saturated(run, rig), axis=0)] = np.nan
    interval = float(np.median(np.diff(measured.time)))
    size = 1 if run.test == 'static' else _block_sizes(interval, len(run.load), fit_rate)[0]
    load = _smoothed(measured.load, size)
    explained = (_load_slope(displacement, load)[:, None] * load if contact is None
                 else _simulated(rig, contact, run, measured.time, load))
    if run.test == 'static':
        found = plateaus(run)
        rests = list(zip(found.start.tolist(), found.stop.tolist(), strict=True))
        branch = np.asarray(found.branch, dtype=float)
        seen = [bool(np.mean(np.isfinite(displacement[0, a:b])) > 0.5) for a, b in rests]
        rests = [rest for rest, enough in zip(rests, seen, strict=True) if enough]
        if len(rests) < FEWEST_READINGS:
            raise IdentificationError(_clipped(name))
        return _Prepared(
            run, measured, displacement, load, explained, rests, branch[seen], interval
        )
    if np.mean(np.isfinite(displacement[0])) < LEAST_SEEN:
        raise IdentificationError(_clipped(name))
    rests = _calm_stretches(measured, rig)
    return _Prepared(run, measured, displacement, load, explained, rests, None, interval)


def _clipped(name: str) -> str:
    return (f'{name}: probes are missing or at a limit of their span in most of the record: '
            'set their gaps anew and repeat the test')


def _smoothed(load: Array, size: int) -> Array:
    """Load averaged over a block of the fit about each sample (an odd number: without delay).

    A model of little damping rings at the cell's noise, and least squares would give it damping
    until it does not; what is faster than a block is not compared anyway.
    """
    return np.asarray(uniform_filter1d(load, 2 * (size // 2) + 1, mode='nearest'))


def _load_slope(displacement: Array, load: Array) -> Array:
    """Displacement per load (3,) over the whole run: what a little load movement does at rest."""
    good = np.all(np.isfinite(displacement), axis=0)
    centred = load[good] - load[good].mean()
    return np.asarray(displacement[:, good] @ centred / (centred @ centred))


def _simulated(
    rig: Rig, contact: ContactParameters, run: TestRun, time: Array, load: Array
) -> Array:
    """Simulated displacement (3, N) of a run; NaN before its zero."""
    step = max(float(np.median(np.diff(time))), 1e-3)
    simulated = simulate(rig, ParameterSet(contact), run.elevation, time, load, step)
    motion = simulated.displacement
    rows = np.full((CHANNEL_COUNT, len(time)), np.nan)
    rows[:, simulated.first:] = np.stack([motion.delta_x, motion.delta_y, motion.gamma])
    return rows


def _calm_stretches(measured: MeasuredRun, rig: Rig) -> list[tuple[int, int]]:
    """Stretches at rest of a dynamic run to read the noise from.

    That before the first movement alone if it is long enough: after a movement the ring may still
    be creeping back long after the load has come to rest.
    """
    rests = stretches_at_rest(measured.time, measured.load, 0.625 * rig.limits.rest_band)
    if not rests:
        return [(measured.zero.start, measured.zero.end)]
    first, last = rests[0]
    long_enough = measured.time[last - 1] - measured.time[first] >= 2.0 * REST_SECONDS
    return rests[:1] if long_enough and first == 0 else rests


def run_name(run: TestRun) -> str:
    """How a run is called in messages: its path, or its name when it has none."""
    return str(run.path) if getattr(run, 'path', None) else run.name


def warnings_of(run: TestRun, rig: Rig) -> list[str]:
    """What makes a run's result doubtful without forbidding it, one line each."""
    name = run_name(run)
    warnings = [f'{name}: {note}' for note in run.notes]
    for probe, clipped in enumerate(saturated(run, rig), start=1):
        share = float(np.mean(clipped))
        if share > 0.001:
            warnings.append(
                f'{name}: probe {probe} is at a limit of its span in {100.0 * share:.1f} % of the '
                'record: that part is left out'
            )
    if not displacement_of_run(rig, run).zero.near_preload:
        warnings.append(f'{name}: it does not start near the preload, its zero is taken higher')
    return warnings


def saturated(run: TestRun, rig: Rig) -> NDArray[np.bool_]:
    """Where each probe (4, N) reads a limit of its span, so that its face may be farther."""
    margin = 1e-4 * (rig.probes.max_range - rig.probes.min_range)
    low, high = rig.probes.min_range + margin, rig.probes.max_range - margin
    with np.errstate(invalid='ignore'):
        return np.asarray((run.gaps <= low) | (run.gaps >= high))


def check_run(run: TestRun, rig: Rig) -> None:
    """IdentificationError when the run's range is too small to identify anything from."""
    name = run_name(run)
    if not np.isfinite(run.elevation):
        raise IdentificationError(f'{name}: its elevation is {run.elevation}: give it in degrees')
    if not np.all(np.isfinite(run.load)):
        raise IdentificationError(f'{name}: its load is not finite everywhere: cut the record')
    top = float(np.nanmax(run.load)) if len(run.load) else 0.0
    least = rig.limits.identification_min
    if not top > least:
        raise IdentificationError(
            f'{name}: the load never exceeds {rig.force_words(least)} (highest '
            f'{rig.force_words(top)}), a fifth of full scale '
            f'({rig.force_words(rig.full_scale_load)}'
            "): load the ring further, or correct the rig file's full_scale_load"
        )
    if run.test == 'static':
        _check_static(run, rig, name)
    elif float(np.nanmedian(run.load[-max(1, len(run.load) // 100) :])) > 0.5 * top:
        raise IdentificationError(
            f'{name}: there is no unloading branch (the record ends at '
            f'{rig.force_words(float(run.load[-1]))}): record the test until the load is off again'
        )


def _check_static(run: TestRun, rig: Rig, name: str) -> None:
    try:
        found = plateaus(run)
    except BagError as problem:
        raise IdentificationError(f'{name}: {problem}') from problem
    levels = np.unique(np.round(found.load / rig.limits.level_step))
    if len(levels) < 2:
        raise IdentificationError(
            f'{name}: a static run with one plateau only: '
            'identification needs readings at several loads'
        )
    if not np.any(np.asarray(found.branch) < 0):
        raise IdentificationError(
            f'{name}: there is no unloading branch in this static run: '
            'record the steps down to zero as well'
        )


def stretches_at_rest(time: Array, load: Array, band: float) -> list[tuple[int, int]]:
    """Index pairs of stretches of REST_SECONDS or more whose mean load stays within `band` [N]."""
    count = max(1, int(round(0.05 / max(float(np.median(np.diff(time))), 1e-6))))
    blocks = len(load) // count
    means = load[: blocks * count].reshape(blocks, count).mean(axis=1)
    fewest = max(2, int(np.ceil(REST_SECONDS / (count * float(np.median(np.diff(time)))))))
    settling = int(np.ceil(SETTLING_SECONDS / (count * float(np.median(np.diff(time))))))
    stretches = []
    start = 0
    for block in range(1, blocks + 1):
        if block < blocks and abs(means[block] - means[start]) <= band:
            continue
        begin = start + (settling if start else 0)
        end = block - 1 if block < blocks else block
        if end - begin >= fewest:
            stretches.append((begin * count, end * count))
        start = block
    return stretches


def _block_sizes(interval: float, samples: int, fit_rate: float | None) -> tuple[int, int]:
    """Samples in a block of the fit grid, and into how many simulated steps it is cut."""
    if fit_rate is None:
        return 1, 1
    size = max(1, int(round(1.0 / (fit_rate * interval))), int(np.ceil(samples / MOST_SAMPLES)))
    fine = max(1, int(round(1.0 / (SIMULATION_RATE * interval))))
    per_block = max(1, int(round(size / fine)))
    return per_block * max(1, size // per_block), per_block


def _block_means(values: Array, size: int) -> Array:
    """Means (..., M) of successive blocks of `size` samples along the last axis."""
    count = values.shape[-1] // size
    kept = values[..., : count * size]
    return np.asarray(kept.reshape(*values.shape[:-1], count, size).mean(axis=-1))


def _noise_of(runs: Sequence[_Prepared], like: _Prepared, size: int) -> NoiseModel:
    """Noise on the grid of `size` samples a block, from all runs sampled like this one.

    A dynamic run's rests are too short to show the slow part: that is taken from static runs.
    """
    alike = [one for one in runs if abs(one.interval / like.interval - 1.0) <= 0.05]
    segments = [part for one in alike for part in _rest_blocks(one, size)]
    if not segments:
        raise IdentificationError(
            f'{run_name(like.run)}: no stretch at rest of at least {4 * size} samples to read the '
            'noise from: hold the load before the ramp'
        )
    slow = None
    held = [one for one in runs if one.branch is not None]
    if held and not any(one.branch is not None for one in alike):
        count = max(1, int(round(size * like.interval / held[0].interval)))
        slow = _noise_of(held, held[0], count)
    return fit_noise(segments, size * like.interval, slow, _parity_noise(alike, size),
                     size)


def _rest_blocks(one: _Prepared, size: int) -> list[Array]:
    """Block means (3, n) of a run's stretches at rest, less what the load's movement explains.

    Only its slow movement: the rest is the cell's noise, which is none of the probes' and would
    make the channels' errors seem correlated.
    """
    width = max(1, int(round(REST_SECONDS / one.interval)))
    segments = []
    for start, stop in one.rests:
        motion, explained = one.displacement[:, start:stop], one.explained[:, start:stop]
        good = np.all(np.isfinite(motion + explained), axis=0)
        if np.count_nonzero(good) >= 4 * size:
            slow = uniform_filter1d(explained[:, good], width, axis=1, mode='nearest')
            segments.append(_block_means(motion[:, good] - slow, size))
    return segments


def _parity_noise(runs: Sequence[_Prepared], size: int) -> ParityNoise | None:
    """What the parity of runs sampled alike says about the noise, if it is that alone."""
    parities = [parity_at_rest(one.measured) for one in runs]
    still = [parity[None, start:stop] for one, parity in zip(runs, parities, strict=True)
             for start, stop in one.rests]
    channels = [part for one in runs for part in _rest_blocks(one, 1)]
    ratios = parity_ratios([parity[None, :] for parity in parities], still, channels)
    if ratios is None:
        return None
    return ParityNoise([_block_means(parity[None, :], size) for parity in parities], ratios)


def parity_at_rest(measured: MeasuredRun) -> Array:
    """Parity (N,) of a run less what follows load or time smoothly; missing values filled."""
    parity = np.asarray(measured.displacement.parity)
    good = np.isfinite(parity)
    load = measured.load / max(float(np.max(np.abs(measured.load))), 1e-9)
    time = measured.time / max(float(measured.time[-1]), 1e-9)
    design = np.stack([np.ones_like(load), load, load**2, time, time**2], axis=1)
    smooth, *_ = np.linalg.lstsq(design[good], parity[good], rcond=None)
    return _filled((parity - design @ smooth)[None, :])[0]


def _observe_static(
    one: _Prepared, runs: Sequence[_Prepared], fit_rate: float | None
) -> Observation:
    size, _ = _block_sizes(one.interval, 1, fit_rate or 50.0)
    noise = _noise_of(runs, one, size)
    measured = one.measured
    spans = [slice(start, stop) for start, stop in one.rests]
    displacement = np.stack(
        [np.nanmean(one.displacement[:, span], axis=1) for span in spans], axis=1
    )
    counts = [max(1, (stop - start) // size) for start, stop in one.rests]
    load = np.array([float(np.nanmean(measured.load[span])) for span in spans])
    time = np.array([float(np.mean(measured.time[span])) for span in spans])
    blocks = _zero_blocks(one, size)
    step = max(1, int(round(SETTLING_STEP / one.interval)))
    whitening = []
    error = []
    for channel in noise.channels:
        own = channel.covariance_of_means(time, counts)
        common = channel.variance_of_mean(blocks)
        whitening.append(Whitening.of_covariance(own, common))
        error.append(np.sqrt(np.diag(own) + common))
    return Observation(
        name=run_name(one.run), dynamic=False, elevation=float(one.run.elevation),
        time=time, load=load, zero_load=measured.zero.load,
        displacement=displacement, branch=np.asarray(one.branch),
        whitening=tuple(whitening), correlation=noise.correlation,
        standard_error=np.stack(error), fine_time=_block_means(measured.time, step),
        fine_load=_block_means(measured.load, step), spans=_grid_spans(one, step),
    )


def _grid_spans(one: _Prepared, size: int) -> NDArray[np.intp]:
    """Start and stop (N, 2) of each plateau among blocks of `size` samples, at least one each."""
    blocks = len(one.measured.load) // size
    edges = np.array(one.rests, dtype=np.intp)
    starts = np.minimum(-(-edges[:, 0] // size), blocks - 1)
    return np.stack([starts, np.maximum(edges[:, 1] // size, starts + 1)], axis=1)


def _observe_dynamic(
    one: _Prepared, runs: Sequence[_Prepared], fit_rate: float | None
) -> Observation:
    measured = one.measured
    good = np.all(np.isfinite(one.displacement), axis=0)
    first, last = int(np.argmax(good)), len(good) - int(np.argmax(good[::-1]))
    span = slice(first, last)
    size, per_block = _block_sizes(one.interval, last - first, fit_rate)
    noise = _noise_of(runs, one, size)
    time, load = measured.time[span], measured.load[span]
    means = _block_means(one.displacement[:, span], size)
    displacement = _filled(means)
    samples = displacement.shape[1]
    blocks = _zero_blocks(one, size)
    common = [channel.variance_of_mean(blocks) for channel in noise.channels]
    error = [
        np.full(samples, np.hypot(channel.standard_deviation, np.sqrt(zero)))
        for channel, zero in zip(noise.channels, common, strict=True)
    ]
    fine = samples * per_block
    mean_load = _block_means(load, size)
    return Observation(
        name=run_name(one.run), dynamic=True, elevation=float(one.run.elevation),
        time=_block_means(time, size), load=mean_load, zero_load=measured.zero.load,
        displacement=displacement, branch=np.sign(np.gradient(mean_load)),
        whitening=tuple(
            Whitening.of_process(channel, samples, zero)
            for channel, zero in zip(noise.channels, common, strict=True)
        ),
        correlation=noise.correlation, standard_error=np.stack(error),
        fine_time=_block_means(time, size // per_block)[:fine],
        fine_load=_block_means(one.load[span], size // per_block)[:fine],
        per_block=per_block,
        weight=np.isfinite(means).astype(np.float64),
    )


def _filled(values: Array) -> Array:
    """Rows (3, N) with missing values (a probe's short gap) replaced by a straight line."""
    grid = np.arange(values.shape[1])
    good = np.isfinite(values)
    return np.stack(
        [np.interp(grid, grid[seen], row[seen]) for row, seen in zip(values, good, strict=True)]
    )


def _zero_blocks(one: _Prepared, size: int) -> int:
    return max(1, (one.measured.zero.end - one.measured.zero.start) // size)


def _slow_cell_noise(
    rig: Rig, contact: ContactParameters, runs: Sequence[_Prepared]
) -> ChannelNoise | None:
    """Noise [N] of the load cell that its readings share with what the model then gets wrong.

    At rest the ring follows the load, and the simulation the cell. From plateaus only: other
    stretches at rest are too short to tell.
    """
    held = [one for one in runs if one.branch is not None]
    held = [one for one in held if abs(one.interval / held[0].interval - 1.0) <= 0.05]
    loads, errors, weights = [], [], []
    for one in held:
        left = [one.explained[:, a:b] - one.displacement[:, a:b] for a, b in one.rests]
        steps = np.concatenate([np.diff(part, axis=1) for part in left], axis=1)
        precision = 1.0 / np.maximum(np.nanmean(steps**2, axis=1), SMALLEST_NOISE**2)
        level = np.array([float(np.mean(one.measured.load[a:b])) for a, b in one.rests])
        slopes = _static_slopes(rig, contact, float(one.run.elevation), level)
        for (start, stop), part, slope in zip(one.rests, left, slopes.T, strict=True):
            good = np.all(np.isfinite(part), axis=0)
            if np.count_nonzero(good) < 4:
                continue
            weights.append(float(precision @ slope**2))
            errors.append((precision * slope / weights[-1]) @ part[:, good])
            loads.append(one.measured.load[start:stop][good])
    return fit_common(loads, errors, weights, held[0].interval) if loads else None


def _cell_noise(one: _Prepared, slow: ChannelNoise | None) -> ChannelNoise:
    """Noise [N] of the load cell in a run: white by its second differences, and the slow part."""
    load = one.measured.load
    white = float(np.mean(np.diff(load, 2) ** 2)) / 6.0 if len(load) > 2 else 0.0
    times = np.ones(1) if slow is None else slow.times
    return ChannelNoise(
        one.interval, white, times, np.zeros(1) if slow is None else slow.variances)


def _load_errors(
    rig: Rig, contact: ContactParameters, one: _Prepared, seen: Observation, noise: ChannelNoise
) -> LoadErrors | None:
    """What the load cell's noise does to a run; None where that cannot be followed.

    That is where the fit keeps every sample of a long record, the model finds no motion, or the
    load has no noise at all.
    """
    zero, readings = one.measured.zero, len(seen.time)
    at_zero = _static_slopes(rig, contact, seen.elevation, np.array([seen.zero_load]))[:, 0]
    if readings > 2 * MOST_SAMPLES or not noise.standard_deviation > 0.0:
        return None
    if not seen.dynamic:
        slopes = _static_slopes(rig, contact, seen.elevation, seen.load)
        zero_time = float(np.mean(one.measured.time[zero.start:zero.end]))
        covariance = noise.covariance_of_means(
            np.append(seen.time, zero_time),
            [stop - start for start, stop in [*one.rests, (zero.start, zero.end)]])
        answers = slopes[:, :, None] * np.eye(readings, readings + 1)
        return LoadErrors.of(covariance, answers, np.eye(readings + 1)[-1], at_zero)
    interval = float(seen.time[-1] - seen.time[0]) / (readings - 1)
    steps = readings * max(seen.per_block, int(np.ceil(interval / ANSWER_STEP)))
    time = seen.time[0] + interval * ((np.arange(steps) + 0.5) * readings / steps - 0.5)
    load = np.interp(time, seen.fine_time, seen.fine_load)
    answers = load_sensitivity(rig, contact, seen.elevation, time, load, readings)
    first, last = one.measured.time[[zero.start, zero.end - 1]]
    in_zero = ((seen.time >= first) & (seen.time <= last)).astype(np.float64)
    size = max(1, int(round(interval / one.interval)))
    covariance = noise.covariance_of_means(seen.time, [size] * readings)
    return LoadErrors.of(covariance, answers, in_zero / max(1.0, in_zero.sum()), at_zero)


def _static_slopes(
    rig: Rig, contact: ContactParameters, elevation: float, load: Array
) -> Array:
    """Displacement per load (3, N) [m/N, m/N, rad/N] of equilibria at loads (N,) [N]."""
    step = rig.limits.slope_step
    both = static_response(
        rig, contact.to_array(), elevation, np.concatenate([load - step, load + step]))
    below, above = np.split(both, 2, axis=1)
    return np.asarray((above - below) / (2.0 * step))
