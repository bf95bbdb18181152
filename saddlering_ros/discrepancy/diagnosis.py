"""`diagnose` and `check` for a declared model of any machine."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
import time as clock

import numpy as np

from saddlering_ros.discrepancy.engine import diagnose_system
from saddlering_ros.discrepancy.next_test import Proposal
from saddlering_ros.discrepancy.noise import (
    overestimated,
    overestimated_sentence,
    underestimated,
    underestimated_sentence,
)
from saddlering_ros.discrepancy.problem.experiment import (
    Experiment,
    JITTER,
    Metric,
    noise_metric,
    offset_columns,
    refuse_repeats,
)
from saddlering_ros.discrepancy.problem.fits import Candidate, Fit, fit_base, tangent
from saddlering_ros.discrepancy.problem.model import Model, Run
from saddlering_ros.discrepancy.problem.model_system import ModelSystem
from saddlering_ros.discrepancy.problem.system import DiscrepancyError, RunBlocks, Settings, System
from saddlering_ros.discrepancy.search.signatures import effect_starts, MIN_SHARE, orthonormal
from saddlering_ros.discrepancy.verdict.results import Diagnosis, RunPrediction
from saddlering_ros.estimation.process import ChannelNoise
from saddlering_ros.progress import IsCancelled, OnProgress

MODEL_SETTINGS = Settings(form_error=0.02, rounds=20, max_rounds=100)
"""Strictness of a diagnosis of a declared model: its laws are assumed to be nearly exact."""


def diagnose(
    model: Model | System,
    runs: Sequence[Run] | Sequence[RunBlocks],
    *,
    hold_out: Sequence[Run] | Sequence[RunBlocks] = (),
    settings: Settings | None = None,
    start: Mapping[str, float] | None = None,
    proposals: Sequence[Proposal] = (),
    on_progress: OnProgress | None = None,
    is_cancelled: IsCancelled | None = None,
) -> Diagnosis:
    """Differences between `model` and `runs`, their causes, and the gain on `hold_out`.

    A simulator with nuisance parameters and combined views of its own is given as a `System`
    with `RunBlocks`, like the ring. start: first guesses of base parameters; proposals: tests
    of which one is chosen if causes cannot be told apart; on_progress and is_cancelled:
    docs/python_api.md.
    """
    if isinstance(runs, (Run, RunBlocks)):
        raise DiscrepancyError('diagnose: runs is a single run: give a list of runs')
    if not runs:
        raise DiscrepancyError('diagnose: no runs: give at least one')
    if isinstance(model, Model):
        system: System = ModelSystem(model, _declared(runs))
        usual = MODEL_SETTINGS
    else:
        system, usual = model, Settings()
    found = diagnose_system(
        system,
        _blocks(system, runs, hold_out),
        settings or usual,
        assumptions=system.assumptions() if isinstance(system, ModelSystem) else None,
        start=start,
        proposals=proposals,
        on_progress=on_progress,
        is_cancelled=is_cancelled,
    )
    return _finished(found, system) if isinstance(system, ModelSystem) else found


def _finished(found: Diagnosis, system: ModelSystem) -> Diagnosis:
    """The same in the units of the channels, with warnings for the reader."""
    found = _with_noise_doubts(found)
    warnings = [*found.warnings, *system.failure_sentences()]
    if not found.converged:
        warnings.append(
            'a fit on which the verdict rests had not converged: give more rounds by '
            'Settings(max_rounds=...), narrower bounds or better starts'
        )
    predictions = tuple(_in_units(item, system) for item in found.runs)
    return replace(found, warnings=tuple(warnings), runs=predictions)


def _declared(runs: Sequence[Run] | Sequence[RunBlocks]) -> list[Run]:
    """Runs in the form of a declared model."""
    declared = [run for run in runs if isinstance(run, Run)]
    if len(declared) != len(runs):
        raise DiscrepancyError('diagnose: a Model takes runs of the class Run')
    return declared


def _blocks(
    system: System,
    runs: Sequence[Run] | Sequence[RunBlocks],
    hold_out: Sequence[Run] | Sequence[RunBlocks],
) -> list[RunBlocks]:
    """All runs in the form of the engine."""
    blocks = []
    for part, held_out in ((runs, False), (hold_out, True)):
        for run in part:
            if isinstance(run, RunBlocks):
                blocks.append(replace(run, held_out=held_out))
            elif isinstance(system, ModelSystem):
                blocks.append(system.blocks(run, held_out=held_out))
            else:
                raise DiscrepancyError('diagnose: a System takes runs of the class RunBlocks')
    return blocks


def prepared(
    model: Model, runs: Sequence[Run], hold_out: Sequence[Run] = ()
) -> tuple[ModelSystem, list[RunBlocks]]:
    """The model as a `System`, and its runs in the form of the engine."""
    if not runs:
        raise DiscrepancyError('diagnose: no runs: give at least one')
    system = ModelSystem(model, runs)
    return system, _blocks(system, runs, hold_out)


def _with_noise_doubts(found: Diagnosis) -> Diagnosis:
    """The same with a warning, and without a name, if the misfit does not agree with the noise."""
    metric, fit = found.fits.metric, found.fits.after
    experiment = metric.experiment
    residual = fit.prediction - experiment.measured
    white = metric.whiten(residual)
    under, over = [], []
    for index, channel, part in experiment.slices:
        run, name = experiment.runs[index], experiment.system.channel_names[channel]
        there = slice(None) if run.present is None else run.present[channel]
        left = residual[part][there]
        free = max(left.size - fit.theta_unit.size - 1, 1)
        statistic = float(white[part] @ white[part])
        noise = metric.noise[run.name, channel]
        if overestimated(statistic, free, noise.pairs) and not _is_exact(experiment, noise, run):
            over.append(overestimated_sentence(statistic, free, f'{name} in {run.name}'))
        beyond = float(np.mean(left**2)) * (1.0 - free / max(statistic, free))
        material = beyond >= (MODEL_SETTINGS.materiality * experiment.view_ranges[name]) ** 2
        if material and underestimated(statistic, free, noise.pairs):
            under.append(underestimated_sentence(statistic, free, f'{name} in {run.name}'))
    if found.verdict == 'unknown':
        under = []  # The warning on a remaining misfit is given already.
    if not under and not over:
        return found
    causes = tuple(replace(cause, partial=True) for cause in found.causes)
    return replace(
        found,
        verdict='unknown' if causes or under else found.verdict,
        causes=causes,
        warnings=(*over, *under, *found.warnings),
    )


def _is_exact(experiment: Experiment, noise: ChannelNoise, run: RunBlocks) -> bool:
    """Whether the noise is only the rounding that every metric contains."""
    limit = (JITTER * float(experiment.channel_ranges.max())) ** 2
    return float(noise.variances(run.width).max()) <= limit


def _in_units(item: RunPrediction, system: ModelSystem) -> RunPrediction:
    """A run and its predictions in the units of the channels."""
    scale = system.scales[:, None]
    measured = item.run.channels * scale
    if item.run.present is not None:
        measured = np.where(item.run.present, measured, 0.0)
    return RunPrediction(
        replace(item.run, channels=measured), item.before * scale, item.after * scale
    )


USUAL_SIMULATIONS = 900
"""Number of simulations of a diagnosis, in addition to those of each effect."""

PER_EFFECT = 120

TIMED = 3
"""Number of simulations that are timed."""

MIN_SENSITIVITY = 1.0
"""Largest change of the misfit by the whole range of a parameter that cannot be seen."""


class CheckReport(list[str]):
    """Findings, one line each; it prints as these lines."""

    def __str__(self) -> str:
        return '\n'.join(self)


def check(model: Model, runs: Sequence[Run]) -> CheckReport:
    """Units, sensitivities, invisible effects, residual over noise, estimated time."""
    system, blocks = prepared(model, runs)
    refuse_repeats(blocks)
    experiment = Experiment(system, blocks, system.assumptions())
    learn = experiment.assumptions.learn_noise
    metric = noise_metric(experiment, learn(experiment.runs, None))
    fit = fit_base(metric.marginalise(offset_columns(experiment)), None, 0)
    residual = experiment.by_run(fit.prediction - experiment.measured)
    metric = noise_metric(experiment, learn(experiment.runs, residual))
    metric = metric.marginalise(offset_columns(experiment))
    each = _seconds_each(experiment, fit)
    report = CheckReport()
    for name, scale in zip(system.channel_names, system.scales, strict=True):
        unit = model.channels[name].unit or 'no unit'
        report.append(f'channel {name} [{unit}]: range {scale:.4g}')
    report += _base_lines(metric, fit)
    report += _effect_lines(metric, fit)
    report += _residual_lines(metric, fit)
    count = USUAL_SIMULATIONS + PER_EFFECT * len(model.effects)
    report.append(
        f'one simulation of all runs takes {each:.2g} s: about {count * each:.0f} s in all'
    )
    report += [f'warning: {item}' for item in system.failure_sentences()]
    return report


def _seconds_each(experiment: Experiment, fit: Fit) -> float:
    """Time of one simulation of all runs, after compilation [s]."""
    began = clock.monotonic()
    experiment.predict([fit.point] * TIMED)
    return (clock.monotonic() - began) / TIMED


def _base_lines(metric: Metric, fit: Fit) -> list[str]:
    """Standard deviation of each base parameter by itself."""
    white = tangent(metric, fit).white
    lines = []
    parameters = metric.experiment.system.base_parameters
    for number, item in enumerate(parameters):
        others = orthonormal(np.delete(white, number, axis=1))
        own = white[:, number] - others @ (others.T @ white[:, number])
        alone, beside = float(np.linalg.norm(white[:, number])), float(np.linalg.norm(own))
        if alone < MIN_SENSITIVITY:
            seen = 'cannot be seen in these runs'
        elif beside < MIN_SENSITIVITY:
            seen = 'cannot be told from the other base parameters'
        else:
            seen = f'determined to {item.slope(float(fit.theta_unit[number])) / beside:.2g}'
        value = item.from_unit(float(fit.theta_unit[number]))
        edge = min(fit.theta_unit[number], 1.0 - fit.theta_unit[number])
        stopped = ', at its bound' if edge < 1e-3 else ''
        lines.append(f'base {item.name}: {value:.5g} {item.unit}{stopped}, {seen}')
    return lines


def _effect_lines(metric: Metric, fit: Fit) -> list[str]:
    """Whether each effect shows beside the base parameters."""
    experiment = metric.experiment
    base = experiment.system.base_parameters
    orthogonal = orthonormal(tangent(metric, fit).white)
    lines = []
    for effect in experiment.system.effects:
        starts = effect_starts(effect)
        points = [
            Candidate(((effect, 0),)).point(base, np.concatenate([fit.theta_unit, start]))
            for start in starts
        ]
        change = metric.whiten(experiment.predict(points) - fit.prediction[:, None])
        change = change[:, np.isfinite(change).all(axis=0)]
        left = change - orthogonal @ (orthogonal.T @ change)
        lengths, whole = np.linalg.norm(left, axis=0), np.linalg.norm(change, axis=0)
        if not whole.max(initial=0.0) > 0.0:
            seen = 'changes nothing at any start'
        elif (lengths / np.maximum(whole, 1e-300)).max() < MIN_SHARE:
            seen = 'cannot be told from the base parameters'
        else:
            seen = f'reaches {lengths.max():.3g} standard deviations at the best start'
        lines.append(f'effect {effect.id}: {seen}')
    return lines


def _residual_lines(metric: Metric, fit: Fit) -> list[str]:
    """The residual of the base in units of the noise, by channel and run."""
    experiment = metric.experiment
    white = metric.whiten(fit.prediction - experiment.measured)
    lines = []
    for index, channel, part in experiment.slices:
        ratio = float(np.sqrt(np.mean(white[part] ** 2)))
        name, run = experiment.system.channel_names[channel], experiment.runs[index].name
        lines.append(f'{name} in {run}: the residual of the base fit is {ratio:.3g} times the '
                     'noise')
    return lines
