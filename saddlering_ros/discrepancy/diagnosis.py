"""`diagnose` and `check` for a declared model of any machine."""

from collections.abc import Mapping, Sequence
from dataclasses import replace
import time as clock
import timeit
from typing import cast

import numpy as np
from scipy.special import binom

from saddlering_ros.discrepancy.engine import diagnose_system
from saddlering_ros.discrepancy.noise import MAX_CHANCE
from saddlering_ros.discrepancy.problem import fits
from saddlering_ros.discrepancy.problem import system as systems
from saddlering_ros.discrepancy.problem.metric import Metric, noise_metric
from saddlering_ros.discrepancy.problem.model import Model, ModelSystem, Run
from saddlering_ros.discrepancy.problem.problem import Assumptions, Problem
from saddlering_ros.discrepancy.problem.system import Array, DiscrepancyError, RunBlocks, Settings
from saddlering_ros.discrepancy.search.signatures import MIN_SHARE, orthonormal
from saddlering_ros.discrepancy.verdict import results, wording
from saddlering_ros.discrepancy.verdict.noise_doubts import (
    unestablished,
    with_noise_doubts,
    with_slow_noise,
)
from saddlering_ros.estimation.process import fisher_chance
from saddlering_ros.progress import IsCancelled, one_blas_thread, OnProgress, Watch
from saddlering_ros.quantities import compact, percent

MODEL_SETTINGS = Settings(form_error=0.02, rounds=20, max_rounds=100)
"""Strictness of a diagnosis of a declared model: its laws are assumed to be nearly exact. Its
fits get more rounds than those of a ring, because its parameters may be strongly correlated."""


def diagnose(
    model: Model | systems.System,
    runs: Sequence[Run] | Sequence[RunBlocks],
    *,
    hold_out: Sequence[Run] | Sequence[RunBlocks] = (),
    settings: Settings | None = None,
    start: Mapping[str, float] | None = None,
    proposals: Sequence[systems.Proposal] = (),
    on_progress: OnProgress | None = None,
    is_cancelled: IsCancelled | None = None,
) -> results.Diagnosis:
    """Differences between `model` and `runs`, their causes, and the gain on `hold_out`.

    A simulator with nuisance parameters and combined views of its own is given as a `System` with
    `RunBlocks`, like the ring. start: first guesses of base parameters; proposals: tests of which
    one is chosen if causes cannot be told apart; on_progress and is_cancelled: docs/python_api.md.
    """
    problem = problem_of(
        model, runs, hold_out, settings=settings, start=start, proposals=proposals,
        watch=Watch('diagnose', on_progress, is_cancelled))
    diagnosis = diagnose_system(problem)
    if isinstance(problem.system, ModelSystem):
        diagnosis = _finished(diagnosis, problem.system)
    problem.watch.progress('verdict', 1.0)
    return diagnosis


def problem_of(
    model: Model | systems.System,
    runs: Sequence[Run] | Sequence[RunBlocks],
    hold_out: Sequence[Run] | Sequence[RunBlocks] = (),
    *,
    settings: Settings | None = None,
    start: Mapping[str, float] | None = None,
    proposals: Sequence[systems.Proposal] = (),
    watch: Watch | None = None,
) -> Problem:
    """The problem of a declared model, or of a `System`, with runs in its form."""
    for name, given, kind, words in (
            ('runs', runs, Sequence, 'a list of runs'),
            ('hold_out', hold_out, Sequence, 'a list of runs'),
            ('start', start or {}, Mapping, 'a mapping from names to numbers'),
            ('settings', settings or MODEL_SETTINGS, Settings, 'Settings(...)')):
        systems.must_be(kind, f'diagnose: {name}', given, words)
    if not runs:
        raise DiscrepancyError('diagnose: no runs: give at least one')
    system: systems.System
    if isinstance(model, Model):
        for run in (*runs, *hold_out):
            systems.must_be(Run, 'diagnose: one of the runs of a Model', run, 'Run(...)')
        system = ModelSystem(model, cast(Sequence[Run], runs))
    else:
        if not hasattr(model, 'predict_many'):
            systems.must_be(Model, 'diagnose: model', model, 'Model(...)')
        system = model
    blocks = []
    for part, held_out in ((runs, False), (hold_out, True)):
        for run in part:
            if isinstance(run, RunBlocks):
                blocks.append(replace(run, held_out=held_out))
            elif isinstance(system, ModelSystem):
                blocks.append(system.blocks(run, held_out=held_out))
            else:
                raise DiscrepancyError('diagnose: a System takes runs of the class RunBlocks')
    systems.refuse_repeats(blocks)
    assumptions, usual = Assumptions(), Settings()
    if isinstance(system, ModelSystem):
        assumptions, usual = system.assumptions(), MODEL_SETTINGS
    problem = Problem(system, blocks, settings or usual, assumptions, start, proposals,
                      watch or Watch('diagnose'))
    if isinstance(system, ModelSystem):
        problem.refuse_acting_when_absent()
    return problem


