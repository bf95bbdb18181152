"""The next test: the possible test that most often leaves only the true model."""

from __future__ import annotations

from collections.abc import Sequence

from saddlering_ros.discrepancy.candidate import Fit
from saddlering_ros.discrepancy.criteria import alternative_floor
from saddlering_ros.discrepancy.model_space import ModelSpace
from saddlering_ros.discrepancy.selection import Alternatives
from saddlering_ros.discrepancy.separation import (
    JudgingRule,
    OpenModel,
    Proposal,
    Separation,
    simulate_tests,
)


def separate_open_models(
    space: ModelSpace, fit: Fit, alternatives: Alternatives, proposals: Sequence[Proposal]
) -> tuple[Separation, ...]:
    """The proposed tests, the best first, with their separation of a model and alternatives."""
    others = [
        OpenModel(other, space.without(fit, name))
        for name, found in alternatives.items()
        for other in found
    ]
    if not others or not proposals:
        return ()
    rule = JudgingRule(
        floor=alternative_floor(space.known.pairs, space.settings),
        excess=max(space.slow_residual(fit).excess, 0.0),
        log_size=space.log_size,
        settings=space.settings,
    )
    open_models = [OpenModel(fit, others[0].less), *others]
    return tuple(simulate_tests(
        space.metric, open_models, space.tangent_of, proposals, rule, seed=space.settings.seed))
