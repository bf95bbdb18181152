"""Doubts of a declared model by its noise: a level that is not the declared one, slow noise."""

from collections.abc import Mapping
from copy import copy
from dataclasses import dataclass, replace

import numpy as np

from saddlering_ros.discrepancy.noise import (
    is_correlated,
    Noise,
    noise_sentence,
    ONE_RELAXATION,
    WANDERING,
    wrong_level,
)
from saddlering_ros.discrepancy.problem import system as systems
from saddlering_ros.discrepancy.problem.fits import Fit
from saddlering_ros.discrepancy.problem.metric import Metric, noise_metric
from saddlering_ros.discrepancy.problem.model import ModelSystem
from saddlering_ros.discrepancy.problem.problem import Problem
from saddlering_ros.discrepancy.search.lack_of_fit import is_noise_alone
from saddlering_ros.discrepancy.verdict import results, wording
from saddlering_ros.estimation import record_noise
from saddlering_ros.estimation.process import ChannelNoise
from saddlering_ros.quantities import percent, quantity

OPEN = {'none': 0.5, 'unknown': 0.5}
"""Probabilities of a misfit that is smaller than declared noise and is no noise itself: nothing is
known of how often a cause hides there."""


def with_noise_doubts(diagnosis: results.Diagnosis, system: ModelSystem) -> results.Diagnosis:
    """The same with a warning, and without a name, if the misfit does not agree with the noise.

    Noise that is declared too large can hide a cause, or what a wrong law leaves. `none` stays
    where the misfit is noise of a smaller size, or too small to matter. Where a model error is
    declared, a residual far below it is what the declaration says, and one below it is nothing.
    Noise that is learnt holds a part of the misfit of a cause, so that it is far above what a
    right cause leaves.
    """
    metric, fit = diagnosis.fits.metric.with_offsets(), diagnosis.fits.after
    problem = metric.problem
    allowed = problem.assumptions.allowed_error or (0.0,) * len(problem.channel_ranges)
    residual = fit.prediction - problem.measured
    white = metric.whiten(residual)
    rounding = (systems.JITTER * float(problem.channel_ranges.max())) ** 2
    under, over, not_noise = [], [], []
    small: dict[str, tuple[float, str]] = {}
    for index, channel, part in problem.slices:
        run, name = problem.runs[index], problem.system.channel_names[channel]
        there = slice(None) if run.present is None else run.present[channel]
        left = residual[part][there]
        statistic = float(white[part] @ white[part])
        # Of the fitted parameters, a run may take up all, or none beside many other runs.
        free = float(np.clip(
            statistic, max(left.size - fit.theta_unit.size - 1, 1), left.size))
        noise = metric.noise[run.name, channel]
        # Noise that is only the rounding in every metric is not declared too large.
        has_noise = float(noise.variances(run.width).max()) > rounding
        is_learnt = system.model.channels[name].noise.learns_from_residuals
        side, where = wrong_level(statistic, free, noise.pairs), f'{name} in {run.name}'
        if side == 'over' and has_noise and not is_learnt and not allowed[channel]:
            over.append(noise_sentence(side, statistic, free, where))
            size = float(np.mean(left**2)) ** 0.5 / problem.view_ranges[name]
            if size >= problem.settings.materiality and is_correlated(white[part][there]):
                not_noise.append(where)
        beyond = float(np.mean(left**2)) * (1.0 - free / max(statistic, free))
        least = max(problem.settings.materiality, allowed[channel])
        share = beyond**0.5 / problem.view_ranges[name]
        if side == 'under' and share >= least:
            under.append(noise_sentence(side, statistic, free, where))
        elif side == 'under' and not (is_learnt or allowed[channel]):
            ratio = (statistic / free) ** 0.5
            small[name] = max(small.get(name, (0.0, '')), (ratio, wording.BEYOND_NOISE.format(
                name, run.name, ratio, percent(share))))
    if diagnosis.verdict == 'unknown' or diagnosis.remainder:
        under, small = [], {}  # The warning on a remaining misfit is given already.
    doubts = [] if diagnosis.verdict == 'unknown' or not over else [
        wording.WRONG_LAW_HIDES] if diagnosis.causes else [
        wording.NOT_NOISE.format(where) for where in not_noise[:1]]
    told = replace(diagnosis, warnings=(
        *over, *under, *(sentence for _, sentence in small.values()), *doubts,
        *diagnosis.warnings))
    return unestablished(told, is_more=bool(under)) if under or doubts else told


