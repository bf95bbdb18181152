"""Two fitted models compared: the criteria of a cause, and of an alternative to it.

A real law differs from the idealised law of the catalogue: it is a mixture of such laws with other
shapes, or their change times a smooth function of load, highest load so far, direction, time, run
or channel. These forms compete with a second cause for the misfit that the idealised law leaves.
"""

from collections import Counter
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property, partial

import numpy as np

from saddlering_ros.discrepancy.problem import system as systems
from saddlering_ros.discrepancy.problem.fits import Fit
from saddlering_ros.discrepancy.problem.problem import Problem, shares_of_range
from saddlering_ros.discrepancy.problem.system import Array, RunBlocks, Settings
from saddlering_ros.discrepancy.search.lack_of_fit import SlowResidual
from saddlering_ros.discrepancy.search.space import FREE_SPREAD, ModelSpace
from saddlering_ros.estimation.process import fisher_limit

MAX_IN_ONE_VIEW = 2
"""Largest number of effects in one channel. More effects can fit any misfit."""

MAX_WITH_ALTERNATIVES = 2
"""Largest number of effects in a model of which some have alternatives. With three effects and
several choices for each, some model fits the misfit of a cause that is in no catalogue."""

INFLATION = 4.0
"""Factor by which nuisance parameters are inflated to compare them with an effect. Chosen: an
effect must explain more than a sound machine with errors four times as large as assumed."""

Sizes = Mapping[str, Array]
"""Rms shares of range: per view one number per run (R,)."""


@dataclass(frozen=True)
class Evidence:
    """A refitted candidate and its likelihood ratio test, for the table of the report."""

    step: int
    effects: tuple[str, ...]
    variants: tuple[int, ...]
    misfit: float
    delta_bic: float
    p_value: float
    visible: float
    values: Mapping[str, Mapping[str, float]]


@dataclass
class SearchLog:
    """Candidates in the order in which they were refitted, and findings that were immaterial."""

    candidates: list[Evidence] = field(default_factory=list)
    immaterial: list[Evidence] = field(default_factory=list)


