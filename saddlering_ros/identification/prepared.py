"""A run with its displacement, its stretches at rest, and the noise of its probes there."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import uniform_filter1d

from saddlering_ros.doubts import Finding
from saddlering_ros.doubts.wiring import units_of_notes
from saddlering_ros.errors import BagError
from saddlering_ros.estimation import noise, rest
from saddlering_ros.estimation.process import Array, ChannelNoise, EstimationError, filled
from saddlering_ros.identification.settings import IdentificationError
from saddlering_ros.record.displacement import displacement_of_run, MeasuredRun
from saddlering_ros.record.plateaus import Plateaus, plateaus
from saddlering_ros.record.record import Record, SPAN_MARGIN
from saddlering_ros.rig import ContactParameters, ParameterSet, probes_to_displacement, Rig
from saddlering_ros.ring.simulator import simulate

CHANNEL_COUNT = 3
"""delta_x, delta_y, gamma."""

MAX_SAMPLES = 1000
"""Longest fit grid of one dynamic run; longer records get a coarser grid."""

SIMULATION_RATE = 250.0
"""Rate [Hz] of the load of a dynamic run in a fit; faster records are averaged."""

MAX_SIMULATED = 1 << 17
"""Largest number of load samples of one run in a fit: longer records than 8.7 min at
`SIMULATION_RATE` are averaged further, so that the memory of a fit does not grow with them."""

LONGEST_PAUSE = 10.0
"""Time [s] to which a fit shortens a pause of a dynamic test, with samples at rest or without. The
ring is at rest long before, and every step of a motion and its derivatives is in memory."""

MIN_READINGS = 5
MIN_SHARE_READ = 0.3
"""Smallest number of plateaus of a static run, and smallest share of a dynamic run, with readings
of all four probes. Stiffness, exponent and zero take three plateaus."""

MAX_END = 100
"""Largest number of samples that are the end of a record: those of a long pause do not count."""

MIN_REST = 4
"""Smallest number of readings at rest that count."""

SLOW_SECONDS = 0.25
"""Time [s] above which movements of the load are removed from readings at rest."""


@dataclass(frozen=True)
class PreparedRun:
    """A run with its displacement and where it is at rest (start, stop index pairs).

    rows (M,), time (M,): samples of a fit and their times, with pauses shortened.
    """

    run: Record
    measured: MeasuredRun
    displacement: Array  # (3, N) [m, m, rad], NaN where unknown
    load: Array  # (N,) [N] that the model is driven with
    explained: Array  # (3, N) [m, m, rad]: what the load explains of the displacement at rest
    rests: list[tuple[int, int]]
    branch: Array | None  # (M,): of the plateaus of a static run
    interval: float  # [s]
    parity: Array  # (N,) [m]: as `parity_at_rest` has it
    rows: NDArray[np.intp]
    time: Array  # [s]
    rounding: Array | None = None  # (3, N): errors of coarse converters that rest hides

    def explained_by(self, rig: Rig, contact: ContactParameters) -> 'PreparedRun':
        """The same, explained by a simulation with a contact law; NaN before its zero."""
        time = self.measured.time
        step = max(float(np.median(np.diff(time))), 1e-3)
        simulated = simulate(rig, ParameterSet(contact), self.run.elevation, time, self.load, step)
        explained = np.full((CHANNEL_COUNT, len(time)), np.nan)
        explained[:, simulated.first:] = simulated.displacement.channels[:CHANNEL_COUNT]
        return replace(self, explained=explained)


def prepare(run: Record, rig: Rig, fit_rate: float | None) -> PreparedRun:
    """A run with the input of its observation; IdentificationError if it cannot be used.

    Its displacement is explained by a proportion of the load.
    """
    name, run = str(run.path), run.without_spikes()
    levels = check_run(run, rig)
    try:
        measured = displacement_of_run(rig, run)
    except BagError as problem:
        raise IdentificationError(str(problem)) from problem
    displacement = measured.displacement.channels[:CHANNEL_COUNT]
    displacement[:, np.any(saturated(run, rig), axis=0)] = np.nan
    interval = float(np.median(np.diff(measured.time)))
    stretches = [] if levels is not None else rest.stretches_at_rest(
        measured.time, measured.load, rig.limits.rest_band)
    rows, time = without_pauses(measured.time, stretches)
    size = 1 if run.test == 'static' else block_sizes(interval, 1, fit_rate)[0]
    # Averaged over 1 / fit_rate around each sample (an odd number: without delay). A model
    # with little damping rings with the cell's noise, and least squares would add damping against
    # it. Longer blocks of a long record would round the corners of its load.
    load = np.asarray(uniform_filter1d(measured.load, 2 * (size // 2) + 1, mode='nearest'))
    good = np.all(np.isfinite(displacement), axis=0)
    errors, rounding = rest.probe_rounding(run), None
    if errors is not None:
        rounding = probes_to_displacement(rig.probes, errors).channels[:CHANNEL_COUNT]
    branch = None
    if levels is None:
        is_read = bool(np.mean(good) >= MIN_SHARE_READ)
        rests = rest.quiet_stretches(stretches) or [(measured.zero.start, measured.zero.end)]
    else:
        rests = list(zip(levels.start.tolist(), levels.stop.tolist(), strict=True))
        seen = [bool(np.mean(good[a:b]) > 0.5) for a, b in rests]
        rests = [span for span, enough in zip(rests, seen, strict=True) if enough]
        branch, is_read = levels.branch[seen].astype(np.float64), len(rests) >= MIN_READINGS
    if not is_read:
        raise IdentificationError(
            f'{name}: probes are missing or at a limit of their span in most of the record: '
            'adjust their gaps and repeat the test')
    # Displacement per load (3,) over the whole run: the effect of small loads at rest.
    centred = load[good] - load[good].mean()
    explained = np.asarray(displacement[:, good] @ centred / (centred @ centred))[:, None] * load
    return PreparedRun(run, measured, displacement, load, explained, rests, branch, interval,
                       parity_at_rest(measured), rows, time, rounding)


def without_pauses(time: Array, rests: rest.Stretches) -> tuple[NDArray[np.intp], Array]:
    """Rows (M,) without the middle of long rests, and their times without long pauses."""
    kept = np.ones(time.size, dtype=bool)
    for start, stop in rests:
        inside = time[start:stop]
        aside = np.minimum(inside - inside[0], inside[-1] - inside)
        kept[start:stop] = aside < 0.5 * LONGEST_PAUSE
    rows = np.flatnonzero(kept)
    steps = np.diff(time[rows])
    if not (steps > LONGEST_PAUSE).any():
        return rows, time[rows]
    return rows, time[0] + np.cumsum(np.append(0.0, np.minimum(steps, LONGEST_PAUSE)))


def block_sizes(interval: float, samples: int, fit_rate: float | None) -> tuple[int, int]:
    """Number of samples in a block of the fit grid, and of its simulated steps.

    interval [s] of the samples; fit_rate [Hz].
    """
    if fit_rate is None:
        return 1, 1
    size = max(1, int(round(1.0 / (fit_rate * interval))), int(np.ceil(samples / MAX_SAMPLES)))
    fine = max(1, int(round(1.0 / (SIMULATION_RATE * interval))),
               int(np.ceil(samples / MAX_SIMULATED)))
    per_block = max(1, int(round(size / fine)))
    return per_block * max(1, size // per_block), per_block


@dataclass(frozen=True)
class NoiseModel:
    """Noise of delta_x, delta_y and gamma: a process each, and the correlation (3, 3)."""

    channels: tuple[ChannelNoise, ...]
    correlation: Array


def noise_of(runs: Sequence[PreparedRun]) -> list[NoiseModel]:
    """Noise of each run, learnt from all runs with equal sampling.

    It is that at rest, and that of the parity if the parity is noise.
    """
    alike: dict[int, list[PreparedRun]] = {}
    for one in runs:
        alike.setdefault(noise.sampling_class(one.interval), []).append(one)
    classes = {key: noise.RestSource.beside(
        [segment for one in members for segment in rest_segments(one)],
        [rest.RestSegment(one.parity[None, :], one.interval) for one in members],
        [one.parity[start:stop] for one in members for start, stop in one.rests])
        for key, members in alike.items()}
    try:
        learnt = noise.noise_by_class(classes, CHANNEL_COUNT, noise.LEVEL_REACH)
    except EstimationError as problem:
        least = min(runs, key=lambda one: sum(stop - start for start, stop in one.rests))
        raise IdentificationError(
            f'{least.run.path}: {problem}: hold the load before the ramp') from problem
    first = next(iter(learnt))
    models = {}
    for key in alike:
        source = key if key in learnt else first
        interval = alike[source][0].interval
        channels = tuple(one.at_least(noise.MIN_NOISE, interval) for one in learnt[source])
        models[key] = NoiseModel(channels, noise.channel_correlation(classes[source].segments))
    return [models[noise.sampling_class(one.interval)] for one in runs]


def rest_segments(one: PreparedRun) -> list[rest.RestSegment]:
    """Stretches at rest of a run minus the part that the load explains.

    Only slow movement of the load counts. The rest is noise of the cell, which does not belong
    to the probes and would correlate the errors of the channels.
    """
    width = max(1, int(round(SLOW_SECONDS / one.interval)))
    segments = []
    for start, stop in one.rests:
        motion, explained = one.displacement[:, start:stop], one.explained[:, start:stop]
        if one.rounding is not None:
            motion = motion + one.rounding[:, start:stop]
        good = np.all(np.isfinite(motion + explained), axis=0)
        if np.count_nonzero(good) >= MIN_REST:
            slow = uniform_filter1d(explained[:, good], width, axis=1, mode='nearest')
            segments.append(rest.RestSegment(motion[:, good] - slow, one.interval))
    return segments


def parity_at_rest(measured: MeasuredRun) -> Array:
    """Parity (N,) of a run without its smooth part over load and time; 0 if nowhere known."""
    parity = np.asarray(measured.displacement.parity)
    good = np.isfinite(parity)
    if not good.any():
        return np.zeros_like(parity)
    load = measured.load / max(float(np.max(np.abs(measured.load))), 1e-9)
    time = measured.time / max(float(measured.time[-1]), 1e-9)
    design = np.stack([np.ones_like(load), load, load**2, time, time**2], axis=1)
    smooth, *_ = np.linalg.lstsq(design[good], parity[good], rcond=None)
    return filled((parity - design @ smooth)[None, :])[0]


def warnings_of(run: Record, rig: Rig) -> list[str]:
    """Faults that make the result of a run doubtful, one line each."""
    warnings = [*run.notes]
    for probe, clipped in enumerate(saturated(run, rig), start=1):
        share = float(np.mean(clipped))
        if share > 0.001:
            warnings.append(
                f'probe {probe} is at a limit of its span in {100.0 * share:.1f} % of the record, '
                'which is left out')
    return warnings


def saturated(run: Record, rig: Rig) -> NDArray[np.bool_]:
    """Mask (4, N) of readings at a limit of the span, behind which the face may be farther."""
    margin = SPAN_MARGIN * (rig.probes.max_range - rig.probes.min_range)
    low, high = rig.probes.min_range + margin, rig.probes.max_range - margin
    with np.errstate(invalid='ignore'):
        return np.asarray((run.gaps <= low) | (run.gaps >= high))


def small_load(run: Record, rig: Rig, top: float) -> IdentificationError:
    """The error of a run whose highest load [N] is a fifth of full scale at most."""
    looks = ''.join(f'; the readings look like {unit}' for unit in units_of_notes(run.notes))
    return IdentificationError(
        f'{run.path}: no load exceeds {rig.force_words(rig.limits.identification_min)}, a fifth '
        f'of full scale (highest {rig.force_words(top)}): load the ring further, or correct the '
        f"rig file's full_scale_load{looks}")


def check_run(run: Record, rig: Rig) -> Plateaus | None:
    """Plateaus of a static run, None of a dynamic one; IdentificationError for a small range."""
    name = run.path
    if not np.isfinite(run.elevation):
        raise IdentificationError(f'{name}: its elevation is {run.elevation}: give it in degrees')
    top = float(np.nanmax(run.load)) if len(run.load) else 0.0
    if not top > rig.limits.identification_min:
        raise small_load(run, rig, top)
    end = min(max(1, len(run.load) // 100), MAX_END)
    begins, ends = (float(np.nanmedian(run.load[part])) > 0.5 * top
                    for part in (slice(end), slice(-end, None)))
    readings = None
    if run.test == 'static':
        try:
            readings = plateaus(run)
        except BagError as problem:
            raise IdentificationError(str(problem)) from problem
        levels = np.unique(np.round(readings.load / rig.limits.level_step))
        if len(levels) < 2:
            raise IdentificationError(
                f'{name}: a static run with one plateau only: '
                'identification needs readings at several loads')
        if not np.any(np.asarray(readings.branch) < 0):
            cut = ''.join(f' ({note})' for note in run.notes
                          if isinstance(note, Finding) and note.is_cut)
            raise IdentificationError(
                f'{name}: there is no unloading branch in this static run{cut}: '
                'record the steps down to zero as well')
    elif ends:
        raise IdentificationError(
            f'{name}: there is no unloading branch (the record ends at '
            f'{rig.force_words(float(run.load[-1]))}): record the test until the load is removed')
    if begins:
        raise IdentificationError(
            f'{name}: there is no loading branch (the record begins at '
            f'{rig.force_words(float(run.load[0]))}): record the test from the preload on')
    return readings
