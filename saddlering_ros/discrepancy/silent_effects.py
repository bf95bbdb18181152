"""Effects that the base fit conceals, tried from starts over the whole range of the base.

A threshold that the base fit never reaches has no signature there, although the data may show it:
a tank that the fit takes for half full does not overflow. Similarly, an oscillation that is fitted
with one turn too many lies in a minimum of its own, in which its missing effect explains nothing.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from saddlering_ros.discrepancy.candidate import Candidate, Fit
from saddlering_ros.discrepancy.model_space import ModelSpace
from saddlering_ros.discrepancy.refit import (
    COARSE_BASE,
    MAX_BASE_STARTS,
    refit,
    run_refits,
    spread_starts,
)
from saddlering_ros.discrepancy.signatures import effect_starts, MIN_LENGTH, Signature
from saddlering_ros.discrepancy.system import Array, Effect

MAX_STARTS = 3
"""Number of first guesses of a silent effect for each start of the base."""


def silent_effects(signatures: Sequence[Signature]) -> list[tuple[Effect, int]]:
    """Effects and variants whose starts change the prediction by less than the noise hides."""
    loudest: dict[tuple[str, int], float] = {}
    known: dict[tuple[str, int], Effect] = {}
    for item in signatures:
        known[item.key] = item.effect
        change = item.length / item.share if item.share > 0.0 else 0.0
        loudest[item.key] = max(loudest.get(item.key, 0.0), change)
    return [(known[key], key[1]) for key, change in loudest.items() if change < MIN_LENGTH]


def fit_silent(space: ModelSpace) -> list[Fit]:
    """The base and each silent effect alone, from starts with influence; the best first."""
    return _fit_from_all_over(space, silent_effects(space.signatures), MAX_STARTS)


def fit_in_other_valleys(space: ModelSpace) -> list[Fit]:
    """The base and each effect alone, fitted from starts over the whole range of the base.

    Without its effect the base can be in a minimum from which no path leads to the true one.
    """
    known = {item.key: (item.effect, item.variant) for item in space.signatures}
    return _fit_from_all_over(space, list(known.values()), starts=1)


def _fit_from_all_over(
    space: ModelSpace, effects: Sequence[tuple[Effect, int]], starts: int
) -> list[Fit]:
    """The base and each effect alone, the best of several starts; the best first.

    starts: first guesses of an effect for each start of the base.
    """
    found = []
    for effect, variant in effects:
        fits = _coarse(space, Candidate(((effect, variant),)), effect, starts)
        if fits:
            best = min(fits, key=lambda fit: fit.misfit)
            found += [space.keep(fit) for fit in space.refine([best])]
    return sorted(found, key=space.penalised)


def _coarse(space: ModelSpace, candidate: Candidate, effect: Effect, count: int) -> list[Fit]:
    """A few rounds from those starts of base and effect at which the effect has influence."""
    metric = space.metric
    base = metric.experiment.system.base_parameters
    thetas = spread_starts(base, space.settings.seed)
    alone = metric.experiment.predict([Candidate().point(base, theta) for theta in thetas])
    trials: list[tuple[float, Array]] = []
    for start in effect_starts(effect)[:count]:
        whole = [np.concatenate([theta, start]) for theta in thetas]
        space.watch.check()
        seen = metric.experiment.predict([candidate.point(base, item) for item in whole])
        change = np.linalg.norm(metric.whiten(seen - alone), axis=0)
        left = metric.whiten(seen - metric.experiment.measured[:, None])
        misfit = (left**2).sum(axis=0)
        acts = np.isfinite(misfit) & (change > MIN_LENGTH)
        trials += [(float(misfit[number]), whole[number]) for number in np.flatnonzero(acts)]
    trials.sort(key=lambda trial: trial[0])
    return run_refits(
        metric,
        [
            refit(metric, candidate, item, rounds=COARSE_BASE, full_jacobian=True)
            for _, item in trials[:MAX_BASE_STARTS]
        ],
        space.watch.check,
    )