@dataclass(frozen=True)
class Comparison:
    """Two fits of one space, of which `more` has further effects."""

    space: ModelSpace
    less: Fit
    more: Fit

    @property
    def gain(self) -> float:
        """Fall of the misfit."""
        return self.less.misfit - self.more.misfit

    @cached_property
    def p_value(self) -> float:
        """p-value of the likelihood ratio test, with all shapes of the candidate counted."""
        return self.space.likelihood_ratio_test(self.gain, self.extra)

    @property
    def extra(self) -> int:
        """Number of further parameters."""
        return max(1, self.more.theta_unit.size - self.less.theta_unit.size)

    @cached_property
    def visible(self) -> float:
        """Largest rms of the change that base parameters cannot imitate, as a share of range."""
        change = self.more.prediction - self.less.prediction
        return float(self.space.scale.sizes(change[:, None]).max())

    @property
    def is_real(self) -> bool:
        return self.p_value < self.space.settings.error_rate

    @property
    def is_material(self) -> bool:
        return self.visible >= self.space.settings.materiality

    @cached_property
    def added(self) -> Sizes:
        """Size that `more` explains beside `less`."""
        return _explained(self.space, self.less, self.more)

    @cached_property
    def explained_before(self) -> Sizes:
        """Size that `less` explains beside the base."""
        return _explained(self.space, self.space.base, self.less)

    @property
    def closes_misfit(self) -> bool:
        """Whether the cause is certain and explains almost all of the misfit.

        The form error of another effect does not leave such a misfit: it needs more than one
        other effect to explain, or resembles nuisance parameters that are larger than usual, like
        those of rollers with different clearances.
        """
        space, settings = self.space, self.space.settings
        if self.p_value >= settings.error_rate**3:
            return False
        left = max(space.slow_residual(self.more).excess, 0.0)
        if self.gain < settings.min_total * (self.gain + left):
            return False
        if not self.less.candidate.effects:
            return self.gain > 0.0
        inflated_gain = self.less.misfit - space.once(
            'inflated', self.less, lambda: _misfit_with_inflated_nuisances(space, self.less))
        return self.gain * settings.min_partial > inflated_gain

    @property
    def exceeds_form_error(self) -> bool:
        """Whether the cause exceeds the form error of the effects in `less` in some view.

        Every view of every run is judged. A form leaves a share of the misfit that it explains
        where it acts. In the other runs it leaves the same share of this remainder, because base
        parameters adapt to it. In a view in which the effect has no part, the immaterial size is
        the limit.
        """
        if not self.less.candidate.effects:
            return True
        settings = self.space.settings
        powers = {view: size**2 for view, size in self.explained_before.items()}
        return any(
            bool(np.any(size > np.maximum(settings.materiality, np.sqrt(settings.form_error * (
                powers[view] + settings.form_error * powers[view].max())))))
            for view, size in self.added.items())

    @cached_property
    def exceeds_forms(self) -> bool:
        """Whether the cause explains most of the residual, and other forms of the laws cannot.

        If forms explain a part of the fall of the misfit, the cause must be certain, because the
        prior of the forms is rough. If they explain nothing of it, the cause is judged as a first
        one.
        """
        space, settings = self.space, self.space.settings
        if not self.less.candidate.effects or not self.is_real:
            return False
        less, more = (with_forms(space, fit, self.less) for fit in (self.less, self.more))
        gain = less.misfit - more.misfit
        left = max(space.tests.slow(more).excess, 0.0)
        if gain < settings.min_partial * (gain + left):
            return False
        has_no_form = gain >= settings.min_total * self.gain
        rate = settings.error_rate if has_no_form else settings.error_rate**2
        return space.likelihood_ratio_test(gain, self.extra) < rate

    def is_another_cause(self, misfit_left: bool = True) -> bool:
        """Whether the effect is a cause beside those in `less`, for any form of their laws.

        misfit_left: these leave some misfit.
        """
        # Other forms cost simulations, so that they are asked last.
        return ((self.exceeds_form_error if misfit_left else self.adds_new_channel)
                or self.closes_misfit or self.exceeds_forms)

    @property
    def share_of_member(self) -> float:
        """Share of the misfit that the effect explains; 0 if it is no cause by itself."""
        space, settings = self.space, self.space.settings
        if not self.is_real or not self.is_material:
            return 0.0
        share = explained_share(
            space.slow_residual(self.less), space.slow_residual(self.more), settings)
        is_beyond_form = self.exceeds_form_error
        if is_beyond_form and share >= settings.min_partial:
            return share
        if self.closes_misfit or self.exceeds_forms:
            return max(share, settings.min_partial)
        return share if is_beyond_form else 0.0

    @property
    def adds_new_channel(self) -> bool:
        """Whether the cause surely shows in a view in which no effect of `less` shows.

        Surely means at the square of the error rate, because an inexact form can have a small
        part in a view in which the form of the catalogue has none.
        """
        if self.p_value >= self.space.settings.error_rate**2:
            return False
        limit = self.space.settings.materiality
        return any(self.explained_before[view].max() < limit < size.max()
                   for view, size in self.added.items())

    def evidence(self, step: int = 0) -> Evidence:
        """The likelihood ratio test as a line of the table in the report."""
        more = self.more
        return Evidence(
            step=step, effects=more.candidate.ids,
            variants=tuple(variant for _, variant in more.candidate.effects), misfit=more.misfit,
            delta_bic=self.gain - self.extra * self.space.log_size, p_value=self.p_value,
            visible=self.visible, values=more.point.effects)