@one_blas_thread()
def _finished(diagnosis: results.Diagnosis, system: ModelSystem) -> results.Diagnosis:
    """The same in the units of the channels, with warnings for the reader."""
    diagnosis.fits.metric.problem.watch.progress('doubts about the noise', 0.95)
    diagnosis = with_slow_noise(with_noise_doubts(diagnosis, system), system)
    few, has_code = _few_samples(diagnosis)
    if has_code and diagnosis.verdict != 'unknown':
        diagnosis = unestablished(diagnosis)
    errors = {name: channel.model_error for name, channel in system.model.channels.items()}
    largest: dict[str, results.Remainder] = {}
    for rest in diagnosis.remainder:
        largest.setdefault(rest.channel, rest)
    warnings = (
        *_other_units(diagnosis.fits.metric.problem, diagnosis.fits.after),
        *_odd_readings(diagnosis), *diagnosis.warnings, *few,
        *(wording.BEYOND_DECLARED.format(
            name, rest.run, percent(rest.share_of_range), percent(errors[name]))
          for name, rest in largest.items() if errors[name] > 0.0),
        *_rough_answers(diagnosis.fits.metric.problem, diagnosis.fits.after),
        *system.failure_sentences(), *(() if diagnosis.converged else [wording.NOT_CONVERGED]))
    scale, predictions = system.scales[:, None], []
    for one in diagnosis.runs:
        present = True if one.run.present is None else one.run.present
        measured = np.where(present, one.run.channels * scale, 0.0)
        predictions.append(results.RunPrediction(
            replace(one.run, channels=measured), one.before * scale, one.after * scale))
    remainder = tuple(
        replace(rest, size=rest.size * float(scale[system.channel_names.index(rest.channel), 0]))
        for rest in diagnosis.remainder)
    missing = wording.SINGLE_RUN if len(diagnosis.fits.metric.problem.all_runs) == 1 else None
    return replace(diagnosis, warnings=warnings, runs=tuple(predictions), remainder=remainder,
                   next_test=diagnosis.next_test or missing)


MIN_PRECISION = (10.0, 100.0)
"""Smallest change of a channel by a step of a sensitivity, in errors of its difference, for the
poorest and the best parameter. A size was six standard deviations off at 3 and 18. Corners of a
sound simulator make one parameter poor: 10 and 40 000."""


