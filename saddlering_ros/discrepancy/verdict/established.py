"""Whether causes are established: each rule gives a sentence where it refuses one.

`judge_alone` judges causes by noise, nuisance parameters and declared model error.
`doubts_beside_error` judges them beside what they leave, as error of the model, and
`judge_among` among small errors of all that is listed.
"""

from collections.abc import Collection, Mapping, Sequence
from dataclasses import replace
from statistics import mode

import numpy as np

from saddlering_ros.discrepancy.problem import fits as fitting
from saddlering_ros.discrepancy.problem.fits import Fit, PRIOR
from saddlering_ros.discrepancy.problem.system import Effect, Parameter
from saddlering_ros.discrepancy.search import evidence
from saddlering_ros.discrepancy.search import space as spaces
from saddlering_ros.discrepancy.search.among import Among, MIN_MARGIN, MIN_TIMES
from saddlering_ros.discrepancy.search.evidence import Comparison, crowded
from saddlering_ros.discrepancy.search.selection import MAINLY, Search, stopped_sizes
from saddlering_ros.discrepancy.search.small_errors import Model
from saddlering_ros.discrepancy.verdict import published as publishing
from saddlering_ros.discrepancy.verdict import wording, wrong_law
from saddlering_ros.discrepancy.verdict.parts import uneven_rest, unsteady_sizes
from saddlering_ros.discrepancy.verdict.published import Publication
from saddlering_ros.discrepancy.verdict.results import Cause, MIN_TAKEN, Refit, Residual, Shares
from saddlering_ros.estimation.least_squares import covariance
from saddlering_ros.quantities import percent, quantity, span

MAX_LEFT_OVER = 0.02
"""Share of what the causes of a ring take that may remain along one coordinate of a view, and
share of the misfit of a fitted view that they mainly move. Right names on 24 independent rings
left up to 1.2 % along a coordinate, a bent load cell of another law; stand-ins for laws that were
not in the catalogue left 3.6 to 10 %. Of a view, right names left up to 1 %, beside a weight that
is wrong by as much, and stand-ins up to 9 %."""

MIN_TAKEN_BESIDE = 1.0 - 0.5 * (1.0 - MIN_TAKEN)
"""The same of a main cause beside one with alternatives, which can take part of what a wrong main
cause leaves: half as much is left."""

MIN_REDUCTION = 1.0 - (1.0 - MIN_TAKEN) ** 0.5
"""Reduction of the rms by which a cause takes `MIN_TAKEN` of the power. Two misaligned rotors had
0.84 and 0.87 with intervals of their size that hold zero, a crack that stood in for a rub 0.48,
and 40 sound machines and stand-ins 0.20 at most."""

MIN_SHARED = 0.5
"""Share of refits with the same first cause up to which nothing is established: other answers come
as often. Of 625 causes established in sealed draws of docs/benchmarks, 624 were at 0.73 and above,
and a stand-in at 0.09; a moment arm of a sound ring, of wrong columns of rollers, was at 0.50."""