def _explained(space: ModelSpace, less: Fit, more: Fit) -> Sizes:
    """Rms share of range that `more` explains beside `less`, per view one number per run.

    It is the root of the fall of the mean square residual, at most the size of the change: if the
    residual is large, a small shift of base parameters reduces it as much as an effect would.
    Nuisance parameters are fitted to both residuals first, so that small errors of a sound system
    do not count.
    """
    problem = space.problem
    before, after = (
        space.once('plain residual', fit, partial(
            space.metric.without_nuisances, fit.prediction - problem.measured))
        for fit in (less, more))
    changes = space.scale.by_run(more.prediction - less.prediction)
    falls = {view: problem.view_sizes(before, view) ** 2 - problem.view_sizes(after, view) ** 2
             for view in problem.system.views}
    return {view: np.minimum(np.sqrt(np.maximum(fall, 0.0)), changes[view])
            for view, fall in falls.items()}


def _misfit_with_inflated_nuisances(space: ModelSpace, fit: Fit) -> float:
    """Misfit of `fit` if every nuisance parameter had `INFLATION` times its usual size."""
    metric, strength = space.metric, space.metric.shared.strength
    # Offsets keep their spread, which is wide already.
    larger = np.where(strength < systems.FREE_STRENGTH, INFLATION * strength, strength)
    free = metric.whiten_noise(FREE_SPREAD * space.tangent_of(fit).plain)
    columns = np.hstack([metric.shared.directions * larger, free])
    white = metric.whiten_noise(fit.prediction - metric.problem.measured)
    inner = columns.T @ white
    gram = np.eye(inner.size) + columns.T @ columns
    return float(white @ white - inner @ np.linalg.solve(gram, inner))


def explained_share(before: SlowResidual, after: SlowResidual, settings: Settings) -> float:
    """Share of the misfit `before` that `after` has not: in all, or in one material view."""
    return max([
        1.0 - max(after.excess, 0.0) / max(before.excess, 1e-9),
        *(1.0 - after.powers[view] / power for view, power in before.powers.items()
          if power >= settings.materiality**2)])


def alternative_floor(pairs: int, settings: Settings) -> float:
    """Misfit by which noise may put the true model behind another; more if the level is uncertain.

    The chance that a wrong model is better by d than the true one is at most that of a normal
    number beyond sqrt(d), however different the two models are.
    """
    return fisher_limit(settings.alternative_rate, 1, pairs)


def open_distance(taken: float, excess: float, floor: float, settings: Settings) -> float:
    """Largest misfit by which an alternative may be behind and stay in a group.

    The limit rises with the remaining misfit (`excess`) and with the misfit `taken` by the
    effect, because no form is exact.
    """
    return max(floor + settings.alternative_share * min(excess, taken),
               settings.form_error * taken)


def crowded(explained: Iterable[Sizes], settings: Settings) -> bool:
    """Whether one view has too many effects to exclude a cause that is not in the catalogue."""
    crowd = Counter(view for sizes in explained for view, size in sizes.items()
                    if size.max() >= settings.materiality)
    return max(crowd.values(), default=0) > MAX_IN_ONE_VIEW


LOAD_WAVES = 4
"""Half waves over the drive by which a law may deviate: as smooth as the declared model error."""

HIGHEST_WAVES = 2
"""The same over the highest drive so far, which moves in one direction only: fewer."""

OTHER_SHAPES = (-0.2, -0.1, 0.1, 0.2)
"""Distances to the other laws of a mixture, in ranges of a shape parameter. Film creep with two
time constants and a load offset of 2.5 kN are named with them only."""

LAGS = (0.01, 0.05, 0.2)
"""Delays of the change of a law, as shares of a run, a factor of four to five apart."""


def with_forms(space: ModelSpace, fit: Fit, about: Fit) -> Fit:
    """`fit` with the most likely forms of the laws in `about`, and its parameters beside them.

    The prediction is that of the simulator to first order. The misfit counts the forms and the
    moved parameters by their prior spreads.
    """
    forms, _ = forms_of(space, about)
    forms = np.sqrt(space.settings.form_error) * forms
    white_forms = space.once('white forms', about, lambda: space.metric.whiten(forms))
    tangents = space.tangent_of(fit)
    plain = np.hstack([FREE_SPREAD * tangents.plain, forms])
    white = np.hstack([FREE_SPREAD * tangents.white, white_forms])
    gram = np.eye(white.shape[1]) + white.T @ white
    steps = -np.linalg.solve(gram, white.T @ fit.whitened)
    whitened = fit.whitened + white @ steps
    return replace(
        fit, prediction=fit.prediction + plain @ steps, whitened=whitened,
        misfit=float(whitened @ whitened + steps @ steps))


