"""The criteria of selection, each a function of numbers: what is real, material, exhaustive."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Mapping

import numpy as np

from saddlering_ros.discrepancy.lack_of_fit import FastResidual, SlowResidual
from saddlering_ros.discrepancy.settings import Settings
from saddlering_ros.discrepancy.system import Array
from saddlering_ros.estimation.distributions import fisher_chance, fisher_limit

MAX_IN_ONE_VIEW = 2
"""Largest number of effects in one channel; more of them can fit any misfit."""

MAX_WITH_ALTERNATIVES = 2
"""Largest number of effects in a model of which some have alternatives."""

Sizes = Mapping[str, Array]
"""Rms shares of range: per view one number per run (R,)."""


def likelihood_ratio_test(gain: float, extra: int, pairs: int, trials: int) -> float:
    """p-value of a fall `gain` of the misfit by `extra` parameters, one of `trials` shapes.

    The noise is known from `pairs` independent differences.
    """
    return min(1.0, trials * float(fisher_chance(max(gain, 0.0) / extra, extra, pairs)))


def real_gain(pairs: int, trials: int, settings: Settings) -> float:
    """Gain at which `likelihood_ratio_test` of one parameter finds an effect real."""
    return float(fisher_limit(settings.error_rate / max(trials, 1), 1, pairs))


def real_and_material(residual: SlowResidual | FastResidual, settings: Settings) -> bool:
    """Whether a residual is more than noise, and large enough to matter."""
    return residual.p_value < settings.error_rate and residual.visible >= settings.materiality


def closes_misfit(
    p_value: float, gain: float, left: float, inflated_gain: float, settings: Settings
) -> bool:
    """Whether a further effect is beyond doubt and explains all but all of the misfit.

    gain: its fall of the misfit; left: excess misfit after it; inflated_gain: the fall that
    inflated nuisance parameters give in its place. The inexact form of another effect leaves no
    such misfit: it takes more than one other effect, or looks like nuisance parameters that are
    larger than usual, as rollers do whose clearances differ.
    """
    if p_value >= settings.error_rate**3 or gain < settings.min_total * (gain + left):
        return False
    return gain * settings.min_partial > inflated_gain


def exceeds_form_error(
    added: Sizes, known: Sizes, form_error: float, materiality: float
) -> list[str]:
    """Views in which `added` is more than the inexact form of what explains `known` could leave.

    Judged in every view of every run. A form leaves `form_error` of the misfit it explains
    where it acts, and by way of the base parameters, which give way to it, that share of this
    in the other runs; in a view where it has no part, what is immaterial.
    """
    views = []
    for view, size in added.items():
        own = known[view] ** 2
        form = np.sqrt(form_error * (own + form_error * own.max()))
        if np.any(size > np.maximum(form, materiality)):
            views.append(view)
    return views


def exceeds_forms(p_value: float, gain: float, left: float, settings: Settings) -> bool:
    """Whether a cause is real beside other forms of the laws found, and takes most of the rest.

    gain: fall of the misfit with these forms marginalised; left: excess misfit after it.
    """
    return p_value < settings.error_rate**2 and gain >= settings.min_partial * (gain + left)


def adds_new_channel(p_value: float, added: Sizes, known: Sizes, settings: Settings) -> bool:
    """Whether an effect surely adds what shows in a view where no other effect shows.

    Surely (the error rate squared), for an inexact form can reach a little into a view in
    which the catalogue's has no part.
    """
    if p_value >= settings.error_rate**2:
        return False
    least = settings.materiality
    return any(known[view].max() < least < size.max() for view, size in added.items())


def explained_share(before: SlowResidual, after: SlowResidual, settings: Settings) -> float:
    """Share of the misfit `before` that is gone `after`: in all, or in one material view."""
    shares = [1.0 - max(after.excess, 0.0) / max(before.excess, 1e-9)]
    shares += [
        1.0 - after.powers[view] / power
        for view, power in before.powers.items()
        if power >= settings.materiality**2
    ]
    return max(shares)


def alternative_floor(pairs: int, settings: Settings) -> float:
    """Misfit by which noise may set the better model back: more where its level is less sure.

    Of two models the wrong one is d ahead of the true one with a chance of at most that of a
    normal number beyond sqrt(d), however far apart the two are.
    """
    return fisher_limit(settings.alternative_rate, 1, pairs)


def indistinguishable(
    distance: float, taken: float, excess: float, fewer: int, floor: float, settings: Settings
) -> bool:
    """Whether these data leave an alternative open whose misfit is `distance` larger.

    The misfit that is left over (`excess`) makes the judgement milder. So does the misfit `taken`
    by the effect, since no effect's form is exact; and an alternative of `fewer` parameters is
    given that much for each, for it cannot bend to a form as the best could.
    """
    margin = floor + settings.alternative_share * min(excess, taken)
    return distance <= max(margin, settings.form_error * (1 + max(0, fewer)) * taken)


def too_many(effects: int) -> bool:
    """Whether a model has too many effects for one of them to have alternatives.

    With three effects and several choices for each, some model fits the misfit of a cause that is
    in no catalogue.
    """
    return effects > MAX_WITH_ALTERNATIVES


def crowded(explained: Iterable[Sizes], settings: Settings) -> bool:
    """Whether one view took more effects than can be told from a cause that is not known."""
    crowd: Counter[str] = Counter()
    for sizes in explained:
        crowd.update(view for view, size in sizes.items() if size.max() >= settings.materiality)
    return max(crowd.values(), default=0) > MAX_IN_ONE_VIEW