def judge_alone(search: Search, before: Residual, after: Residual, left: str,
                published: Publication) -> tuple[list[str], bool]:
    """Sentences on a model for the reader, and whether its effects are established.

    before, after: residuals of the base and of the model, without learnt model error; left: where
    a real and material one remains. A model without effects is established if nothing is left.
    """
    space, fit, settings = search.space, search.fit, search.space.settings
    ids, titles = fit.candidate.ids, space.titles_of(fit)
    fast = [f'{wording.fast_words(after.fast, space.problem.time_unit)} '
            f'({percent(after.fast.visible)} of range), which no cause explains'
            ] if after.fast.is_real_and_material(
        settings) and after.fast.visible >= space.problem.allowed_sizes[after.fast.view] else []
    if published.shares is None:
        return fast, not left
    share, doubts = before.explained_by(after), []
    # The law of a ring's effect may have another form, which leaves a small part.
    is_other_cause = share < settings.min_total or space.problem.assumptions.exact_laws
    if left and (is_other_cause or space.tests.slow(
            evidence.with_forms(space, fit, fit)).is_real_and_material(settings)):
        doubts.append(wording.PARTIAL_CAUSES.format(
            wording.remaining_words(share), left, wording.joined(titles)))
    doubts += left_by_ring(space, fit, after, published.shares)
    doubts += wrong_law.shown_in_one_view(space, fit, published.main.effect)
    if not space.problem.assumptions.exact_laws:
        doubts += _uncertain_gain(published.shares)
    doubts += wrong_inputs(space, fit) if len(ids) > 1 else []
    if crowded([Comparison(space, space.without(fit, name), fit).added for name in ids], settings):
        doubts.append(wording.CROWDED.format(len(ids)))
    doubts += shapes_at_bounds(space, fit)
    open_members = [title for name, title in zip(ids, titles, strict=True)
                    if search.alternatives.get(name)]
    if open_members and len(ids) > evidence.MAX_WITH_ALTERNATIVES:
        doubts.append(wording.TOO_MANY.format(len(ids), wording.joined(open_members)))
    sentences = [*doubts, *fast]
    if (after.slow.is_real_and_material(settings) and not doubts
            and not space.problem.assumptions.exact_laws):
        sentences.insert(0, wording.OTHER_FORM.format(
            wording.remaining_words(share), after.slow.where))
    more, taken = list(published.doubts), published.shares.best
    if space.problem.assumptions.exact_laws and len(ids) > 1:
        more += wrong_law.unlike_channels_unpatched(space, search, published)
    if any(space.problem.assumptions.allowed_error or ()):
        if taken < MIN_TAKEN:
            more.append(wording.weak_words(wording.joined(titles), published.shares, MIN_TAKEN))
        more += wrong_law.shared_directions(search)
    more += uncertain_law(space, published)
    return [*sentences, *more], not doubts and not more


def under_declared_error(space: spaces.ModelSpace, fit: Fit) -> str | None:
    """The first effect of a fit whose part is nowhere larger than the declared model error."""
    allowed = space.problem.allowed_sizes
    return next((
        name for name in fit.candidate.ids
        if all(float(size.max()) <= allowed[view] for view, size in
               Comparison(space, space.without(fit, name), fit).added.items())), None)


def left_by_ring(space: spaces.ModelSpace, fit: Fit, after: Residual, shares: Shares) -> list[str]:
    """A sentence if a ring's fit leaves more than an error of its laws along one coordinate.

    What is smaller than the noise of its view can be slow noise, whose colour is known roughly. If
    there is none, a sentence also if the fit leaves more of a view that it moves.
    """
    problem, titles = space.problem, wording.joined(space.titles_of(fit))
    if problem.assumptions.exact_laws:
        return []
    least = MAX_LEFT_OVER * (space.base.misfit - fit.misfit)
    where = ' and '.join(
        f'{test.view} along {test.coordinate}' for test in after.shapes
        if test.p_value < space.settings.error_rate and test.statistic - test.dimensions > least
        and test.visible * problem.view_ranges[test.view] > max(
            space.metric.noise_power(run, test.view) for run in problem.runs) ** 0.5)
    if where:
        return [wording.SHAPE_LEFT.format(titles, where)]
    view, share = shares.worst_fitted
    return [wording.VIEW_LEFT.format(titles, percent(1.0 - share), view)
            ] if share < 1.0 - MAX_LEFT_OVER else []


def wrong_inputs(space: spaces.ModelSpace, fit: Fit) -> list[str]:
    """A sentence on effects that are errors of the simulator's inputs, which resemble others."""
    inputs = {effect.id for effect in getattr(space.problem.system, 'inputs', ())}
    titles = [space.problem.titles[name] for name in fit.candidate.ids if name in inputs]
    return [wording.WRONG_INPUTS.format(wording.joined(titles))] if titles else []


SHARP = 0.1
"""Standard deviation of a shape, as a share of its bounds, below which it seldom lies on a bound
by chance: a value that may be anywhere does in one case of 25. A stand-in had 0.05."""


