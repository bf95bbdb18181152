"""Simple laws, and the match of a fitted family to one of them or to a curve with its band.

Every law is linear in its amplitudes: power, saturation, step, sine, exponential, dead zone. Its
shape parameters are searched on a grid over the observed range, so that results do not depend on
units. The laws are compared by BIC.
"""

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import product

import numpy as np
from scipy.optimize import minimize

from saddlering_ros.discrepancy.law import families
from saddlering_ros.discrepancy.law.families import (
    BlockFit,
    DIRECTION,
    LOAD,
    Misfit,
    Products,
    TIME,
)
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
    start from, for a range (low, high).
    """

    name: str
    amplitudes: tuple[str, ...]
    shapes: tuple[str, ...]
    words: str
    curve: Callable[[Array, Shape], list[Array]]
    grid: Callable[[float, float], Iterable[tuple[float, ...]]]
    coordinate: str = LOAD

    @property
    def searched(self) -> list[int]:
        """Positions of the searched shape parameters: the scale of a power follows its size."""
        return [1] if self.name == 'power' else list(range(len(self.shapes)))

    def columns(self, coordinates: Coordinates, shape: Shape) -> Array:
        """The law (N, m) along a run, one column for each amplitude."""
        if self.name == 'play':
            reach = max(abs(shape[0]), 1e-300)
            return families.stop_operators(coordinates[LOAD], np.array([reach])) / reach
        if self.name == 'exponential memory':
            constant = np.array([max(abs(shape[0]), 1e-300)])
            return families.relaxations(coordinates[TIME], coordinates[LOAD], constant)
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
            families.HYSTERESIS)

MEMORY = Form('exponential memory', ('slope',), ('lag_s',),
              'slope (load less its first-order lag of time constant lag)', lambda u, _: [u],
              lambda low, high: [
                  (float(low * (high / low) ** share),) for share in np.linspace(0.0, 1.0, 12)],
              families.RATE)


@dataclass(frozen=True)
class Term:
    """One addition to one target: a simple law, or a curve with its band.

    parameters: amplitudes first. at, values, band (K,): the coordinate, the curve and its standard
    deviation; for a simple law, those of the law; for plays and relaxations, their weights at
    their reaches or lags.
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

    def evaluate(self, coordinates: Coordinates) -> Array:
        """The addition (N,) along one run."""
        if self.form is not None:
            numbers = np.array([number.value for number in self.parameters.values()])
            sizes, shape = np.split(numbers, [len(self.form.amplitudes)])
            return np.asarray(self.form.columns(coordinates, shape) @ sizes)
        if self.law == 'plays':
            plays = families.stop_operators(coordinates[LOAD], self.at) / self.at
            return np.asarray(plays @ self.values)
        if self.law == 'relaxation':
            lags = families.relaxations(coordinates[TIME], coordinates[LOAD], self.at)
            return np.asarray(lags @ self.values)
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
    products: Products
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
        at = np.linspace(*block.span, CURVE_POINTS)
        term = Term(self.fit.target, block.coordinate, form.name, form.words, parameters, at,
                    np.zeros(at.size), np.zeros(at.size), form)
        if block.memory is not None:
            return term
        along = {**dict.fromkeys((LOAD, block.coordinate), at), DIRECTION: np.ones(at.size)}
        own = form.columns(along, shape)
        of_sizes = covariance[:own.shape[1], :own.shape[1]]
        variance = np.einsum('ni,ij,nj->n', own, of_sizes, own)
        return replace(term, values=term.evaluate(along), band=np.sqrt(np.maximum(variance, 0.0)))


def match_law(misfit: Misfit, fit: BlockFit, wanted: Array) -> Term:
    """The simple law that is as good as the family by BIC, or the curve of the family."""
    size, along = wanted.size, fit.block.coordinate

    def bic(left: float, count: float) -> float:
        return size * float(np.log(max(left, 1e-300) / size)) + count * float(np.log(size))

    def price(law: tuple[float, Array, _Match]) -> float:
        return bic(law[0], len(law[2].form.amplitudes) + len(law[2].form.shapes))

    forms = {'plays': [PLAY], 'relaxation': [MEMORY]}.get(
        fit.block.kind, [replace(form, coordinate=along) for form in CURVES])
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
        scale = 1.0 if block.kind == 'plays' else 1.0 / (block.span[1] - block.span[0])
        spread = np.sqrt(np.maximum(np.diag(covariance), 0.0))
        words = {'plays': 'a sum of plays', 'relaxation': 'a sum of relaxations'}[block.kind]
        return Term(fit.target, block.coordinate, block.kind, words, {}, block.memory,
                    coefficients * scale, spread * scale)
    at = np.linspace(*block.span, CURVE_POINTS)
    if block.kind == 'harmonics':
        basis = families.harmonics(at)
    else:
        pieces = families.PIECES.get(block.coordinate, families.OTHER_PIECES)
        basis = families.spline_columns(at, block.span, pieces)
    variance = np.einsum('ni,ij,nj->n', basis, covariance, basis)
    return Term(fit.target, block.coordinate, 'curve', 'a smooth curve, given as a table', {}, at,
                basis @ coefficients, np.sqrt(np.maximum(variance, 0.0)))