def forms_of(space: ModelSpace, fit: Fit) -> tuple[Array, Array]:
    """Other forms of the laws of a fit: columns (n, k), and the number of the effect of each (k,).

    All columns of an effect together have the power of its change. A mixture adds the changes if
    the law had other values of one of its shape parameters.
    """
    return space.once('forms', fit, lambda: _forms(space, fit))


def _forms(space: ModelSpace, fit: Fit) -> tuple[Array, Array]:
    problem, base = space.problem, space.problem.system.base_parameters
    owners, points = [], []
    for number, (effect, _, part) in enumerate(fit.parts):
        shapes = range(part.start + 1, part.stop)
        for index, parameter in zip(shapes, effect.ordered[1:], strict=True):
            for apart in OTHER_SHAPES:
                moved = fit.theta_unit.copy()
                moved[index] = moved[index] + apart
                if parameter.periodic or 0.0 <= moved[index] <= 1.0:
                    owners.append(number)
                    points.append(fit.candidate.point(base, moved))
    mixed = problem.predict(points) - fit.prediction[:, None] if points else np.zeros((0, 0))
    columns: list[Array] = []
    of_effect: list[int] = []
    for number, change in enumerate(space.changes_of(fit).T):
        shaped = [*(np.concatenate([part.ravel() for part in column])
                    for column in _shapes(problem, problem.by_run(change))),
                  *(other for owner, other in zip(owners, mixed.T, strict=True)
                    if owner == number and np.isfinite(other).all())]
        columns += [column / np.sqrt(len(shaped)) for column in shaped]
        of_effect += [number] * len(shaped)
    return np.array(columns).reshape(-1, problem.size).T, np.array(of_effect, dtype=int)


def _shapes(problem: Problem, change: list[Array]) -> list[list[Array]]:
    """The change of an effect (C, N) per run, times each shape."""
    runs = problem.runs
    # The first coordinate (N,), or time if a run has none.
    places = shares_of_range(
        [next(iter(run.inputs.values()), run.time - run.time[0]) for run in runs])
    highest = [np.maximum.accumulate(place) for place in places]
    factors: list[list[Array]] = [
        [np.cos(np.pi * wave * place) for place in seen]
        for seen, waves in ((places, LOAD_WAVES), (highest, HIGHEST_WAVES))
        for wave in range(1, waves + 1)]
    factors.append([np.zeros(run.time.size) if run.direction is None else run.direction
                    for run in runs])
    factors += [[np.array(float(number == index)) for number in range(len(runs))]
                for index in range(len(runs))]
    factors += [[chosen[:, None]] * len(runs) for chosen in np.eye(change[0].shape[0])]
    shapes = [[part * factor for part, factor in zip(change, own, strict=True)] for own in factors]
    lagged = [_lagged(part, run) for part, run in zip(change, runs, strict=True)]
    return shapes + [[slow[number] - part for slow, part in zip(lagged, change, strict=True)]
                     for number in range(len(LAGS))]


def _lagged(change: Array, run: RunBlocks) -> Array:
    """A change (C, N) delayed by first-order lags (L, C, N), shares of the run's duration."""
    lags = np.array(LAGS)[:, None] * max(float(np.ptp(run.time)), 1e-300)
    decay = np.exp(-np.diff(run.time) / lags).T[:, :, None]
    reached = (1.0 - decay) * change.T[1:, None]
    slow = np.repeat(change.T[:, None], len(LAGS), axis=1)
    for number, kept in enumerate(decay):
        slow[number + 1] = kept * slow[number] + reached[number]
    return slow.transpose(1, 2, 0)
