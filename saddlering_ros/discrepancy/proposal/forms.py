"""Simple laws for a curve: power, saturation, step, sine, exponential, dead zone.

Every law is linear in its amplitudes. Its shape parameters are searched on a grid over the
observed range, so that results do not depend on units.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from itertools import product

import numpy as np

from saddlering_ros.discrepancy.proposal.memory import relaxations, stop_operators
from saddlering_ros.discrepancy.proposal.misfit import DIRECTION, HYSTERESIS, LOAD, RATE, TIME
from saddlering_ros.discrepancy.system import Array

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
    return [(sign * item[0],) for item in _scale_grid(low, high) for sign in (1.0, -1.0)]


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
        return stop_operators(coordinates[LOAD], np.array([reach])) / reach

    def grid(low: float, high: float) -> list[tuple[float, ...]]:
        return [(float(share * (high - low)),) for share in np.geomspace(0.004, 0.5, 12)]

    words = 'size z, z the load less a play of half width reach, over reach'
    return Form('play', HYSTERESIS, ('size',), ('reach*',), words, columns, grid)


def _memory_form() -> Form:
    def columns(coordinates: Coordinates, shape: Shape) -> Array:
        constant = np.array([max(abs(shape[0]), 1e-300)])
        return relaxations(coordinates[TIME], coordinates[LOAD], constant)

    def grid(low: float, high: float) -> list[tuple[float, ...]]:
        return [(float(low * (high / low) ** share),) for share in np.linspace(0.0, 1.0, 12)]

    words = 'slope (load less its first-order lag of time constant lag)'
    return Form('exponential memory', RATE, ('slope',), ('lag_s',), words, columns, grid)