def _rough_answers(problem: Problem, fit: fits.Fit) -> list[str]:
    """A sentence if rounding or a loose tolerance of the simulator shows in sensitivities.

    Third differences within the step of a parameter hold such errors and no curvature.
    """
    base = problem.system.base_parameters
    thirds, steps = np.linspace(0.0, 1.0, 4)[1:], fits.around(fit, base)[1]
    answers = problem.predict([fit.point, *(
        fit.candidate.point(base, fit.theta_unit + part * move)
        for move in np.diag(steps) for part in thirds)])
    start, (first, second, whole) = answers[:, :1], (answers[:, 1 + n::3] for n in range(3))
    errors, changes = (start - 3.0 * first + 3.0 * second - whole) / 10.0**0.5, whole - start
    precision = np.full(len(steps), np.nan)  # by the channel that shows a parameter best
    for own in range(len(problem.system.channel_names)):
        rows = np.concatenate([np.r_[part] for _, number, part in problem.slices if number == own])
        error, change = (np.linalg.norm(one[rows], axis=0) for one in (errors, changes))
        change[change == 0.0] = np.nan
        precision = np.fmax(precision, change / np.maximum(error, np.finfo(float).tiny))
    if not (np.fmin.reduce(precision) < MIN_PRECISION[0]
            and np.fmax.reduce(precision) < MIN_PRECISION[1]):
        return []
    return [wording.ROUGH.format(
        fit.candidate.parameters(base)[np.nanargmin(precision)].name,
        compact(float(np.nanmin(precision)), 2))]


MIN_FACTOR, MIN_LIKENESS = 2.5, 0.95
"""Smallest factor between readings and simulation, either way, and smallest correlation of the
two, that another unit has. Defects of sensors are smaller."""

FACTOR_ROUNDS, FACTOR_UNIT = 3, 1e-3
"""Refits of the base, each to readings over the factor of the one before, and their unit as a
share of range."""


def _other_units(problem: Problem, fit: fits.Fit) -> list[str]:
    """A sentence for each channel that nothing moves, or whose readings have another unit."""
    base, names = problem.system.base_parameters, problem.system.channel_names
    large = [number for number, (seen, left) in enumerate(zip(
        _by_channel(problem, problem.measured),
        _by_channel(problem, fit.prediction - problem.measured), strict=True))
        if left @ left > (1.0 - 1.0 / MIN_FACTOR) ** 2 * (seen @ seen)]
    if not large:
        return []
    empty = fits.Candidate()
    points = [empty.point(base, one) for one in fits.spread_starts(base, problem.settings.seed)]
    points += [empty.plus(effect, 0).point(base, np.r_[fit.theta_unit, start])
               for effect in problem.system.effects for start in effect.first_guesses]
    answers = problem.predict(points)
    answers = answers[:, np.isfinite(answers).all(axis=0)]
    moving = [number for number in large
              if any(np.ptp(run[number], axis=0).any() for run in problem.by_run(answers))]
    still = [wording.NEVER_MOVES.format(names[one]) for one in large if one not in moving]
    return still + [wording.unit_words(names[one], factor)
                    for one, factor in _factors(problem, answers, moving).items()]


def _factors(problem: Problem, answers: Array, channels: Sequence[int]) -> dict[int, float]:
    """Readings over simulation of those among `channels` whose readings have another unit.

    The base is refitted to the readings over their factors, which begin with those over answers
    (n, B) of the simulator.
    """
    measured, simulated = (_by_channel(problem, one) for one in (problem.measured, answers))
    factors, theta = np.ones(len(measured)), fits.declared_start(problem.system.base_parameters)
    for again in range(FACTOR_ROUNDS, -1, -1):
        for number in channels:
            powers = np.maximum((simulated[number] ** 2).sum(axis=0), 1e-300)
            factors[number] = np.median(measured[number] @ simulated[number] / powers)
        if not (np.isfinite(factors).all() and factors.all()):
            return {}
        if again:
            metric = fits.GainMetric(problem.with_runs([
                replace(run, channels=run.channels / factors[:, None]) for run in problem.runs]),
                FACTOR_UNIT)
            [own] = fits.run_refits(metric, [fits.refit(metric, fits.Candidate(), theta)])
            theta, simulated = own.theta_unit, _by_channel(problem, own.prediction)
    return {number: float(factors[number]) for number in channels
            if not 1.0 / MIN_FACTOR < factors[number] < MIN_FACTOR
            and abs(factors[number]) * np.linalg.norm(simulated[number])
            >= MIN_LIKENESS * np.linalg.norm(measured[number])}


