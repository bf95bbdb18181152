"""`check`: the properties of a declared model and its runs, before a diagnosis."""

from __future__ import annotations

from collections.abc import Sequence
import time as clock

import numpy as np

from saddlering_ros.discrepancy.candidate import Candidate, Fit
from saddlering_ros.discrepancy.change_scale import orthonormal
from saddlering_ros.discrepancy.experiment import Experiment, refuse_repeats
from saddlering_ros.discrepancy.metric import Metric, noise_metric
from saddlering_ros.discrepancy.model import Model, Run
from saddlering_ros.discrepancy.model_diagnosis import prepared
from saddlering_ros.discrepancy.nuisances import offset_columns
from saddlering_ros.discrepancy.refit import fit_base, tangent
from saddlering_ros.discrepancy.signatures import effect_starts, MIN_SHARE

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
