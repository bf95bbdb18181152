"""A law proposed for a misfit that no effect of the catalogue explains.

Families of shapes on every target are fitted to the whitened residual without the base parameters.
The family that predicts most of runs held out in turn is chosen, and a second one if it adds
enough. A family counts only if it passes the likelihood ratio test of a cause, with the number of
families counted. The verdict stays `unknown`.

A family is matched to simple laws, each linear in its amplitudes: power, saturation, step, sine,
exponential, dead zone. Shape parameters are searched on a grid over the observed range, so that
results do not depend on units. The laws are compared by BIC, also with the curve of the family.
"""

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import product

import numpy as np
from scipy.optimize import minimize

from saddlering_ros.discrepancy.law import families
from saddlering_ros.discrepancy.law.families import BlockFit, DIRECTION, LOAD, Misfit, ObservedRun
from saddlering_ros.discrepancy.problem.system import Array, Estimate

Coordinates = Mapping[str, Array]
Shape = Sequence[float] | Array

CURVE_POINTS = 65
"""Number of points at which a curve is tabulated: two for each piece of its spline."""

STEP = 1e-3
"""Step of a shape parameter, as a share: small errors of truncation and of rounding."""


@dataclass(frozen=True)
class Form:
    """One law: `curve` gives columns (N,) over the coordinate u (N,), one for each amplitude.

    amplitudes, shapes: names; a shape that ends in '*' has the unit of the coordinate, one in '_s'
    is in seconds, and the others are plain numbers. words: the formula. grid: shape values to
    start from, for a range (low, high). memory: kind of family, of a law that remembers the load.
    """

    name: str
    amplitudes: tuple[str, ...]
    shapes: tuple[str, ...]
    words: str
    curve: Callable[[Array, Shape], list[Array]]
    grid: Callable[[float, float], Iterable[tuple[float, ...]]]
    coordinate: str = LOAD
    memory: str = ''

    @property
    def searched(self) -> list[int]:
        """Positions of the searched shape parameters: the scale of a power follows its size."""
        return [1] if self.name == 'power' else list(range(len(self.shapes)))

    def columns(self, coordinates: Coordinates, shape: Shape) -> Array:
        """The law (N, m) along a run, one column for each amplitude."""
        if self.memory:
            return families.remembered(
                self.memory, coordinates, np.array([max(abs(shape[0]), 1e-300)]))
        along = LOAD if self.coordinate == DIRECTION else self.coordinate
        curve = np.column_stack(self.curve(coordinates[along], shape))
        return curve * coordinates[DIRECTION][:, None] if along != self.coordinate else curve


def _apart(value: float) -> float:
    """The number, limited to a smallest absolute value."""
    return value if abs(value) > 1e-300 else 1e-300


def _scales(low: float, high: float) -> list[float]:
    """Shares of the largest coordinate."""
    return [share * max(abs(low), abs(high)) for share in (0.03, 0.1, 0.2, 0.4, 0.8)]


def _places(low: float, high: float) -> list[float]:
    """Places inside the range."""
    return [float(at) for at in np.linspace(low, high, 18)[1:-1]]


CURVES = (
    Form('power', ('size',), ('scale*', 'exponent'), 'size (u / scale)^exponent',
         lambda u, shape: [
             np.sign(u)
             * np.abs(u / max(abs(shape[0]), 1e-300)) ** float(np.clip(shape[1], 0.05, 8.0))],
         lambda low, high: product(
             [max(abs(low), abs(high))], (0.25, 0.5, 0.75, 1.0, 1.5, 2.0, 3.0))),
    Form('saturation', ('size',), ('scale*',), 'size tanh(u / scale)',
         lambda u, shape: [np.tanh(u / _apart(shape[0]))],
         lambda low, high: product(_scales(low, high))),
    Form('exponential', ('size',), ('scale*',), 'size (1 - e^(-u / scale))',
         lambda u, shape: [-np.expm1(np.clip(-u / _apart(shape[0]), -50.0, 50.0))],
         lambda low, high: [
             (sign * scale,) for scale, sign in product(_scales(low, high), (1.0, -1.0))]),
    Form('step', ('size',), ('at*', 'width*'), 'size (1 + tanh((u - at) / width)) / 2',
         lambda u, shape: [0.5 + 0.5 * np.tanh((u - shape[0]) / _apart(shape[1]))],
         lambda low, high: product(
             _places(low, high), [share * (high - low) for share in (0.01, 0.04, 0.12)])),
    Form('sine', ('sine', 'cosine'), ('spacing*',),
         'sine sin(2 pi u / spacing) + cosine cos(2 pi u / spacing)',
         lambda u, shape: [turn(2.0 * np.pi * u / _apart(shape[0])) for turn in (np.sin, np.cos)],
         lambda low, high: [
             (float((high - low) / waves),) for waves in np.geomspace(0.6, 12.0, 28)]),
    Form('dead zone', ('slope',), ('at*',), 'slope max(0, u - at)',
         lambda u, shape: [np.maximum(u - shape[0], 0.0)],
         lambda low, high: product(_places(low, high))))