def _stopped_shapes(space: spaces.ModelSpace, fit: Fit) -> list[tuple[Effect, Parameter, float]]:
    """Every shape, or whole size, of a cause that is stopped by its bound, and this bound.

    It is stopped if the misfit beyond the bound would fall by more than noise and the form
    error of the effect explain, or if the laws are exact and the data determine it sharply. A
    shape at its neutral value or at its start is not stopped.
    """
    problem, settings = space.problem, space.settings
    white = space.tangent_of(fit).white
    variances = np.diag(covariance(white, PRIOR))
    slopes = white.T @ fit.whitened
    floor = evidence.alternative_floor(space.pairs, settings)
    form_error = 0.0 if problem.assumptions.exact_laws else settings.form_error
    taken = max(space.base.misfit - fit.misfit, 0.0)
    stopped = []
    for effect, _, indices in fit.parts:
        shapes = zip(effect.ordered, fit.theta_unit[indices], slopes[indices],
                     variances[indices], strict=True)
        for parameter, theta_unit, slope, variance in shapes:
            bound = spaces.bound_reached(parameter, float(theta_unit))
            if bound is None:
                continue
            outward = slope if theta_unit < 0.5 else -slope
            beyond = max(float(outward), 0.0) ** 2 * variance
            allowed = max(floor, form_error * taken)
            is_stopped = (bound == parameter.whole if parameter is effect.size
                          else bound not in (parameter.neutral, parameter.start))
            is_sharp = problem.assumptions.exact_laws and (
                parameter is not effect.size and variance**0.5 < SHARP)
            if is_stopped and (is_sharp or beyond > allowed):
                stopped.append((effect, parameter, parameter.from_unit(float(theta_unit))))
    return stopped


def shapes_at_bounds(space: spaces.ModelSpace, fit: Fit) -> list[str]:
    """A sentence for every shape, or whole size, of a cause that is stopped by its bound."""
    return [wording.SHAPE_AT_BOUND.format(
                space.problem.titles[effect.id], parameter.name, quantity(value, parameter.unit))
            for effect, parameter, value in _stopped_shapes(space, fit)]


def uncertain_law(space: spaces.ModelSpace, published: Publication) -> list[str]:
    """A sentence for each cause whose 95 % interval includes its absence or another effect.

    Of a second cause only the shapes are examined where laws are exact, thus not on rings.

    A declared model error is all in these intervals, and has a limit of its own. What a cause
    takes is no sign that it is present where laws err: an arc of 0.3 +- 0.4 took 90 % for a
    moment arm that was not listed.
    """
    if any(space.problem.allowed_sizes.values()) or not published.causes:
        return []
    main, name = published.main, published.main.definition.size.name
    low, high = main.parameters[name].interval or (-np.inf, np.inf)
    # Where the size that takes this lies beyond the interval, a stand-in takes it.
    is_exact = space.problem.assumptions.exact_laws
    is_present = is_exact and takes_most(main) and (
        low <= published.plain.point.effects[main.effect][name] <= high)
    return [sentence for cause in published.causes for sentence in uncertainties_of(
        cause, space.problem.titles[cause.effect],
        is_present if cause is main else is_exact or takes_most(cause))]


def takes_most(cause: Cause) -> bool:
    """Whether a cause surely takes `MIN_TAKEN` of the power of predicted runs.

    An interval follows from the slopes at the fit. Where a parameter of the base grows with the
    size, the interval can include zero although a fit without the cause leaves the whole misfit.
    A law that contains others can be one of these alone, whatever it takes.
    """
    reduction = cause.gain.interval
    return reduction is not None and reduction[0] > MIN_REDUCTION and (
        not cause.definition.contains)


def uncertainties_of(cause: Cause, title: str, is_present: bool) -> list[str]:
    """Sentences on the absence, and on the limiting cases of shapes, in 95 % intervals.

    is_present: the cause is there by what it takes, whatever the interval of its size includes.
    """
    sentences, size = [], cause.definition.size
    for parameter in cause.definition.ordered:
        interval = cause.parameters[parameter.name].interval
        if interval is None or (parameter is size and is_present):
            continue
        cases = (cause.definition.neutral,) if parameter is size else parameter.limiting_cases
        limit = next((case for case in cases if interval[0] <= case <= interval[1]), None)
        if limit is None:
            continue
        name, at_limit = ('size', 'the size at which the effect does nothing')
        if parameter is not size:
            name, at_limit = parameter.name, (
                f'{limit:g}, at which the effect is another one or none')
        sentences.append(wording.UNCERTAIN.format(
            title, name, span(*interval, parameter.unit), at_limit))
    return sentences


