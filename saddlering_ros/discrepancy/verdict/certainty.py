"""How sure a verdict is: probabilities, and how far it hangs on runs, model error and chance.

Every model that was fitted is refitted to first order with other weights of the stretches of the
runs: without each run, and with stretches drawn again, as another seed of the noise would. The
model error and other nuisance parameters are half and twice as large as well. All this needs no
simulation, because fits keep their residuals and sensitivities.
"""

from collections.abc import Sequence

import numpy as np

from saddlering_ros.discrepancy.problem.fits import Fit, PRIOR
from saddlering_ros.discrepancy.problem.problem import Metric
from saddlering_ros.discrepancy.problem.system import Array, FREE_STRENGTH
from saddlering_ros.discrepancy.search.evidence import Comparison
from saddlering_ros.discrepancy.search.selection import Alternatives
from saddlering_ros.discrepancy.search.space import FREE_SPREAD, ModelSpace
from saddlering_ros.discrepancy.verdict import wording
from saddlering_ros.discrepancy.verdict.established import MIN_TAKEN, STRETCHES
from saddlering_ros.discrepancy.verdict.naming import allowed_sizes
from saddlering_ros.discrepancy.verdict.results import Cause, Influence, Refit, Verdict
from saddlering_ros.estimation.least_squares import covariance
from saddlering_ros.estimation.statistics import fisher_chance

SEEDS = 6
"""Number of draws of stretches: with the runs left out, about ten refits of usual data."""

MIN_STABLE = 0.8
"""Share of refits with the same first cause below which a verdict is near its limit."""

WITHOUT = 'without '
"""Begin of the change of a refit that leaves out a run."""

MIN_SHARED = 0.5
"""Share of refits with the same first cause below which nothing is established: another cause is
the first more often. Of 625 causes established in sealed draws of docs/benchmarks, 624 were at
0.73 and above, and a stand-in at 0.09."""

NEAR = 2.0
"""Factor of the gain at which an effect is real within which a verdict is near its limit."""

SUREST, HALF_LEFT, STEEPNESS = 0.975, 0.38, 2.3
"""How often a first cause that leaves nothing is right, the share of the misfit's power beyond
noise that it leaves when it is half as often right, and the power of that share with which its
chance falls. Maximum likelihood on 571 draws of docs/benchmarks (0.975, 0.384 and 2.26), of which
a quarter has the true law taken out."""

MIN_RIGHT, SHARE_RIGHT = 0.1, 0.54
"""How often causes that are not established hold the true one if they take nothing, and how much
more often if they take all of the misfit. Maximum likelihood on 462 such verdicts of the draws of
docs/benchmarks (0.11 and 0.52 on the older half, 0.09 and 0.57 on the other). What they take tells
less than of established causes: on an imperfect machine a true cause often takes little, on a
perfect one a stand-in takes most of the misfit."""

SAME_SIZE = 0.02
"""Share by which the sizes of one law may differ from run to run and from channel to channel: no
machine keeps its size better. Without it, a true law of 94 to 103 % was refused. Up to 0.03 all
stand-ins of development, which differ by 40 to 60 %, are refused; with 0.05 one of four is not."""

NOTHING = 0.97
"""How often nothing was there if no misfit beyond noise was found in draws: 138 of 143."""


def uncertain_size(space: ModelSpace, causes: Sequence[Cause]) -> list[str]:
    """A sentence if the 95 % interval of the size of the main cause includes its absence.

    A declared model error is all in that interval, and has a limit of its own.
    """
    if not space.problem.assumptions.exact_laws or any(allowed_sizes(space).values()):
        return []
    for cause in sorted(causes, key=lambda one: -one.visible)[:1]:
        size = cause.parameters[cause.definition.size.name]
        low, high = size.interval or (np.inf, np.inf)
        if low <= cause.definition.neutral <= high:
            return [wording.uncertain_size_words(cause.effect, low, high, size.unit)]
    return []


