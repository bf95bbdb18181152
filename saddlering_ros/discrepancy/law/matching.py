"""Simple laws, and the match of a fitted family to one of them or to a curve with its band.

Every law is linear in its amplitudes: power, saturation, step, sine, exponential, dead zone. Its
shape parameters are searched on a grid over the observed range, so that results do not depend on
units. The laws are compared by BIC.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import product

import numpy as np
from scipy.optimize import minimize

from saddlering_ros.discrepancy.law import families
from saddlering_ros.discrepancy.law.families import BlockFit, DIRECTION, LOAD, Misfit, RATE, TIME
from saddlering_ros.discrepancy.problem.system import Array

Coordinates = Mapping[str, Array]
Shape = Sequence[float] | Array
Columns = Callable[[Coordinates, Shape], Array]


@dataclass(frozen=True)
class Form:
    """One law: `columns` (N, m) of coordinates and shape values, one column per amplitude.

    amplitudes, shapes: names; a shape that ends in '*' has the unit of the coordinate, and the
    others are plain numbers. words: the formula. grid: shape values to start from, for a
    range.
    """

    name: str
    coordinate: str
    amplitudes: tuple[str, ...]
    shapes: tuple[str, ...]
    words: str
    columns: Columns
    grid: Callable[[float, float], list[tuple[float, ...]]]

    @property
    def count(self) -> int:
        return len(self.amplitudes) + len(self.shapes)


def _power(u: Array, shape: Shape) -> Array:
    scale, exponent = abs(shape[0]), float(np.clip(shape[1], 0.05, 8.0))
    return np.asarray(np.sign(u) * np.abs(u / max(scale, 1e-300)) ** exponent)[:, None]


def _saturation(u: Array, shape: Shape) -> Array:
    return np.asarray(np.tanh(u / _apart(shape[0])))[:, None]


def _exponential(u: Array, shape: Shape) -> Array:
    return np.asarray(-np.expm1(np.clip(-u / _apart(shape[0]), -50.0, 50.0)))[:, None]


def _step(u: Array, shape: Shape) -> Array:
    return np.asarray(0.5 + 0.5 * np.tanh((u - shape[0]) / _apart(shape[1])))[:, None]


def _sine(u: Array, shape: Shape) -> Array:
    phase = 2.0 * np.pi * u / _apart(shape[0])
    return np.column_stack([np.sin(phase), np.cos(phase)])


def _dead_zone(u: Array, shape: Shape) -> Array:
    return np.asarray(np.maximum(u - shape[0], 0.0))[:, None]


def _constant(u: Array, shape: Shape) -> Array:
    return np.ones((u.size, 1))


def _apart(value: float) -> float:
    """The number, limited to a smallest absolute value."""
    return value if abs(value) > 1e-300 else 1e-300


Curve = Callable[[Array, Shape], Array]
Grid = Callable[[float, float], list[tuple[float, ...]]]


def _largest(low: float, high: float) -> float:
    return max(abs(low), abs(high))


def _power_grid(low: float, high: float) -> list[tuple[float, ...]]:
    return [(_largest(low, high), exponent) for exponent in (0.25, 0.5, 0.75, 1.0, 1.5, 2.0, 3.0)]


def _scale_grid(low: float, high: float) -> list[tuple[float, ...]]:
    return [(share * _largest(low, high),) for share in (0.03, 0.1, 0.2, 0.4, 0.8)]


def _both_signs(low: float, high: float) -> list[tuple[float, ...]]:
    return [(sign * scale[0],) for scale in _scale_grid(low, high) for sign in (1.0, -1.0)]


def _place_grid(low: float, high: float) -> list[tuple[float, ...]]:
    return [(float(at),) for at in np.linspace(low, high, 18)[1:-1]]


def _step_grid(low: float, high: float) -> list[tuple[float, ...]]:
    widths = [share * (high - low) for share in (0.01, 0.04, 0.12)]
    return [(at[0], width) for at, width in product(_place_grid(low, high), widths)]


def _spacing_grid(low: float, high: float) -> list[tuple[float, ...]]:
    return [(float((high - low) / waves),) for waves in np.geomspace(0.6, 12.0, 28)]


def _none(low: float, high: float) -> list[tuple[float, ...]]:
    return [()]


_Law = tuple[str, tuple[str, ...], tuple[str, ...], str, Curve, Grid]

_CURVES: tuple[_Law, ...] = (
    ('power', ('size',), ('scale*', 'exponent'), 'size (u / scale)^exponent', _power, _power_grid),
    ('saturation', ('size',), ('scale*',), 'size tanh(u / scale)', _saturation, _scale_grid),
    ('exponential', ('size',), ('scale*',), 'size (1 - e^(-u / scale))', _exponential,
     _both_signs),
    ('step', ('size',), ('at*', 'width*'), 'size (1 + tanh((u - at) / width)) / 2', _step,
     _step_grid),
    ('sine', ('sine', 'cosine'), ('spacing*',),
     'sine sin(2 pi u / spacing) + cosine cos(2 pi u / spacing)', _sine, _spacing_grid),
    ('dead zone', ('slope',), ('at*',), 'slope max(0, u - at)', _dead_zone, _place_grid),
)
_CONSTANT: _Law = ('constant', ('size',), (), 'size', _constant, _none)


def forms_of(coordinate: str, kind: str) -> list[Form]:
    """The simple laws for a family of one coordinate and kind."""
    if kind == 'plays':
        return [_stop_form()]
    if kind == 'relaxation':
        return [_memory_form()]
    if kind == 'own curve':
        return []
    if coordinate == DIRECTION:
        return [
            Form(name, DIRECTION, amplitudes, shapes, f'direction * {words}', _with_sign(curve),
                 grid)
            for name, amplitudes, shapes, words, curve, grid in (*_CURVES, _CONSTANT)]
    return [
        Form(name, coordinate, amplitudes, shapes, words, _along(curve, coordinate), grid)
        for name, amplitudes, shapes, words, curve, grid in _CURVES]


def _along(curve: Curve, name: str) -> Columns:
    """A curve over one coordinate."""
    def columns(coordinates: Coordinates, shape: Shape) -> Array:
        return curve(coordinates[name], shape)

    return columns


def _with_sign(curve: Curve) -> Columns:
    """A curve over the load with the sign of its direction."""
    def columns(coordinates: Coordinates, shape: Shape) -> Array:
        return curve(coordinates[LOAD], shape) * coordinates[DIRECTION][:, None]

    return columns


def _stop_form() -> Form:
    def columns(coordinates: Coordinates, shape: Shape) -> Array:
        reach = max(abs(shape[0]), 1e-300)
        return families.stop_operators(coordinates[LOAD], np.array([reach])) / reach

    def grid(low: float, high: float) -> list[tuple[float, ...]]:
        return [(float(share * (high - low)),) for share in np.geomspace(0.004, 0.5, 12)]

    words = 'size z, z the load less a play of half width reach, over reach'
    return Form('play', families.HYSTERESIS, ('size',), ('reach*',), words, columns, grid)


def _memory_form() -> Form:
    def columns(coordinates: Coordinates, shape: Shape) -> Array:
        constant = np.array([max(abs(shape[0]), 1e-300)])
        return families.relaxations(coordinates[TIME], coordinates[LOAD], constant)

    def grid(low: float, high: float) -> list[tuple[float, ...]]:
        return [(float(low * (high / low) ** share),) for share in np.linspace(0.0, 1.0, 12)]

    words = 'slope (load less its first-order lag of time constant lag)'
    return Form('exponential memory', RATE, ('slope',), ('lag_s',), words, columns, grid)


CURVE_POINTS = 65
"""Number of points at which a curve is tabulated: two for each piece of its spline."""

STEP = 1e-3
"""Step of a shape parameter for its sensitivity, as a share: the truncation error is small and
the rounding error of a difference too."""


@dataclass(frozen=True)
class LawParameter:
    """One number of a law with its standard deviation; `unit` in terms of channel and coordinate.

    kind: 'amplitude' or 'shape'.
    """

    value: float
    std: float
    unit: str
    kind: str


@dataclass(frozen=True)
class Term:
    """One addition to one target: a simple law, or a curve with its band.

    at, values, band (K,): the coordinate, the curve and its standard deviation; for a simple
    law, those of the law. weights: of plays and relaxations, at their reaches or lags.
    """

    target: str
    coordinate: str
    law: str
    words: str
    parameters: Mapping[str, LawParameter]
    at: Array
    values: Array
    band: Array
    freedom: float
    form: Form | None = None
    block: families.ShapeFamily | None = None

    def evaluate(self, coordinates: Coordinates) -> Array:
        """The addition (N,) along one run."""
        if self.form is not None:
            given = self.parameters.values()
            shape = [number.value for number in given if number.kind == 'shape']
            sizes = [number.value for number in given if number.kind == 'amplitude']
            return np.asarray(self.form.columns(coordinates, shape) @ np.array(sizes))
        if self.law == 'plays':
            plays = families.stop_operators(coordinates[LOAD], self.at) / self.at
            return np.asarray(plays @ self.values)
        if self.law == 'relaxation':
            memory = families.relaxations(coordinates[TIME], coordinates[LOAD], self.at)
            return np.asarray(memory @ self.values)
        along = LOAD if self.coordinate == DIRECTION else self.coordinate
        curve = np.interp(coordinates[along], self.at, self.values)
        return curve * coordinates[DIRECTION] if self.coordinate == DIRECTION else curve


def match_law(misfit: Misfit, fit: BlockFit, wanted: Array) -> Term:
    """The simple law that is as good as the family by BIC, or the curve of the family."""
    left = float(wanted @ wanted) - fit.taken
    curve_bic = _bic(left, fit.freedom, misfit.size)
    best: tuple[float, Form, Array] | None = None
    for form in forms_of(fit.block.coordinate, fit.block.kind):
        own, shape = _search(misfit, fit, form, wanted)
        bic = _bic(own, form.count, misfit.size)
        if best is None or bic < best[0]:
            best = bic, form, shape
    if best is not None and best[0] <= curve_bic:
        return _law_term(misfit, fit, best[1], best[2], wanted)
    return _curve_term(misfit, fit, left)


def _bic(left: float, count: float, size: int) -> float:
    return size * float(np.log(max(left, 1e-300) / size)) + count * float(np.log(size))


def _columns(misfit: Misfit, target: str, form: Form, shapes: list[Array]) -> Array:
    parts = tuple(
        np.hstack([form.columns(run.coordinates, shape) for shape in shapes])
        for run in misfit.runs
    )
    return misfit.columns(target, parts)


def _left(columns: Array, wanted: Array) -> float:
    """Misfit with the best amplitudes of columns (n, m)."""
    gram = columns.T @ columns
    slope = columns.T @ wanted
    amplitudes = np.linalg.pinv(gram, hermitian=True) @ slope
    return float(wanted @ wanted - amplitudes @ slope)


def _search(misfit: Misfit, fit: BlockFit, form: Form, wanted: Array) -> tuple[float, Array]:
    """Misfit and shape of the best law of one form."""
    low, high = fit.block.span
    if form.name == 'exponential memory' and fit.block.settings is not None:
        constants = fit.block.settings['constants']
        low, high = float(constants[0]), float(constants[-1])
    shapes = [np.array(shape) for shape in form.grid(low, high)]
    columns = _columns(misfit, fit.target, form, shapes)
    width = len(form.amplitudes)
    lefts = [
        _left(columns[:, number * width : (number + 1) * width], wanted)
        for number in range(len(shapes))
    ]
    best = int(np.argmin(lefts))
    start = shapes[best]
    free = _searched(form)
    if start.size == 0:
        return lefts[best], start

    def moved_by(move: Array) -> Array:
        shape = start.copy()
        shape[free] = start[free] * np.exp(move) if np.all(start[free]) else start[free] + move
        return shape

    def cost(move: Array) -> float:
        return _left(_columns(misfit, fit.target, form, [moved_by(move)]), wanted)

    minimum = minimize(
        cost,
        np.zeros(len(free)),
        method='Nelder-Mead',
        options={
            'maxfev': 60, 'xatol': 1e-4, 'fatol': 1e-7 * max(lefts[best], 1e-300),
            'initial_simplex': np.vstack([np.zeros(len(free)), 0.1 * np.eye(len(free))]),
        },
    )
    if minimum.fun >= lefts[best]:
        return lefts[best], start
    return float(minimum.fun), moved_by(minimum.x)


def _searched(form: Form) -> list[int]:
    """Positions of the shape parameters that are searched.

    The scale of a power follows from its size.
    """
    return [1] if form.name == 'power' else list(range(len(form.shapes)))


def _law_term(misfit: Misfit, fit: BlockFit, form: Form, shape: Array, wanted: Array) -> Term:
    """The simple law with the best amplitudes, their standard deviations and its curve."""
    columns = _columns(misfit, fit.target, form, [shape])
    sizes = np.asarray(np.linalg.lstsq(columns, wanted, rcond=None)[0], dtype=np.float64)
    slopes = np.hstack([columns, *_shape_slopes(misfit, fit, form, shape, columns @ sizes, sizes)])
    left = wanted - columns @ sizes
    covariance = _covariance(slopes) * max(1.0, float(left @ left) / misfit.size)
    at = np.linspace(*fit.block.span, CURVE_POINTS)
    term = Term(
        target=fit.target, coordinate=fit.block.coordinate, law=form.name, words=form.words,
        parameters=_law_parameters(form, sizes, shape, covariance), at=at,
        values=np.zeros(at.size), band=np.zeros(at.size), freedom=float(form.count), form=form)
    if fit.block.kind in ('plays', 'relaxation'):
        return term
    along = dict.fromkeys((LOAD, RATE, TIME, families.ANGLE, fit.block.coordinate), at)
    along[DIRECTION] = np.ones(at.size)
    own = form.columns(along, shape)
    of_sizes = covariance[:own.shape[1], :own.shape[1]]
    variance = np.einsum('ni,ij,nj->n', own, of_sizes, own)
    return replace(term, values=term.evaluate(along), band=np.sqrt(np.maximum(variance, 0.0)))


def _shape_slopes(
    misfit: Misfit, fit: BlockFit, form: Form, shape: Array, law: Array, sizes: Array,
) -> list[Array]:
    """Change (n, 1) of the law (n,) by each searched shape parameter, by a difference."""
    slopes = []
    for index in _searched(form):
        step = STEP * (abs(shape[index]) or 1.0)
        moved = shape.copy()
        moved[index] += step
        beside = _columns(misfit, fit.target, form, [moved]) @ sizes
        slopes.append(((beside - law) / step)[:, None])
    return slopes


def _covariance(slopes: Array) -> Array:
    """Covariance (m, m) of parameters with sensitivities (n, m), for noise of size one."""
    size = np.maximum(np.sqrt((slopes**2).sum(axis=0)), 1e-300)
    scaled = slopes / size
    return np.asarray(np.linalg.pinv(scaled.T @ scaled, hermitian=True) / np.outer(size, size))


def _law_parameters(
    form: Form, sizes: Array, shape: Array, covariance: Array,
) -> dict[str, LawParameter]:
    """Amplitudes and shape parameters by name; one that was not searched has the deviation 0."""
    deviations = np.sqrt(np.maximum(np.diag(covariance), 0.0))
    parameters: dict[str, LawParameter] = {}
    for name, size, std in zip(form.amplitudes, sizes, deviations, strict=False):
        unit = 'target per coordinate' if name == 'slope' else 'target'
        parameters[name] = LawParameter(float(size), float(std), unit, 'amplitude')
    of_shapes = dict(zip(_searched(form), deviations[len(form.amplitudes):], strict=True))
    for index, name in enumerate(form.shapes):
        unit = 'coordinate' if name.endswith('*') else 's' if name.endswith('_s') else '1'
        parameters[name.rstrip('*').removesuffix('_s')] = LawParameter(
            float(shape[index]), float(of_shapes.get(index, 0.0)), unit, 'shape')
    return parameters


PIECES = {LOAD: families.LOAD_PIECES, DIRECTION: families.DIRECTION_PIECES,
          RATE: families.RATE_PIECES, TIME: families.TIME_PIECES}


def _curve_term(misfit: Misfit, fit: BlockFit, left: float) -> Term:
    """The family itself: a curve with its band, or weights of plays and relaxations."""
    block, coefficients = fit.block, fit.coefficients
    inflation = max(1.0, left / misfit.size)
    if block.settings is not None:
        at = next(iter(block.settings.values()))
        scale = 1.0 if block.kind == 'plays' else 1.0 / (block.span[1] - block.span[0])
        spread = np.sqrt(np.maximum(np.diag(fit.covariance) * inflation, 0.0))
        words = {'plays': 'a sum of plays', 'relaxation': 'a sum of relaxations'}[block.kind]
        return Term(
            target=fit.target, coordinate=block.coordinate, law=block.kind, words=words,
            parameters={}, at=at, values=coefficients * scale, band=spread * scale,
            freedom=fit.freedom, form=None, block=block)
    at = np.linspace(*block.span, CURVE_POINTS)
    if block.kind == 'own curve':
        zero = np.zeros(at.size)
        return Term(
            target=fit.target, coordinate=block.coordinate, law=block.kind,
            words='a separate curve over time for each run', parameters={}, at=at, values=zero,
            band=zero, freedom=fit.freedom)
    if block.kind == 'harmonics':
        waves = np.arange(1, families.ANGLE_WAVES + 1)
        basis = np.hstack([np.cos(at[:, None] * waves), np.sin(at[:, None] * waves)])
    else:
        pieces = PIECES.get(block.coordinate, families.LOAD_PIECES // 2)
        basis = families.Spline(*block.span, pieces).values(at)
    variance = np.einsum('ni,ij,nj->n', basis, fit.covariance * inflation, basis)
    return Term(
        target=fit.target, coordinate=block.coordinate, law='curve',
        words='a smooth curve, given as a table', parameters={}, at=at,
        values=basis @ coefficients, band=np.sqrt(np.maximum(variance, 0.0)), freedom=fit.freedom)