def doubts_beside_error(alone: Search, search: Search, published: Publication,
                        left_out: Mapping[str, float]) -> tuple[list[str], float]:
    """Reasons why causes beside model error are not established, and what these take.

    alone: the search without learnt model error; left_out: the power of each cause left out.
    The share of the misfit's power that the causes take is 0 if their law is another one,
    whatever it takes.
    """
    space, fit, main = search.space, search.fit, published.main
    assert published.shares is not None
    narrow = [wording.NARROW_LAW.format(
                  space.problem.titles[cause.effect], cause.another_law['along'],
                  percent(cause.another_law['predicts']))
              for cause in published.causes if cause.another_law]
    doubts = [*doubts_of(search, published), *unsteady_sizes(space, fit, published.causes),
              *narrow, *(wrong_law.unlike_channels(alone.space, published.plain)
                         or wrong_law.unlike_channels_unpatched(alone.space, search, published)),
              *uncertain_law(space, published), *uneven_rest(published.fits)]
    # The published size may be at a bound where that beside model error is not.
    doubts += [one for one in publishing.causes_at_bounds(space.problem, published.fits.after)
               if one not in doubts]
    doubts += _as_large(space, [name for name, power in left_out.items()
                                if power > MAINLY * published.power_of(main)])
    return doubts, 0.0 if narrow else published.shares.best


def doubts_of(search: Search, published: Publication) -> list[str]:
    """Reasons by what the effects of a model beside model error take, together and each."""
    space, fit, alternatives = search.space, search.fit, search.alternatives
    doubts, together = other_laws(search), published.shares
    assert together is not None
    main = published.main.effect if published.member_shares else ''
    if alternatives.get(main):
        doubts.append(wording.REPLACED.format(space.problem.titles[main]))
    for name, shares in {'': together, **published.member_shares}.items():
        is_beside = name == main and any(alternatives.values())
        required = MIN_TAKEN_BESIDE if is_beside else shares.required
        if shares.best < required:
            title = space.problem.titles[name] if name else wording.joined(space.titles_of(fit))
            doubts.append(wording.weak_words(title, shares, required))
    view, least = together.worst_view
    doubts += [*([] if least >= 0.0 else [wording.WORSE_VIEW.format(view)]),
               *_unlike_in_runs(together, wording.joined(space.titles_of(fit)))]
    members = [Comparison(space, space.without(fit, name), fit) for name in fit.candidate.ids]
    if not all(member.is_real for member in members):
        doubts.append(wording.BY_CHANCE)
    if crowded([member.added for member in members], space.settings):
        doubts.append(wording.THREE_EFFECTS)
    return doubts