@dataclass(frozen=True)
class _Learnt:
    """Channels of a declared machine whose noise is learnt, in the problem of a diagnosis."""

    system: ModelSystem
    problem: Problem

    @property
    def channels(self) -> dict[str, int]:
        """Place of each by its name."""
        return {name: number for number, name in enumerate(self.system.channel_names)
                if self.system.model.channels[name].noise.learns_from_residuals}

    def metric(self, noise: Mapping[str, Noise], fit: Fit) -> Metric:
        """The metric of the residual of a fit with another noise in these channels."""
        other, channels = copy(self.system), self.system.model.channels
        other.model = replace(self.system.model, channels={**channels, **{
            name: replace(channels[name], noise=own) for name, own in noise.items()}})
        return noise_metric(replace(self.problem, assumptions=other.assumptions()), fit.prediction)

    def alike(self, noise: Noise, fit: Fit) -> tuple[Metric, dict[str, list[ChannelNoise]]]:
        """The metric with one noise in all, and what it is for each of them in each run."""
        metric = self.metric(dict.fromkeys(self.channels, noise), fit)
        return metric, {name: [metric.sensors[run.name, place] for run in self.problem.runs]
                        for name, place in self.channels.items()}

    def walks(self, fit: Fit) -> str:
        """Declarations of random walks beside which a fit leaves nothing; '' if it does."""
        longest, walks = max(float(np.ptp(run.time)) for run in self.problem.runs), {}
        for name, each in self.alike(WANDERING, fit)[1].items():
            walk = np.mean([_squared_walk(one) for one in each]) ** 0.5
            if walk * longest**0.5 >= self.problem.settings.materiality:
                scale = self.system.scales[self.channels[name]]
                walks[name] = float(f'{scale * walk:.2g}')
        noise = {name: Noise.unknown(walk) for name, walk in walks.items()}
        if not walks or not is_noise_alone(self.metric(noise, fit).with_offsets(), fit):
            return ''
        return wording.joined([
            f'{name}: Noise.unknown(walk={walk:.2g})' for name, walk in walks.items()])

    def relaxations(self, fit: Fit) -> str:
        """Correlation times by which noise leaves a fit nothing; '' if it does or is a drift."""
        metric, noise = self.alike(ONE_RELAXATION, fit)
        times = {name: [float(one.time_constants.max(initial=0.0)) for one in each]
                 for name, each in noise.items()}
        longest = [record_noise.longest_relaxation(float(np.ptp(run.time)))
                   for run in self.problem.runs]
        is_drift = any(np.greater_equal(each, longest).any() for each in times.values())
        if is_drift or not is_noise_alone(metric.with_offsets(), fit):
            return ''
        return wording.joined([
            f'{quantity(max(each), self.problem.time_unit, digits=2)} in {name}'
            for name, each in times.items()])


def with_slow_noise(diagnosis: results.Diagnosis, system: ModelSystem) -> results.Diagnosis:
    """The same with a warning if a misfit shows nothing but what slow noise would show.

    Noise is learnt from the fast part of a residual, and is assumed to have a flat spectrum below.
    Slower noise then looks like a cause that no catalogue holds.
    """
    fits = diagnosis.fits
    problem, base = fits.metric.problem, fits.before
    learnt = _Learnt(system, problem)
    if diagnosis.verdict != 'unknown' or not learnt.channels:
        return diagnosis
    if words := learnt.relaxations(base):
        note = wording.SLOW_NOISE.format(words)
    elif diagnosis.residual_before.slow.p_value >= problem.settings.error_rate:
        return diagnosis  # What held-out runs alone show is no noise of the fitted ones.
    elif words := learnt.walks(base):
        note = wording.WANDERING.format(words)
    elif diagnosis.causes and (words := learnt.walks(fits.after)):
        return replace(diagnosis, warnings=(wording.BESIDE_WANDERING.format(
            diagnosis.causes[0].definition.title, words), *diagnosis.warnings))
    else:
        return diagnosis
    chances = diagnosis.probabilities if diagnosis.causes else OPEN
    return replace(diagnosis, probabilities=chances, warnings=(note, *diagnosis.warnings))


def _squared_walk(noise: ChannelNoise) -> float:
    """The square of the random walk of a noise that has one as its last relaxation."""
    return float(2.0 * noise.slow[-1] / noise.time_constants[-1]) if noise.slow.size else 0.0


def unestablished(diagnosis: results.Diagnosis, *, is_more: bool = False) -> results.Diagnosis:
    """The same without a name; is_more: whether the misfit is surely more than the noise."""
    doubted = diagnosis.in_doubt()
    return doubted if doubted.causes or is_more else replace(doubted, probabilities=OPEN)
