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

from saddlering_ros.bags import BagError, displacement_of_run, MeasuredRun, plateaus, TestRun
from saddlering_ros.identification.errors import IdentificationError
from saddlering_ros.identification.noise import fit_noise, NoiseModel
from saddlering_ros.identification.whitening import Whitening
from saddlering_ros.rig import FULL_SCALE_LOAD, Rig, TONNE

Array = NDArray[np.float64]

CHANNEL_COUNT = 3
"""delta_x, delta_y, gamma."""

LEAST_LOAD = 5.0 * TONNE
"""A run that never exceeds this load [N] has too little range to identify from."""

MOST_SAMPLES = 1000
"""Longest fit grid of one dynamic run; longer records get a coarser grid."""

SIMULATION_RATE = 250.0
"""Rate [Hz] of the loads a dynamic run is simulated with in a fit; faster records are averaged."""

REST_BAND = 0.0025 * FULL_SCALE_LOAD
REST_SECONDS = 0.25
SETTLING_SECONDS = 0.3
"""What counts as a stretch at rest in a dynamic run, and how long it settles after a movement."""


@dataclass(frozen=True)
class Observation:
    """One run, ready to be fitted.

    time [s] and load [N] (N,); zero_load [N]; displacement (3, N) increments since zero
    [m, m, rad]; branch (N,) +1 loading, -1 unloading, 0 neither; whitening turns each channel's
    errors into uncorrelated ones of unit variance; correlation (3, 3) of these across channels;
    standard_error (3, N) of each reading. A dynamic run is simulated on its finer grid,
    fine_time and fine_load (N * per_block,), and averaged over blocks of per_block.
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

    def coarse(self) -> Observation:
        """The same run simulated on the fit grid itself: for a swarm, which needs no more."""
        if not self.dynamic:
            return self
        return replace(self, fine_time=self.time, fine_load=self.load, per_block=1)

    def whiten(self, residuals: Array, channels: Sequence[int]) -> Array:
        """Uncorrelated residuals (B, C * N) of raw ones (B, C, N) for the given channels."""
        rows = np.stack(
            [
                self.whitening[channel].apply(residuals[:, position])
                for position, channel in enumerate(channels)
            ],
            axis=1,
        )
        lower = cholesky(self.correlation[np.ix_(channels, channels)], lower=True)
        mixed = np.einsum('cd,bdn->bcn', np.linalg.inv(lower), rows)
        return np.asarray(mixed.reshape(len(residuals), -1))


@dataclass(frozen=True)
class _Prepared:
    """A run with its displacement and where it is at rest (start, stop index pairs)."""

    run: TestRun
    measured: MeasuredRun
    displacement: Array
    rests: list[tuple[int, int]]
    branch: Array | None
    interval: float


def observe(
    runs: Sequence[TestRun], rig: Rig, *, fit_rate: float | None
) -> list[Observation]:
    """Observations of runs; IdentificationError where a run cannot be used to identify.

    The noise is estimated from all runs of one sampling rate together.
    """
    if not runs:
        raise IdentificationError('no runs to identify from: give at least one bag')
    prepared = [_prepare(run, rig) for run in runs]
    return [
        _observe_dynamic(one, prepared, fit_rate)
        if one.branch is None
        else _observe_static(one, prepared, fit_rate)
        for one in prepared
    ]


def _prepare(run: TestRun, rig: Rig) -> _Prepared:
    name = run_name(run)
    check_run(run)
    try:
        measured = displacement_of_run(rig, run)
    except BagError as problem:
        raise IdentificationError(f'{name}: {problem}') from problem
    motion = measured.displacement
    displacement = np.stack([motion.delta_x, motion.delta_y, motion.gamma])
    interval = float(np.median(np.diff(measured.time)))
    if run.test == 'static':
        found = plateaus(run)
        rests = list(zip(found.start.tolist(), found.stop.tolist(), strict=True))
        return _Prepared(
            run, measured, displacement, rests, np.asarray(found.branch, dtype=float), interval
        )
    rests = _calm_stretches(measured)
    return _Prepared(run, measured, displacement, rests, None, interval)


def _calm_stretches(measured: MeasuredRun) -> list[tuple[int, int]]:
    """Stretches at rest of a dynamic run to read the noise from.

    That before the first movement alone if it is long enough: after a movement the ring may still
    be creeping back long after the load has come to rest.
    """
    rests = stretches_at_rest(measured.time, measured.load)
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
    warnings = []
    margin = 1e-4 * (rig.probes.max_range - rig.probes.min_range)
    low, high = rig.probes.min_range + margin, rig.probes.max_range - margin
    for probe, gaps in enumerate(run.gaps, start=1):
        seen = gaps[np.isfinite(gaps)]
        share = float(np.mean((seen <= low) | (seen >= high))) if len(seen) else 0.0
        if share > 0.001:
            warnings.append(
                f'{name}: probe {probe} is at a limit of its span in {100.0 * share:.1f} % of the '
                'record: what is identified from it is biased'
            )
    if not displacement_of_run(rig, run).zero.near_preload:
        warnings.append(f'{name}: it does not start near the preload, its zero is taken higher')
    return warnings


def check_run(run: TestRun) -> None:
    """IdentificationError when the run's range is too small to identify anything from."""
    name = run_name(run)
    if not np.isfinite(run.elevation):
        raise IdentificationError(f'{name}: its elevation is {run.elevation}: give it in degrees')
    if not np.all(np.isfinite(run.load)):
        raise IdentificationError(f'{name}: its load is not finite everywhere: cut the record')
    top = float(np.nanmax(run.load)) if len(run.load) else 0.0
    if not top > LEAST_LOAD:
        raise IdentificationError(
            f'{name}: the load never exceeds 5 t (highest {top / TONNE:.1f} t): '
            'identification needs a run that loads the ring further'
        )
    if run.test == 'static':
        _check_static(run, name)
    elif float(np.nanmedian(run.load[-max(1, len(run.load) // 100) :])) > 0.5 * top:
        raise IdentificationError(
            f'{name}: there is no unloading branch (the record ends at '
            f'{run.load[-1] / TONNE:.1f} t): record the test until the load is off again'
        )


def _check_static(run: TestRun, name: str) -> None:
    try:
        found = plateaus(run)
    except BagError as problem:
        raise IdentificationError(f'{name}: {problem}') from problem
    levels = np.unique(np.round(found.load / (0.5 * TONNE)))
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


def stretches_at_rest(time: Array, load: Array) -> list[tuple[int, int]]:
    """Index pairs of stretches of at least REST_SECONDS whose mean load stays within REST_BAND."""
    count = max(1, int(round(0.05 / max(float(np.median(np.diff(time))), 1e-6))))
    blocks = len(load) // count
    means = load[: blocks * count].reshape(blocks, count).mean(axis=1)
    fewest = max(2, int(np.ceil(REST_SECONDS / (count * float(np.median(np.diff(time)))))))
    settling = int(np.ceil(SETTLING_SECONDS / (count * float(np.median(np.diff(time))))))
    stretches = []
    start = 0
    for block in range(1, blocks + 1):
        if block < blocks and abs(means[block] - means[start]) <= REST_BAND:
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
        still = [part for one in held for part in _rest_blocks(one, count)]
        slow = fit_noise(still, count * held[0].interval) if still else None
    return fit_noise(segments, size * like.interval, slow)


def _rest_blocks(one: _Prepared, size: int) -> list[Array]:
    """Block means (3, n) of a run's stretches at rest, less what the load's movement explains."""
    slope = _load_slope(one)
    segments = []
    for start, stop in one.rests:
        motion = one.displacement[:, start:stop] - slope[:, None] * one.measured.load[start:stop]
        motion = motion[:, np.all(np.isfinite(motion), axis=0)]
        if motion.shape[1] >= 4 * size:
            segments.append(_block_means(motion, size))
    return segments


def _load_slope(one: _Prepared) -> Array:
    """Displacement per load (3,) over the whole run: what a little load movement does at rest."""
    load = one.measured.load
    good = np.all(np.isfinite(one.displacement), axis=0) & np.isfinite(load)
    centred = load[good] - load[good].mean()
    return np.asarray(one.displacement[:, good] @ centred / (centred @ centred))


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
        standard_error=np.stack(error), fine_time=time, fine_load=load,
    )


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
    displacement = _filled(_block_means(one.displacement[:, span], size))
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
        fine_load=_block_means(load, size // per_block)[:fine],
        per_block=per_block,
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