def _by_channel(problem: Problem, stacked: Array) -> list[Array]:
    """Stacked columns (n, B) or (n,) by channel, weighted by time, less a free constant."""
    return [np.concatenate([
        (seen.T * np.sqrt(problem.sample_weights(run, name))).T for run, seen in zip(
            problem.runs, problem.view_residuals(stacked, name), strict=True)])
        for name in problem.view_ranges]


FEW_SAMPLES = 0.01
"""Share of the samples of a run that hold half of the power of a misfit only where a recorder
errs, or in a shock. Of normal noise they hold 7 %, and one of few samples more by chance."""

CODE_SAMPLES = 0.25
"""The same share if the samples have one value that differs from all others by more than the range
of the others. Such a value is the code of a recorder for a missing reading. Thirty codes in 500
samples had no warning."""


def _few_samples(diagnosis: results.Diagnosis) -> tuple[list[str], bool]:
    """A sentence for each channel of which few samples of a run hold most of the misfit.

    With them whether any of these samples are codes of a recorder.
    """
    problem, found, has_code = diagnosis.fits.metric.problem, dict[str, str](), False
    for one in diagnosis.runs:
        for residual, readings, (name, scale) in zip(
                one.after - one.run.channels, one.run.channels, problem.view_ranges.items(),
                strict=True):
            there = problem.sample_weights(one.run, name) > 0.0
            samples = np.count_nonzero(there)
            powers = problem.freed(residual, one.run, name) ** 2 * there
            order = np.argsort(-powers)
            held = np.cumsum(powers[order]) / max(powers.sum(), 1e-300)
            count = 1 + int(np.searchsorted(held, 0.5))
            share = min(float(held[count - 1]), 1.0 - 1e-9)
            ratio = share / (1.0 - share) * (samples - count) / count
            is_rare = fisher_chance(ratio, count, samples - count) <= (
                MAX_CHANCE / binom(samples, count))  # choices that overflow have a chance of 0
            # Whether the largest reading occurs again, and is far from all other readings.
            value, others = float(readings[order[0]]), readings[there]
            others = others[others != value]
            is_code = 0 < others.size < samples - 1 and bool(
                np.abs(others - value).min() > np.ptp(others))
            few = CODE_SAMPLES if is_code else FEW_SAMPLES
            if count <= max(few * samples, 1) and (is_code or is_rare) and (
                    powers[order[0]] > (MODEL_SETTINGS.materiality * scale) ** 2):
                has_code |= is_code
                found.setdefault(name, wording.FEW_SAMPLES.format(
                    name, one.run.name, count, samples,
                    f'{one.run.time[order[0]]:.10g} {problem.time_unit}'.rstrip(),
                    percent(share)))
    return [*found.values()], has_code


JUMP = 0.75
"""Share of the range of a run by which readings jump where an angle begins again."""

MIN_REPEATS = 8
"""Number of equal gaps between changes, to a sample, from which on a channel is a slower one."""

STANDING, MOSTLY = 4.0, 0.9
"""Mean square misfit of samples that repeat the reading beside them over that of the others, from
which on the sensor may have stood still there, and the share of such samples from which on the
readings are coarse. Of rounded readings the first is about 1."""


def _odd_readings(diagnosis: results.Diagnosis) -> list[str]:
    """A sentence for each channel of an open verdict whose readings are held, or begin again."""
    problem, found = diagnosis.fits.metric.problem, dict[str, str]()
    for one in diagnosis.runs if diagnosis.verdict == 'unknown' else ():
        for simulated, readings, (name, scale) in zip(
                one.after, one.run.channels, problem.view_ranges.items(), strict=True):
            there = problem.sample_weights(one.run, name) > 0.0
            time, read, seen = one.run.time[there], readings[there], simulated[there]
            words = (_begins_again(time, read, seen) or _is_slower(read)
                     or _stands_still(time, read, seen, problem.settings.materiality * scale))
            if words:
                found.setdefault(name, f'{name} in {one.run.name}: {words}')
    return [*found.values()]