"""Laws over any coordinate."""

CONSTANT = Form('constant', ('size',), (), 'size', lambda u, _: [np.ones(u.size)],
                lambda low, high: [()])
"""A law over the direction alone."""

PLAY = Form('play', ('size',), ('reach*',),
            'size z, z the load less a play of half width reach, over reach', lambda u, _: [u],
            lambda low, high: [
                (float(share * (high - low)),) for share in np.geomspace(0.004, 0.5, 12)],
            families.HYSTERESIS, families.PLAY)

MEMORY = Form('exponential memory', ('slope',), ('lag_s',),
              'slope (load less its first-order lag of time constant lag)', lambda u, _: [u],
              lambda low, high: [
                  (float(low * (high / low) ** share),) for share in np.linspace(0.0, 1.0, 12)],
              families.RATE, families.MEMORY)

MEMORIES = {form.memory: form for form in (PLAY, MEMORY)}
"""Laws that remember the load, by the kind of their family."""


@dataclass(frozen=True)
class Term:
    """One addition to one target: a simple law, or a curve with its band.

    parameters: amplitudes first. at, values, band (K,): the coordinate, the curve and its standard
    deviation; for a simple law, those of the law; for a law that remembers the load, weights at
    reaches of plays or at lags.
    """

    target: str
    coordinate: str
    law: str
    words: str
    parameters: Mapping[str, Estimate]
    at: Array
    values: Array
    band: Array
    form: Form | None = None

    @property
    def memory(self) -> str:
        """Kind of family of a law that remembers the load, else ''."""
        return self.form.memory if self.form else self.law if self.law in MEMORIES else ''

    def evaluate(self, coordinates: Coordinates) -> Array:
        """The addition (N,) along one run."""
        if self.memory:
            return np.asarray(
                families.remembered(self.memory, coordinates, self.at) @ self.values)
        if self.form is not None:
            numbers = np.array([number.value for number in self.parameters.values()])
            sizes, shape = np.split(numbers, [len(self.form.amplitudes)])
            return np.asarray(self.form.columns(coordinates, shape) @ sizes)
        along = LOAD if self.coordinate == DIRECTION else self.coordinate
        curve = np.interp(coordinates[along], self.at, self.values)
        return curve * coordinates[DIRECTION] if self.coordinate == DIRECTION else curve


MAX_REFINED = 3
"""Number of best forms whose shape is searched beyond its grid. Chosen for cost."""