def judge_among(strict: Search, among: Among, before: Residual,
                after: Residual) -> tuple[Search, Publication, str, list[str]]:
    """The causes among small errors, their published numbers, the main one, and doubts of it.

    Effects that do not stand out among these errors are left out, and belong to them. before,
    after: residuals of the base and of the best model.
    """
    best, space, rounds = among.best, among.space, among.space.settings.max_rounds
    sources = [model.fit for model in among.likely]
    otherwise = [*fitting.plain_fits(space.problem, sources[:1]),
                 among.beside_larger_errors(rounds)]

    def without(search: Search, names: Collection[str]) -> tuple[Search, Publication]:
        """The search without effects, of which the others keep their size, and its numbers."""
        kept = {*search.fit.candidate.ids} - {*names}
        search = replace(search, fit=fitting.refit_base(space.metric, search.fit, kept, rounds))
        return search, publishing.publish_settled(search, sources, otherwise, before, after)

    search = replace(strict, space=space, fit=best.fit, alternatives={})
    published = publishing.publish_settled(search, sources, otherwise, before, after)
    main, small = main_among(among, published)
    # An effect of which a shape or the size is stopped by its bound is no cause.
    stopped = {effect.id for effect, _ in stopped_sizes(best.fit)} | {
        effect.id for effect, *_ in _stopped_shapes(space, best.fit)}
    if stopped - {main}:
        search, published = without(search, stopped - {main})
    doubts, group = doubts_among(among, main, published)
    left_out = {*small, *small_secondary_causes(published, main)}
    if doubts and left_out:
        # A small error can fit beside the others and make a run worse: what hinders the main cause
        # does so among the causes alone.
        fewer = without(search, left_out)
        still, group_alone = doubts_among(among, main, fewer[1])
        if not still:
            (search, published), doubts, group = fewer, still, group_alone
            left_out = {*small_secondary_causes(published, main)}
    if group:
        search = replace(search, alternatives={main: tuple(
            fitting.refit_base(space.metric, other.fit, {name}, rounds)
            for name, other in group.items())})
        published = publishing.publish_settled(search, sources, otherwise, before, after)
    while not doubts and left_out:
        search, published = without(search, left_out)
        left_out = {*small_secondary_causes(published, main)}
    doubts += [*other_laws(search), *published.doubts, *wrong_inputs(space, search.fit),
               *uncertain_law(space, published)]
    causes = tuple(_with_evidence(among, cause) for cause in published.causes)
    return search, replace(published, causes=causes), main, doubts


def _with_evidence(among: Among, cause: Cause) -> Cause:
    """A cause with its evidence over small errors, of which its own kind is one in the metric."""
    margin, extra = among.group_of(cause.effect)[2], len(cause.definition.ordered)
    p_value = among.space.likelihood_ratio_test(
        2.0 * margin + extra * among.space.log_size, extra)
    return replace(cause, delta_bic=2.0 * margin, p_value=p_value,
                   times_needed=margin / MIN_MARGIN)


def main_among(among: Among, published: Publication) -> tuple[str, list[str]]:
    """The main effect of the best model among small errors, and those that are small errors.

    The main one moves most of those that take half of what the others leave, or that stand out
    among the small errors and take more than a right cause may leave: what a base parameter
    imitates can move much and take nothing. Each that is named takes this half. An error of the
    rig file counts as small beside a cause that moves more.
    """
    visible = among.best.visible
    shares = published.member_shares
    inputs = {signature.effect.id for signature in among.space.inputs}
    real = [name for name in visible
            if name not in shares or name in inputs or shares[name].best >= MAINLY]
    main = max(real or visible, key=lambda name: visible[name])
    main = max((name for name in visible if name == main or (
        visible[name] > visible[main] and shares[name].best > 1.0 - MIN_TAKEN
        and among.stands_out(name))), key=lambda name: visible[name])
    return main, [name for name in visible if name != main and (
        name not in real or name in inputs or not among.stands_out(name))]


def _min_times(among: Among, published: Publication, name: str) -> float:
    """Size over the spread from which an effect stands out by what it takes.

    Beside a view of which it takes nearly all, it can leave much of another one that it moves.
    Half of `MIN_TIMES` is enough then: friction with 97 % of the power of a misfit had 35 times,
    and no stand-in of dirty rings with 20 to 40 takes so much and passes all other rules.
    """
    taken = published.member_shares.get(name, published.shares)
    takes_all = taken and taken.best >= MIN_TAKEN and taken.worst_fitted[1] >= MIN_TAKEN
    return among.space.settings.nearly_all_times if takes_all else MIN_TIMES


def small_secondary_causes(published: Publication, main: str) -> list[str]:
    """Causes beside the main one whose interval or prediction of held-out runs refuses them."""
    return [cause.effect for cause in published.causes if cause.effect != main and (
        cause.gain.is_surely_worse or uncertainties_of(cause, '', takes_most(cause)))]