def _begins_again(time: Array, read: Array, seen: Array) -> str:
    """Words on readings (N,) that jump by their range where what is simulated does not."""
    least = JUMP * np.ptp(read)
    jumps = np.flatnonzero((abs(np.diff(read)) > least) & (abs(np.diff(seen)) < 0.5 * least))
    if jumps.size < 2 or np.diff(jumps).min() == 1:  # one jump, or a few wrong readings
        return ''
    return wording.BEGINS_AGAIN.format(jumps.size, f'{time[jumps[0] + 1]:.6g}')


def _is_slower(read: Array) -> str:
    """Words on readings (N,) of which each is repeated as often."""
    gaps = np.diff(np.flatnonzero(np.diff(read)))
    is_slower = gaps.size >= MIN_REPEATS and gaps.min() > 1 and np.ptp(gaps) <= 1
    return wording.SLOWER if is_slower else ''


def _stands_still(time: Array, read: Array, seen: Array, material: float) -> str:
    """Words on readings (N,) that repeat the one beside them and hold most of the misfit."""
    is_same = np.diff(read) == 0.0
    still = np.r_[is_same, False] | np.r_[False, is_same]
    if still.mean() >= MOSTLY:
        return ''
    powers = (seen - read) ** 2
    held, rest = float(powers[still].sum()), float(powers[~still].sum())
    is_worse = held > STANDING * rest * still.sum() / (~still).sum()
    if not is_worse or held <= max(rest, material**2):
        return ''
    return wording.STANDS_STILL.format(
        still.sum(), still.size, f'{time[still.argmax()]:.6g}', percent(held / (held + rest)))


SOUND_SHARE, OPEN_FACTOR = 0.4, 3.0
"""Simulations of a diagnosis in which nothing is wrong, and of one in which no cause fits, over
those until a cause is named. No residual tells which it will be: a cause may hide in noise that
is learnt, and a sound machine may have a model error."""

MAX_RESIDUALS = 20
"""Residuals that a check tells, the largest beside the noise: 200 runs had 400 lines."""

TIMED = 3
"""Tries of which the shortest counts: other programs lengthen one."""

WHITENED = 12
"""Columns whitened one by one in the time spent beside each simulation, fixed costs included: 5 to
22 in eight of ten of 67 diagnoses of 15 machines, with 100 to 50 000 samples a run."""

REFIT_ROUNDS = 2
"""Rounds in which base parameters are refitted to the change of an effect. Without any, a heat
transfer smaller by 25 % left 68 standard deviations, and less than `MIN_SHARE` with one."""

class CheckReport(list[str]):
    """Findings, one line each; it prints as these lines."""

    def __str__(self) -> str:
        return '\n'.join(self)


@one_blas_thread()
def check(model: Model, runs: Sequence[Run]) -> CheckReport:
    """Units, sensitivities, invisible effects, residual over noise, estimated time."""
    problem = problem_of(model, runs)
    system = problem.system
    assert isinstance(system, ModelSystem)
    fit = fits.fit_base(noise_metric(problem).with_offsets())
    metric = noise_metric(problem, fit.prediction).with_offsets()
    # The fits before have compiled the simulator.
    each, beside = (
        min(timeit.repeat(work, timer=clock.monotonic, repeat=TIMED, number=1))
        for work in (lambda: problem.predict([fit.point]), lambda: metric.whiten(fit.whitened)))
    report = CheckReport()
    for name, scale in zip(system.channel_names, system.scales, strict=True):
        unit = model.channels[name].unit or 'no unit'
        report.append(f'channel {name} [{unit}]: range {scale:.4g}')
    report += _base_lines(metric, fit)
    report += _effect_lines(metric, fit)
    # Whitened, a slow misfit of many times the noise would hide among fast samples.
    residual, rows = problem.by_run(fit.prediction - problem.measured), list[tuple[float, str]]()
    for index, channel, _ in problem.slices:
        name, run = system.channel_names[channel], problem.runs[index]
        size = problem.mean_square(
            problem.freed(residual[index][channel], run, name), run, name) ** 0.5
        times = size / max(metric.noise_power(run, name) ** 0.5, systems.JITTER)
        rows.append((times, f'{name} in {run.name}: the residual of the base fit is {times:.3g} '
                     f'times the noise, {percent(size / problem.view_ranges[name])} of range'))
    least = sorted((times for times, _ in rows), reverse=True)[:MAX_RESIDUALS][-1]
    report += [line for times, line in rows if times >= least]
    if (more := len(rows) - MAX_RESIDUALS) > 0:
        report.append(f'{more} further residuals are smaller beside the noise')
    seconds = (each + WHITENED * beside) * problem.usual_simulations
    sound, named, unfit = (
        compact(share * seconds, 2) for share in (SOUND_SHARE, 1.0, OPEN_FACTOR))
    report.append(
        f'one simulation of all runs takes {each:.2g} s: about {named} s in all if a cause is '
        f'named, {sound} s if nothing is wrong, {unfit} s if no cause fits')
    report += [f'warning: {sentence}' for sentence in (
        *_other_units(problem, fit), *_rough_answers(problem, fit), *system.failure_sentences())]
    return report