@dataclass(frozen=True)
class _Match:
    """One form of law in place of a fitted family, for a whitened residual `wanted` (n,).

    products: with this residual and with the base.
    """

    misfit: Misfit
    fit: BlockFit
    wanted: Array
    products: families.Products
    form: Form

    def along_runs(self, *shapes: Shape) -> list[Array]:
        """The law (N, k) with each of the shapes, by run."""
        return [np.hstack([self.form.columns(run.coordinates, shape) for shape in shapes])
                for run in self.misfit.runs]

    def left(self, *shapes: Shape) -> list[float]:
        """Misfit with the best amplitudes of the law with each of the shapes."""
        gram, seen = self.products(self.misfit.plain(self.fit.target, self.along_runs(*shapes)))
        slopes, base = seen[:, 0], seen[:, 1:]
        gram = gram - base @ base.T
        own = np.split(np.arange(slopes.size), len(shapes))
        return [float(self.wanted @ self.wanted - slopes[one] @ np.linalg.pinv(
            gram[np.ix_(one, one)], hermitian=True) @ slopes[one]) for one in own]

    def on_grid(self) -> tuple[float, Array]:
        """Misfit and shape of the best law on the grid of the form."""
        low, high = self.fit.block.span
        if self.form is MEMORY and self.fit.block.memory is not None:
            low, high = float(self.fit.block.memory[0]), float(self.fit.block.memory[-1])
        shapes = [np.array(shape) for shape in self.form.grid(low, high)]
        return min(zip(self.left(*shapes), shapes, strict=True), key=lambda law: law[0])

    def refined(self, least: float, start: Array) -> tuple[float, Array]:
        """Misfit and shape of the best law about a start, whose misfit is `least`."""
        free = self.form.searched
        if start.size == 0:
            return least, start

        def moved_by(move: Array) -> Array:
            shape = start.copy()
            is_scaled = np.all(start[free])
            shape[free] = start[free] * np.exp(move) if is_scaled else start[free] + move
            return shape

        still = np.zeros(len(free))
        minimum = minimize(
            lambda move: self.left(moved_by(move))[0], still, method='Nelder-Mead',
            options={'maxfev': 60, 'xatol': 1e-4, 'fatol': 1e-7 * max(least, 1e-300),
                     'initial_simplex': np.vstack([still, 0.1 * np.eye(len(free))])})
        if minimum.fun >= least:
            return least, start
        return float(minimum.fun), moved_by(minimum.x)

    def term(self, shape: Array) -> Term:
        """The law with the best amplitudes, their standard deviations and its curve."""
        form, wanted, block = self.form, self.wanted, self.fit.block
        columns = self.misfit.columns(self.fit.target, self.along_runs(shape))
        sizes = np.asarray(np.linalg.lstsq(columns, wanted, rcond=None)[0], dtype=np.float64)
        law, slopes = columns @ sizes, [columns]
        for index in form.searched:
            step = STEP * (abs(shape[index]) or 1.0)
            moved = shape.copy()
            moved[index] += step
            other = self.misfit.columns(self.fit.target, self.along_runs(moved))
            slopes.append(((other @ sizes - law) / step)[:, None])
        sensitivities, left = np.hstack(slopes), wanted - law
        length = np.maximum(np.sqrt((sensitivities**2).sum(axis=0)), 1e-300)
        scaled = sensitivities / length
        covariance = (np.linalg.pinv(scaled.T @ scaled, hermitian=True) / np.outer(length, length)
                      * max(1.0, float(left @ left) / wanted.size))
        deviations = np.sqrt(np.maximum(np.diag(covariance), 0.0)).tolist()
        parameters = {
            name: Estimate(float(size), std,
                           'target per coordinate' if name == 'slope' else 'target')
            for name, size, std in zip(form.amplitudes, sizes, deviations, strict=False)}
        # A shape parameter that was not searched has the deviation 0.
        of_shapes = dict(zip(form.searched, deviations[len(form.amplitudes):], strict=True))
        for index, name in enumerate(form.shapes):
            unit = 'coordinate' if name.endswith('*') else 's' if name.endswith('_s') else '1'
            parameters[name.rstrip('*').removesuffix('_s')] = Estimate(
                float(shape[index]), of_shapes.get(index, 0.0), unit)
        term = Term(self.fit.target, block.coordinate, form.name, form.words, parameters,
                    np.abs(shape), sizes, np.array(deviations[:sizes.size]), form)
        if term.memory:
            return term
        at = np.linspace(*block.span, CURVE_POINTS)
        along = {**dict.fromkeys((LOAD, block.coordinate), at), DIRECTION: np.ones(at.size)}
        own = form.columns(along, shape)
        of_sizes = covariance[:own.shape[1], :own.shape[1]]
        variance = np.einsum('ni,ij,nj->n', own, of_sizes, own)
        return replace(term, at=at, values=term.evaluate(along),
                       band=np.sqrt(np.maximum(variance, 0.0)))


def match_law(misfit: Misfit, fit: BlockFit, wanted: Array) -> Term:
    """The simple law that is as good as the family by BIC, or the curve of the family."""
    size, along = wanted.size, fit.block.coordinate

    def bic(left: float, count: float) -> float:
        return size * float(np.log(max(left, 1e-300) / size)) + count * float(np.log(size))

    def price(law: tuple[float, Array, _Match]) -> float:
        return bic(law[0], len(law[2].form.amplitudes) + len(law[2].form.shapes))

    forms = [MEMORIES[fit.block.kind]] if fit.block.kind in MEMORIES else [
        replace(form, coordinate=along) for form in CURVES]
    if along == DIRECTION:
        forms = [replace(form, coordinate=along, words=f'direction * {form.words}')
                 for form in (*CURVES, CONSTANT)]
    products = misfit.products_with(np.column_stack([wanted, misfit.base]))
    matches = [_Match(misfit, fit, wanted, products, form) for form in forms]
    begun = sorted(((*match.on_grid(), match) for match in matches), key=price)
    best = min(((*match.refined(least, start), match)
                for least, start, match in begun[:MAX_REFINED]), key=price)
    left = float(wanted @ wanted) - fit.taken
    if price(best) <= bic(left, fit.freedom):
        return best[2].term(best[1])
    return _curve_term(fit, left / size)


