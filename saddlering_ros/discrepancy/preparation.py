"""The start of a search: noise, nuisance parameters, base fit and signatures."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from saddlering_ros.discrepancy.candidate import Candidate, Fit
from saddlering_ros.discrepancy.change_scale import ChangeScale
from saddlering_ros.discrepancy.confirmed_limits import confirmed_limits
from saddlering_ros.discrepancy.detection_limits import detection_limits
from saddlering_ros.discrepancy.experiment import Experiment
from saddlering_ros.discrepancy.metric import Metric, noise_metric
from saddlering_ros.discrepancy.model_space import (
    ModelSpace,
    NoiseKnowledge,
    refit_full_jacobian,
)
from saddlering_ros.discrepancy.nuisances import nuisance_columns, offset_columns
from saddlering_ros.discrepancy.refit import (
    declared_start,
    fit_base,
    refit,
    run_refits,
    tangent,
)
from saddlering_ros.discrepancy.results import Observability
from saddlering_ros.discrepancy.settings import Settings
from saddlering_ros.discrepancy.signatures import (
    angle_matrix,
    measure_signatures,
    shapes_tried,
    whitened_by,
)
from saddlering_ros.discrepancy.system import Array, DiscrepancyError, System
from saddlering_ros.progress import Watch

MIN_PAIRS = 12
"""Smallest number of degrees of freedom of the level, whatever the length of the stretches."""

BASE_ROUNDS = 25
"""Rounds of the fit of the base parameters alone."""

MIN_DEEPER, MIN_DEEPER_SHARE = 10.0, 0.01
"""A minimum is deeper if its misfit is smaller by more than this, and by more than this share."""


def prepare(
    experiment: Experiment, start: Array | None, settings: Settings, watch: Watch
) -> ModelSpace:
    """Learn the noise, marginalise nuisance parameters, fit the base, compute signatures."""
    watch.progress('noise of the channels', 0.0)
    metric = noise_metric(experiment, experiment.assumptions.learn_noise(experiment.runs, None))
    metric = metric.marginalise(offset_columns(experiment))
    watch.progress('fit without effects', 0.05)
    rough = fit_base(metric, start, settings.seed, watch.check)
    return space_about(experiment, rough, settings, watch)


def space_about(
    experiment: Experiment, rough: Fit, settings: Settings, watch: Watch
) -> ModelSpace:
    """Learn the noise from the residual of a rough fit, fit the base, compute signatures."""
    residual = experiment.by_run(rough.prediction - experiment.measured)
    metric = noise_metric(
        experiment, experiment.assumptions.learn_noise(experiment.runs, residual)
    )
    metric = _with_nuisances(metric, rough)
    base = _fit_base_again(metric, rough, watch)
    watch.progress('sensitivity to each effect', 0.25)
    watch.check()
    sensitivities = tangent(metric, base)
    scale = ChangeScale(experiment, sensitivities.plain)
    signatures = measure_signatures(metric, base, sensitivities, scale)
    lines = sum(bool(effect.line) for effect in experiment.system.effects)
    trials = max(1, shapes_tried(signatures) + lines)
    known = _noise_knowledge(metric)
    return ModelSpace(
        metric=metric, base=base, base_tangent=sensitivities, signatures=signatures, scale=scale,
        trials=trials, known=known, settings=settings, watch=watch)


def better_base(space: ModelSpace, fit: Fit) -> Fit | None:
    """The base refitted from its parameters in the model with effects, if that minimum is deeper.

    Otherwise an effect without influence could be named because it leads the fit to another
    minimum.
    """
    if not fit.candidate.effects:
        return None
    count = space.base.theta_unit.size
    wanted = [
        refit(
            space.metric,
            Candidate(),
            fit.theta_unit[:count],
            rounds=space.settings.rounds,
            full_jacobian=True,
        )
    ]
    found = run_refits(space.metric, wanted, space.watch.check)[0]
    gain = space.base.misfit - found.misfit
    return found if gain > max(MIN_DEEPER, MIN_DEEPER_SHARE * found.misfit) else None


def moved_to(space: ModelSpace, fit: Fit) -> tuple[ModelSpace, Fit]:
    """Nuisance columns evaluated with the found effects, and base and model refitted.

    A load that is wrong by some percent moves the point at which rollers begin to touch, and
    with it the contribution of unequal rollers. Seen from the model without the effects, this
    difference is evidence.
    """
    metric = _with_nuisances(_relearnt(space.metric, fit), fit)
    base, fit = refit_full_jacobian(
        metric, [space.base, fit], space.settings.max_rounds, space.watch
    )
    sensitivities = tangent(metric, base)
    signatures = whitened_by(metric, space.signatures, sensitivities)
    moved = ModelSpace(
        metric=metric, base=base, base_tangent=sensitivities, signatures=signatures,
        scale=space.scale, trials=space.trials, known=_noise_knowledge(metric),
        settings=space.settings, watch=space.watch)
    return moved, moved.keep(fit)


def _with_nuisances(metric: Metric, fit: Fit) -> Metric:
    """The metric with every nuisance parameter marginalised, evaluated at `fit`."""
    return metric.marginalise(nuisance_columns(metric.experiment, fit.point, fit.prediction))


def _relearnt(metric: Metric, fit: Fit) -> Metric:
    """The noise, learnt again from the residual of a fit if its source is residuals."""
    experiment = metric.experiment
    if not experiment.assumptions.relearns:
        return metric
    residual = experiment.by_run(fit.prediction - experiment.measured)
    return noise_metric(experiment, experiment.assumptions.learn_noise(experiment.runs, residual))


def _fit_base_again(metric: Metric, rough: Fit, watch: Watch) -> Fit:
    """The base refitted in a new metric, from the rough fit and from the declared start.

    A large misfit has several minima.
    """
    starts = [
        rough.theta_unit,
        declared_start(metric.experiment.system.base_parameters),
    ]
    wanted = [
        refit(metric, Candidate(), start, rounds=BASE_ROUNDS, full_jacobian=True)
        for start in starts
    ]
    return min(run_refits(metric, wanted, watch.check), key=lambda fit: fit.misfit)


def _noise_knowledge(metric: Metric) -> NoiseKnowledge:
    """Knowledge of the level of slow noise: that of the run with the most of it."""
    pairs = [item.pairs for item in metric.noise.values()]
    return NoiseKnowledge(max(MIN_PAIRS, min(pairs)), max(MIN_PAIRS, max(pairs)))


def first_guess(system: System, start: Mapping[str, float] | None) -> Array | None:
    """First guesses of base parameters, bound-scaled; declared ones where none are given."""
    if start is None:
        return None
    known = {item.name: item for item in system.base_parameters}
    for name, value in start.items():
        if name not in known:
            raise DiscrepancyError(
                f'start: there is no base parameter {name!r}; there are {", ".join(known)}')
        item = known[name]
        if not (np.isfinite(value) and (item.periodic or item.low <= value <= item.high)):
            raise DiscrepancyError(
                f'start: {name} = {value:g} is outside {item.low:g} to {item.high:g}')
    return np.array(
        [
            item.to_unit(start[name]) if name in start else item.first_guess
            for name, item in known.items()
        ]
    )


def observed(space: ModelSpace) -> Observability:
    """Detection limits, and cosines between signatures, at the base fit."""
    settings = space.settings
    limits = detection_limits(
        space.signatures, settings.error_rate, settings.materiality, space.known.pairs
    )
    if space.metric.experiment.assumptions.many_valleys:
        trials = max(shapes_tried(space.signatures), 1)
        limits = confirmed_limits(space, limits, trials)
    labels, cosines = angle_matrix(space.signatures)
    return Observability(tuple(limits), tuple(labels), cosines)