def _base_lines(metric: Metric, fit: fits.Fit) -> list[str]:
    """Standard deviation of each base parameter by itself."""
    white = fits.centred(metric, fit, fits.tangent(metric, fit).white)
    lines = []
    for number, parameter in enumerate(metric.problem.system.base_parameters):
        others = orthonormal(np.delete(white, number, axis=1))
        own = white[:, number] - others @ (others.T @ white[:, number])
        alone, beside = float(np.linalg.norm(white[:, number])), float(np.linalg.norm(own))
        if alone < systems.MIN_SENSITIVITY:
            seen = 'cannot be seen in these runs'
        elif beside < systems.MIN_SENSITIVITY:
            seen = 'cannot be told from the other base parameters'
        else:
            seen = f'determined to {parameter.slope(float(fit.theta_unit[number])) / beside:.2g}'
        value = parameter.from_unit(float(fit.theta_unit[number]))
        words = f'{value:.5g} {parameter.unit}'.rstrip() + wording.at_bound(parameter, value)
        lines.append(f'base {parameter.name}: {words}, {seen}')
    return lines


def _effect_lines(metric: Metric, fit: fits.Fit) -> list[str]:
    """Whether each effect shows beside the base parameters."""
    problem = metric.problem
    base = problem.system.base_parameters
    white = fits.tangent(metric, fit).white
    directions, steps = orthonormal(white), np.linalg.pinv(white)

    def beside_base(changes: Array) -> Array:
        """Lengths (S,) of what the base leaves of whitened changes (n, S), to first order."""
        return np.linalg.norm(changes - directions @ (directions.T @ changes), axis=0)

    lines = []
    for effect in problem.system.effects:
        points = [fit.candidate.plus(effect, 0).point(base, np.r_[fit.theta_unit, start])
                  for start in effect.first_guesses]
        change = metric.whiten(problem.predict(points) - fit.prediction[:, None])
        change = change[:, np.isfinite(change).all(axis=0)]
        lengths, whole = beside_base(change), np.linalg.norm(change, axis=0)
        theta, left = fit.theta_unit[:, None], change
        for _ in range(REFIT_ROUNDS):
            theta = np.clip(theta + steps @ np.nan_to_num(left), 0.0, 1.0)
            moved = [fit.candidate.point(base, one) for one in theta.T]
            left = change - metric.whiten(problem.predict(moved) - fit.prediction[:, None])
            lengths = np.fmin(lengths, beside_base(left))
        if not whole.size:
            seen = 'the simulator fails at every start'
        elif not whole.max() > 0.0:
            seen = 'changes nothing at any start'
        elif (lengths / np.maximum(whole, 1e-300)).max() < MIN_SHARE:
            seen = 'cannot be told from the base parameters'
        else:
            seen = f'reaches {lengths.max():.3g} standard deviations at the best start'
        lines.append(f'effect {effect.id}: {seen}')
    return lines