def _curve_term(fit: BlockFit, left: float) -> Term:
    """The family itself: a curve with its band, or weights of plays and relaxations.

    left: mean square of the whitened residual beside it.
    """
    block, coefficients = fit.block, fit.coefficients
    covariance = fit.covariance * max(1.0, left)
    if block.memory is not None:
        scale = 1.0 if block.kind == families.PLAY else 1.0 / (block.span[1] - block.span[0])
        spread = np.sqrt(np.maximum(np.diag(covariance), 0.0))
        words = 'a sum of plays' if block.kind == families.PLAY else 'a sum of relaxations'
        return Term(fit.target, block.coordinate, block.kind, words, {}, block.memory,
                    coefficients * scale, spread * scale)
    at = np.linspace(*block.span, CURVE_POINTS)
    pieces = families.PIECES.get(block.coordinate, families.OTHER_PIECES)
    basis = families.spline_columns(at, block.span, pieces)
    variance = np.einsum('ni,ij,nj->n', basis, covariance, basis)
    return Term(fit.target, block.coordinate, 'curve', 'a smooth curve, given as a table', {}, at,
                basis @ coefficients, np.sqrt(np.maximum(variance, 0.0)))


MIN_SHARE = 0.1
"""Smallest share of the misfit that the first family must predict to describe it."""

MIN_SECOND_SHARE = 0.1
"""The same share of the remaining misfit for a second family."""

ALIKE = 0.9
"""Share of the best at which another coordinate or target is a doubt, told as 10 %."""

BEYOND = 0.02
"""Share of the range by which a held-out run may exceed it: full scales differ a little."""

BACKFITS = 3
"""Rounds in which two families are fitted in turn. Chosen for cost."""

MeanSquare = Callable[[ObservedRun, Array], float]
"""Mean square of a plain residual (C, N) of a run over the ranges, as in the gain."""

Outcomes = Mapping[str, tuple[float, float]]
"""Mean squares without and with a law, by the name of the run."""


@dataclass(frozen=True)
class LawProposal:
    """A law that would explain the residual.

    terms: one or two additions, the one that explains most first. share: explained share of the
    whitened misfit. p_value: with all families counted. reasons: reasons not to trust it, one
    sentence each. fit, held_out: gain as 1 - rms with / rms without; negative if the law predicts
    worse. worse: runs that it predicts worse.
    """

    terms: tuple[Term, ...]
    share: float
    p_value: float
    reasons: tuple[str, ...]
    fit: float = 0.0
    held_out: float | None = None
    worse: tuple[str, ...] = ()

    @property
    def doubts(self) -> tuple[str, ...]:
        """Every reason not to trust it, one sentence each."""
        return (*(f'the law makes {name} worse' for name in self.worse), *self.reasons)

    def addition(self, run: ObservedRun) -> Array:
        """The part of the law in the channels (C, N) of a run."""
        return np.asarray(np.zeros(run.residual.shape) + sum(
            run.added(term.target, term.evaluate(run.coordinates)[:, None])[:, :, 0]
            for term in self.terms))

    def judged_by(self, fitted: Outcomes, held_out: Outcomes) -> 'LawProposal':
        """The same law with the gains of these mean squares."""
        def gain(outcomes: Outcomes) -> float:
            before, after = np.mean(list(outcomes.values()), axis=0)
            return 1.0 - float(np.sqrt(after / max(float(before), 1e-300)))

        worse = [name for name, (before, after) in fitted.items() if after > before]
        worse += [f'{name} (held out)' for name, (before, after) in held_out.items()
                  if after > before]
        return replace(self, fit=gain(fitted), held_out=gain(held_out) if held_out else None,
                       worse=tuple(worse))