def unsteady_sizes(space: ModelSpace, fit: Fit, causes: Sequence[Cause]) -> list[str]:
    """A sentence for every cause that needs another size in each run, or in each channel.

    A law has one size wherever it acts. The size of a stand-in follows the conditions. Sizes that
    differ by more than model error and the stated interval explain are those of another law.
    """
    stated = {cause.effect: cause.parameters[cause.definition.size.name] for cause in causes}
    sentences = []
    slices = fit.candidate.slices(len(space.problem.system.base_parameters))
    changes = space.problem.changes_of_effects(fit.point, fit.prediction).T
    for (effect, _, part), change in zip(slices, changes, strict=True):
        size = stated[effect.id]
        interval = size.std / max(abs(size.value - effect.neutral), 1e-300)
        for kind, place in (('run', 0), ('channel', 1)):
            sizes, errors = _freed_sizes(space, fit, part.start, change, place)
            allowed = interval**2 + SAME_SIZE**2
            weights = np.linalg.inv(errors + allowed * np.eye(sizes.size))
            apart = sizes - (weights @ sizes).sum() / max(weights.sum(), 1e-300)
            freedom = max(sizes.size - 1, 1)
            ratio = float(apart @ weights @ apart) / freedom
            if fisher_chance(ratio, freedom, space.pairs) < space.settings.error_rate:
                sentences.append(wording.unsteady_size_words(
                    effect.id, kind, 1.0 + float(sizes.min()), 1.0 + float(sizes.max())))
    return sentences


def _freed_sizes(
    space: ModelSpace, fit: Fit, size: int, change: Array, place: int
) -> tuple[Array, Array]:
    """Sizes (k,) of a cause by which it exceeds its fit, as shares of it, and their covariance.

    size: index of the size among the parameters; change: what the cause changes (n,); place: 0
    for a size of each run, 1 for one of each channel. Sizes that these data do not show are left
    out.
    """
    owners = np.array([slot[:2] for slot in space.problem.slices])[:, place]
    columns = np.zeros((change.size, 1 + int(owners.max())))
    for (_, _, part), owner in zip(space.problem.slices, owners, strict=True):
        columns[part, owner] = change[part]
    others = np.delete(space.tangent_of(fit).white, size, axis=1)
    jacobian = np.hstack([space.metric.whiten(columns), others])
    errors = covariance(jacobian, 1.0 / FREE_SPREAD)
    sizes = -(errors @ (jacobian.T @ fit.whitened))[: columns.shape[1]]
    shown = np.flatnonzero(np.diag(errors)[: sizes.size] < 1.0)
    return sizes[shown], errors[np.ix_(shown, shown)]


def unshared(refits: Sequence[Refit]) -> list[str]:
    """A sentence if most refits of a model with causes end in another first cause."""
    share = float(np.mean([refit.is_same for refit in refits]))
    return [] if share >= MIN_SHARED else [wording.unshared_words(share, MIN_SHARED)]


def stability_of(
    space: ModelSpace, fit: Fit, alternatives: Alternatives, taken: float | None
) -> tuple[tuple[Refit, ...], tuple[str, ...], tuple[Influence, ...]]:
    """How far the verdict on a fit hangs on runs, on model error and on chance.

    Refits of all models, why the verdict is near its limit, and what each stretch adds. taken:
    share of the misfit that causes beside model error take.
    """
    refits = _refits(space, fit, alternatives)
    falls = space.base.whitened**2 - fit.whitened**2
    influence = tuple(
        Influence(run.name, float(run.time[part[0]]), float(run.time[part[-1]]),
                  float(fall[:, part].sum()))
        for run, fall in zip(space.problem.runs, space.problem.by_run(falls), strict=True)
        for part in np.array_split(np.arange(run.time.size), STRETCHES) if part.size)
    return refits, _near_limit(space, fit, refits, taken), influence


def _refits(space: ModelSpace, fit: Fit, alternatives: Alternatives) -> tuple[Refit, ...]:
    """Refits of all models to first order, each with the first cause that it ends in.

    A refit ends in the same first cause if its best model shares an effect with the model found
    or with an alternative to it, or has a law that contains such an effect or is contained in it.
    Bounds do not stop a step: where an effect of the other sign fits as well, so may another law.
    """
    found = [fit, *(other for others in alternatives.values() for other in others)]
    models = {item.candidate.key: item for item in (
        space.base, *space.single_effect_fits(), *found)}
    answers = []
    wanted = {name for item in found for name in item.candidate.ids}
    narrower = {name for item in found for effect, _ in item.candidate.effects
                for name in effect.contains}
    # What changes, the factor of the model error, and weights (R, S) of the stretches.
    runs = space.problem.runs
    plain = np.ones((len(runs), STRETCHES))
    cases = [(WITHOUT + run.name, 1.0, plain - row[:, None])
             for run, row in zip(runs, np.eye(len(runs)), strict=True) if len(runs) > 1]
    random = np.random.default_rng(space.settings.seed)
    for number in range(SEEDS):
        drawn = random.integers(0, plain.size, plain.size)
        cases.append((f'stretches drawn again, {number + 1}', 1.0,
                      np.bincount(drawn, minlength=plain.size).astype(float)))
    cases += [('half the model error', 0.5, plain), ('twice the model error', 2.0, plain)]
    for factor in (1.0, 0.5, 2.0):
        sums = [_Sums(space.metric, factor, model) for model in models.values()]
        for change, own, weights in cases:
            if own == factor:
                best = min(sums, key=lambda one: one.penalised(space, weights.ravel()))
                effects = [effect for effect, _ in best.fit.candidate.effects]
                is_same = any(effect.id in wanted | narrower or wanted & set(effect.contains)
                              for effect in effects) if effects else not wanted
                answers.append(Refit(change, effects[0].id if effects else None, is_same))
    return tuple(answers)