def doubts_among(among: Among, name: str,
                 published: Publication) -> tuple[list[str], dict[str, Model]]:
    """Reasons why the main effect of the best model among small errors is not established.

    With them other causes that explain as well, each in its model; none of one in doubt. No cause
    is the main one beside one as large.
    """
    taken = published.member_shares.get(name, published.shares)
    title = among.space.problem.titles[name]
    assert taken is not None
    # A view with little misfit can be worse by the size of the small errors.
    doubts = [*_unlike_in_runs(taken, title), *(
        wording.WORSE_VIEW.format(view) for view, share in taken.fitted.items()
        if min(share, taken.predicted.get(view, share)) < -MAX_LEFT_OVER)]
    doubts += [wording.worse_prediction_words(title, -cause.gain.held_out, cause.gain.how)
               for cause in published.causes
               if cause.effect == name and cause.gain.held_out and cause.gain.held_out < 0.0]
    least = _min_times(among, published, name)
    if among.times(name) < least:
        doubts.append(wording.NO_OUTLIER.format(title, among.times(name), least))
    group, other, margin = among.group_of(name)
    # Where listed causes replace each other, one that is not listed may replace both.
    required = MIN_TAKEN if group else MAINLY
    if margin < MIN_MARGIN:
        how = 'nearly as well' if margin > -MIN_MARGIN else 'better'
        doubts.append(wording.close_words(title, among.space.titles_of(other.fit), how))
    falls = among.errors.falls_in_one_view(among.space, among.best, name)
    view = min(falls, key=lambda view: falls[view], default='')
    if view and falls[view] < MIN_MARGIN:
        doubts.append(wording.ONE_VIEW.format(title, view))
    if taken.best < required:
        doubts.append(wording.weak_words(title, taken, required))
    doubts += _as_large(among.space, [
        other for other in among.best.visible
        if other != name and _is_as_large(among, published, other, name)])
    return doubts, {} if doubts else group


def _as_large(space: spaces.ModelSpace, names: Sequence[str]) -> list[str]:
    """A sentence on effects that are as large and have no name, if there are any."""
    titles = [space.problem.titles[name] for name in names]
    return [wording.AS_LARGE.format(wording.joined(titles))] if titles else []


def _is_as_large(among: Among, published: Publication, other: str, main: str) -> bool:
    """Whether an effect has twice the power of the main one, or half of it and no name.

    It has none if it belongs to the small errors because others can replace it. What takes no more
    than a right cause may leave can move much: a base parameter imitates it.
    """
    ratio = (among.best.visible[other] / among.best.visible[main]) ** 2
    if among.stands_out(other, _min_times(among, published, other)):
        return ratio > 1.0 / MAINLY
    taken = published.member_shares.get(other)  # None where it is at a bound
    return ratio > MAINLY and (taken is None or taken.best > 1.0 - MIN_TAKEN)


def _unlike_in_runs(shares: Shares, titles: str) -> list[str]:
    """Sentences on runs, predicted or fitted, in which the misfit falls by too little."""
    doubts: list[str] = _uncertain_gain(shares) if shares.interval else [wording.ONE_RUN]
    run, least = shares.worst_run
    return doubts if least >= 0.0 else [*doubts, wording.WORSE_RUN.format(run, titles)]


def _uncertain_gain(shares: Shares) -> list[str]:
    """A sentence if predicted runs may be predicted no better, by the 95 % interval."""
    interval = shares.interval
    return [wording.uncertain_gain_words(interval)] if interval and interval[0] <= 0.0 else []


def other_laws(search: Search) -> list[str]:
    """Signs that the law is another than that of the causes, whatever they take of the misfit."""
    space, fit = search.space, search.fit
    stopped = [*shapes_at_bounds(space, fit), *publishing.sizes_at_bounds(space.problem, fit)]
    if not space.problem.assumptions.exact_laws:
        return stopped
    return stopped + space.once(
        'shared directions', fit, lambda: wrong_law.shared_directions(search))


def unshared(refits: Sequence[Refit], titles: Mapping[str, str]) -> list[str]:
    """A sentence if most refits of a model with causes end in another first cause."""
    share = float(np.mean([refit.is_same for refit in refits]))
    if share > MIN_SHARED:
        return []
    other = mode(refit.first for refit in refits if not refit.is_same)
    end = 'no cause' if other is None else f'{titles[other]}, perhaps beyond its bounds'
    return [wording.UNSHARED.format(percent(share), percent(MIN_SHARED), end)]