def propose_law(misfit: Misfit, mean_square: MeanSquare, held_out: Sequence[ObservedRun] = (),
                error_rate: float = 0.01) -> LawProposal | None:
    """The best law of at most two families, or None if none passes the test."""
    wanted = misfit.residual
    total = float(wanted @ wanted)
    # Every family on every target, the one that predicts most first.
    ranked = sorted(
        (families.fit_block(misfit.folds, wanted, target, block, white)
         for block in families.blocks_of(misfit.runs)
         for target, white in misfit.columns_of(block)),
        key=lambda fit: -fit.predicted)
    trials, first = len(ranked), ranked[0]
    p_value = first.p_value(misfit.degrees, trials)
    if p_value > error_rate or first.predicted < MIN_SHARE * total:
        return None
    chosen = [first]
    left = _left(wanted, chosen)
    second = max((families.fit_block(misfit.folds, left, fit.target, fit.block, fit.white)
                  for fit in ranked), key=lambda fit: fit.predicted)
    enough = second.predicted >= MIN_SECOND_SHARE * float(left @ left)
    if enough and second.p_value(misfit.degrees, trials * trials) < error_rate:
        # Both are fitted together, each to the residual of the other, in turn; the larger first.
        chosen = [first, second]
        for _ in range(BACKFITS):
            for number, fit in enumerate(chosen):
                chosen[number] = families.fit_block(
                    misfit.folds, _left(wanted, chosen, number), fit.target, fit.block, fit.white)
        chosen.sort(key=lambda fit: -fit.taken)
    terms = tuple(match_law(misfit, fit, _left(wanted, chosen, number))
                  for number, fit in enumerate(chosen))
    law = LawProposal(terms, 0.0, p_value, tuple(_reasons(misfit, ranked, terms, held_out)))
    # The change of base parameters (P,) beside the law. Bound-scaled parameters have a prior of
    # one range, so that idle ones stay.
    plain = np.concatenate([(run.residual - law.addition(run)).ravel() for run in misfit.runs])
    white, columns = np.split(misfit.whiten(np.column_stack([plain, misfit.slopes])), [1], axis=1)
    gram = columns.T @ columns + np.eye(columns.shape[1])
    move = np.linalg.solve(gram, columns.T @ white[:, 0])
    left = white[:, 0] - columns @ move

    def outcomes(runs: Sequence[ObservedRun]) -> Outcomes:
        return {run.name: (
            mean_square(run, run.residual),
            mean_square(run, run.residual - law.addition(run) - run.slopes @ move))
            for run in runs}

    return replace(law, share=1.0 - float(left @ left) / total).judged_by(
        outcomes(misfit.runs), outcomes(held_out))


def _left(wanted: Array, chosen: Sequence[BlockFit], without: int | None = None) -> Array:
    """What families, all but that at an index, leave of a whitened residual (n,)."""
    left = wanted.copy()
    for number, fit in enumerate(chosen):
        if number != without:
            left -= fit.white @ fit.coefficients
    return left


def _reasons(misfit: Misfit, ranked: list[BlockFit], terms: tuple[Term, ...],
             held_out: Sequence[ObservedRun]) -> list[str]:
    best = ranked[0]
    reasons: list[str] = []
    for term in terms:
        along = LOAD if term.coordinate in (DIRECTION, families.HYSTERESIS) else term.coordinate
        low, high = families.span_of(misfit.runs, along)
        slack = BEYOND * (high - low)
        reasons += [
            f'{run.name} (held out) has a {along} outside the fitted range' for run in held_out
            if run.coordinates[along].min() < low - slack
            or run.coordinates[along].max() > high + slack]
    as_good = [fit for fit in ranked
               if fit is not best and fit.predicted >= ALIKE * best.predicted]
    along = best.block.coordinate
    coordinates = {other.block.coordinate for other in as_good} - {along}
    reasons += [
        f'{name} explains nearly as much as {along} (within 10 %): these runs do not tell the two '
        'apart' for name in sorted(coordinates)]
    targets = {other.target for other in as_good if other.block.coordinate == along}
    targets -= {best.target, *(term.target for term in terms)}
    reasons += [
        f'an addition to {name} explains nearly as much as an addition to {best.target} (within '
        '10 %): these runs do not tell the two apart' for name in sorted(targets)]
    fastest = [float(np.abs(run.coordinates.get(families.RATE, np.zeros(1))).max())
               for run in misfit.runs]
    moving = [rate for rate in fastest if rate > 0.0]
    if len(moving) < 2 or max(moving) < 1.5 * min(moving):
        reasons.append('all runs have one rate of loading: whether the law depends on the rate is '
                       'open')
    if len(misfit.runs) == 1:
        reasons.append('the law was fitted to one run')
    return reasons


def describe(term: Term) -> str:
    """One sentence on a term."""
    words = {
        LOAD: 'the load', DIRECTION: 'the direction of the load times a curve over the load',
        families.RATE: 'the rate of the load', families.TIME: 'time',
        families.HYSTERESIS: 'the history of the load'}
    along = words.get(term.coordinate, term.coordinate)
    return f'{term.target} has an addition that follows {along}: {term.law} ({term.words})'
