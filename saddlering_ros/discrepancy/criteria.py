"""The criteria of selection as functions of numbers: real, material, exhaustive."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Mapping

import numpy as np

from saddlering_ros.discrepancy.lack_of_fit import FastResidual, SlowResidual
from saddlering_ros.discrepancy.settings import Settings
from saddlering_ros.discrepancy.system import Array
from saddlering_ros.estimation.statistics import fisher_chance, fisher_limit

MAX_IN_ONE_VIEW = 2
"""Largest number of effects in one channel. More effects can fit any misfit."""

MAX_WITH_ALTERNATIVES = 2
"""Largest number of effects in a model of which some have alternatives."""

Sizes = Mapping[str, Array]
"""Rms shares of range: per view one number per run (R,)."""


def likelihood_ratio_test(gain: float, extra: int, pairs: int, trials: int) -> float:
    """p-value of a fall `gain` of the misfit by `extra` parameters, as one of `trials` shapes.

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
    """Whether a further effect is certain and explains almost all of the misfit.

    gain: fall of the misfit by the effect; left: excess misfit with the effect; inflated_gain:
    fall by inflated nuisance parameters in its place. The form error of another effect does
    not leave such a misfit: it needs more than one other effect to explain, or resembles
    nuisance parameters that are larger than usual, like those of rollers with different
    clearances.
    """
    if p_value >= settings.error_rate**3 or gain < settings.min_total * (gain + left):
        return False
    return gain * settings.min_partial > inflated_gain


def exceeds_form_error(
    added: Sizes, known: Sizes, form_error: float, materiality: float
) -> list[str]:
    """Views in which `added` exceeds the form error of the effects that explain `known`.

    Every view of every run is judged. A form leaves a share `form_error` of the misfit that it
    explains where it acts. In the other runs it leaves the same share of this remainder,
    because base parameters adapt to it. In a view in which the effect has no part, the
    immaterial size is the limit.
    """
    views = []
    for view, size in added.items():
        own = known[view] ** 2
        form = np.sqrt(form_error * (own + form_error * own.max()))
        if np.any(size > np.maximum(form, materiality)):
            views.append(view)
    return views


def exceeds_forms(
    p_value: float, gain: float, plain_gain: float, left: float, settings: Settings
) -> bool:
    """Whether a cause is real beside other forms of the found laws, and explains most of the rest.

    gain: fall of the misfit with these forms marginalised, p_value of it; plain_gain: the same
    fall without forms; left: excess misfit with the cause and these forms. If forms explain a
    part of the fall, the cause must be certain, because the prior of the forms is rough. If they
    explain nothing of it, the cause is judged as a first one.
    """
    if gain < settings.min_partial * (gain + left):
        return False
    has_no_form = gain >= settings.min_total * plain_gain
    return p_value < (settings.error_rate if has_no_form else settings.error_rate**2)


def adds_new_channel(p_value: float, added: Sizes, known: Sizes, settings: Settings) -> bool:
    """Whether an effect surely explains misfit in a view in which no other effect shows.

    Surely means at the square of the error rate, because an inexact form can have a small part
    in a view in which the form of the catalogue has none.
    """
    if p_value >= settings.error_rate**2:
        return False
    least = settings.materiality
    return any(known[view].max() < least < size.max() for view, size in added.items())


def explained_share(before: SlowResidual, after: SlowResidual, settings: Settings) -> float:
    """Share of the misfit `before` that `after` has not: in all, or in one material view."""
    shares = [1.0 - max(after.excess, 0.0) / max(before.excess, 1e-9)]
    shares += [
        1.0 - after.powers[view] / power
        for view, power in before.powers.items()
        if power >= settings.materiality**2
    ]
    return max(shares)


def alternative_floor(pairs: int, settings: Settings) -> float:
    """Misfit by which noise may put the true model behind another; more if the level is uncertain.

    The chance that a wrong model is better by d than the true one is at most that of a normal
    number beyond sqrt(d), however different the two models are.
    """
    return fisher_limit(settings.alternative_rate, 1, pairs)


def indistinguishable(
    distance: float, taken: float, excess: float, fewer: int, floor: float, settings: Settings
) -> bool:
    """Whether these data leave an alternative open whose misfit is `distance` larger.

    The limit rises with the remaining misfit (`excess`) and with the misfit `taken` by the
    effect, because no form is exact. An alternative with `fewer` parameters receives an
    allowance for each of them, because it cannot adapt to a form as the best model can.
    """
    margin = floor + settings.alternative_share * min(excess, taken)
    return distance <= max(margin, settings.form_error * (1 + max(0, fewer)) * taken)


def too_many(effects: int) -> bool:
    """Whether a model has too many effects for one of them to have alternatives.

    With three effects and several choices for each, some model fits the misfit of a cause that
    is in no catalogue.
    """
    return effects > MAX_WITH_ALTERNATIVES


def crowded(explained: Iterable[Sizes], settings: Settings) -> bool:
    """Whether one view has too many effects to exclude a cause that is not in the catalogue."""
    crowd: Counter[str] = Counter()
    for sizes in explained:
        crowd.update(view for view, size in sizes.items() if size.max() >= settings.materiality)
    return max(crowd.values(), default=0) > MAX_IN_ONE_VIEW