class _Sums:
    """Products of residual and sensitivities of a fit by stretch, for any weights of stretches.

    factor: of the model error and other nuisance parameters with a spread.
    """

    def __init__(self, metric: Metric, factor: float, fit: Fit) -> None:
        self.fit = fit
        shared = metric.shared
        strength = shared.strength
        other = np.where(strength < FREE_STRENGTH, factor * strength, strength)
        ratio = np.sqrt((1.0 + strength**2) / (1.0 + other**2)) - 1.0
        columns = np.column_stack([fit.jacobian, fit.whitened])
        columns = columns + shared.directions @ (ratio[:, None] * (shared.directions.T @ columns))
        parts = [
            block[:, part].reshape(-1, columns.shape[1])
            for block in metric.problem.by_run(columns)
            for part in np.array_split(np.arange(block.shape[1]), STRETCHES)]
        self._products = np.array([part.T @ part for part in parts])

    def penalised(self, space: ModelSpace, weights: Array) -> float:
        """Misfit after one step, plus the price of its parameters and of its first effect."""
        products = np.tensordot(weights, self._products, axes=1)
        gram, slope = products[:-1, :-1], products[:-1, -1]
        misfit = products[-1, -1] - slope @ np.linalg.solve(
            gram + PRIOR**2 * np.eye(slope.size), slope)
        price = space.log_size * self.fit.theta_unit.size
        if self.fit.candidate.effects:
            price += max(space.real_gain - space.log_size, 0.0)
        return float(misfit) + price


def _near_limit(
    space: ModelSpace, fit: Fit, refits: Sequence[Refit], taken: float | None
) -> tuple[str, ...]:
    """Why a verdict is near its limit, one sentence each."""
    others = [refit for refit in refits if not refit.is_same]
    sentences = [wording.one_run_words(refit) for refit in others
                 if refit.change.startswith(WITHOUT)]
    if len(others) > (1.0 - MIN_STABLE) * len(refits):
        sentences.append(wording.unstable_words(others, len(refits)))
    if not fit.candidate.effects:
        gain, name = max(((space.base.misfit - single.misfit, single.candidate.ids[0])
                          for single in space.single_effect_fits()), default=(0.0, ''))
        if gain > space.real_gain / NEAR:
            sentences.append(wording.almost_a_cause_words(name, gain / space.real_gain))
    for name in fit.candidate.ids:
        one = Comparison(space, space.without(fit, name), fit)
        if one.gain < NEAR * space.real_gain:
            sentences.append(wording.barely_real_words(name, one.gain / space.real_gain))
    if taken is not None and MIN_TAKEN <= taken < 0.5 * (1.0 + MIN_TAKEN):
        sentences.append(wording.barely_taken_words(taken, MIN_TAKEN))
    return tuple(sentences)


def probabilities_of(
    verdict: Verdict, causes: Sequence[Cause] = (), taken: float = 0.0
) -> dict[str, float]:
    """Probability of each cause or group, of none, and of a cause not listed; they sum to 1.

    The chance of established causes falls with a power of the share of the misfit that they leave
    (1 less `taken`), of at most what they may leave beside model error: if they leave noise alone,
    the held-out runs may have none. That of others is smaller and rises in proportion to `taken`,
    which is 0 where their law may be another. Several share by the power that each moves.
    """
    if verdict == 'none':
        return {'none': NOTHING, 'unknown': 1.0 - NOTHING}
    left = float(np.clip(1.0 - taken, 0.0, 1.0 - MIN_TAKEN))
    chance = SUREST / (1.0 + (left / HALF_LEFT) ** STEEPNESS)
    if verdict == 'unknown':
        chance = MIN_RIGHT + SHARE_RIGHT * min(max(taken, 0.0), 1.0)
    powers = [cause.visible**2 for cause in causes]
    answer: dict[str, float] = {}
    for cause, power in zip(causes, powers, strict=True):
        name = ' or '.join(cause.group)
        answer[name] = answer.get(name, 0.0) + chance * power / max(sum(powers), 1e-300)
    return {**answer, 'none': 0.0, 'unknown': 1.0 - sum(answer.values())}
