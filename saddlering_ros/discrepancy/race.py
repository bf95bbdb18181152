"""Refits of many candidates together; candidates far behind stop after a few rounds."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from saddlering_ros.discrepancy.candidate import Fit
from saddlering_ros.discrepancy.model_space import (
    best_of_each,
    COARSE_ROUNDS,
    ModelSpace,
    starts_of_each,
    Trial,
)
from saddlering_ros.discrepancy.ranking import Score

RACE_ROUNDS = 2
"""Rounds of a refit that every candidate receives while much misfit remains."""

SCREENED_SHARE = 0.1
"""Smallest expected share of the gain of the best candidate for a candidate to receive these
rounds. The expectation is the first-order gain of all its parameters together, at its start. The
value is a fifth of CLOSE_SHARE."""

CLOSE_SHARE = 0.5
"""Smallest expected share of the gain of the best refit for a refit to continue after these
rounds."""


def fit_each(
    space: ModelSpace, fit: Fit, scores: Sequence[Score], beside: Sequence[Fit] = ()
) -> list[Fit]:
    """The model of `fit` plus each scored candidate, refitted together, the best first.

    A candidate far behind the best one, or far behind the fits `beside`, stops after a few rounds.
    """
    candidates = [fit.candidate.plus(score.effect, score.variant) for score in scores]
    wanted = [
        score
        for candidate, score in zip(candidates, scores, strict=True)
        if not space.is_fitted(candidate)
    ]
    close, behind = _heats(space, fit, starts_of_each(wanted), beside)
    for item in [*space.refine(close), *behind]:
        space.keep(item)
    different = {candidate.key: candidate for candidate in candidates}.values()
    found = [space.fit_of(candidate) for candidate in different if space.is_fitted(candidate)]
    return sorted(found, key=space.penalised)


def fit_race(
    space: ModelSpace, fit: Fit, first: Sequence[Fit], others: Sequence[Score]
) -> list[Fit]:
    """`first` and the best of the model of `fit` plus `others`, refined, the best first.

    Every candidate is refitted for a few rounds with free base parameters, because a
    first-order gain is a poor guide to an effect that the base fit imitates. A
    candidate is refined if the slopes of its residual promise a good share of the gain
    of the best one.
    """
    others = [
        score
        for score in others
        if not space.is_fitted(fit.candidate.plus(score.effect, score.variant))
    ]
    if not others:
        return list(first)
    trials = [(score, [score.start]) for score in others]
    coarse = sorted(_raced(space, fit, trials, first), key=space.foreseen)
    close, _ = _split(space, fit, coarse, first, CLOSE_SHARE)
    leading: dict[str, Fit] = {}
    for item in close:
        leading.setdefault(item.candidate.ids[-1], item)
    joining = list(leading.values())[: space.settings.refits]
    found = [space.keep(item) for item in space.refine(joining)]
    return sorted([*first, *found], key=space.penalised)


def _raced(
    space: ModelSpace, fit: Fit, trials: Sequence[Trial], beside: Sequence[Fit]
) -> list[Fit]:
    """The model of `fit` plus each candidate from each start, after a few rounds or none.

    A candidate receives no rounds if these are hopeless. Base parameters at their bounds have no
    first-order gain at the start. In that case all candidates receive the rounds.
    """
    if space.stopped_base(fit).any():
        return space.started(fit, trials, RACE_ROUNDS)
    screened = space.started(fit, trials, rounds=0)
    going, resting = _split(space, fit, screened, beside, SCREENED_SHARE)
    return [*resting, *space.continued(going, RACE_ROUNDS)]


def _heats(
    space: ModelSpace, fit: Fit, trials: Sequence[Trial], beside: Sequence[Fit]
) -> tuple[list[Fit], list[Fit]]:
    """Each candidate from its best start: the candidates close to the best one, and the others."""
    going, behind = _split(space, fit, _raced(space, fit, trials, beside), beside, CLOSE_SHARE)
    going = best_of_each(space.continued(going, COARSE_ROUNDS - RACE_ROUNDS))
    followed = {item.candidate.key for item in going}
    behind = [item for item in best_of_each(behind) if item.candidate.key not in followed]
    return going, behind


def _split(
    space: ModelSpace, fit: Fit, fits: Sequence[Fit], beside: Sequence[Fit], share: float
) -> tuple[list[Fit], list[Fit]]:
    """Fits that promise this share of the gain of the best fit or of `beside`, and the others.

    The slopes of a fit's residual give its promise.
    """
    foreseen = [space.foreseen(item) for item in fits]
    lowest = min([*foreseen, *map(space.foreseen, beside)], default=np.inf)
    highest = space.penalised(fit) - share * (space.penalised(fit) - lowest)
    going = [item for item, end in zip(fits, foreseen, strict=True) if end < highest]
    resting = [item for item, end in zip(fits, foreseen, strict=True) if not end < highest]
    return going, resting
