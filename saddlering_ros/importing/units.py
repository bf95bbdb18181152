"""Units of measured columns and their exact factors to SI; a unit is stated, never guessed."""

from __future__ import annotations

from dataclasses import dataclass
from fractions import Fraction

import numpy as np
from numpy.typing import NDArray

from saddlering_ros.errors import did_you_mean
from saddlering_ros.importing.errors import ImportingError

FORCE, LENGTH, PRESSURE, VOLTAGE, CURRENT, TIME, ANGLE, RAW = (
    'force', 'length', 'pressure', 'voltage', 'current', 'time', 'angle', 'raw')

_GRAVITY = Fraction('9.80665')
_POUND = Fraction('0.45359237') * _GRAVITY
_INCH = Fraction('0.0254')

_UNITS: dict[str, tuple[str, Fraction]] = {
    'N': (FORCE, Fraction(1)), 'daN': (FORCE, Fraction(10)), 'kN': (FORCE, Fraction(1000)),
    'MN': (FORCE, Fraction(10**6)), 'kgf': (FORCE, _GRAVITY), 'kp': (FORCE, _GRAVITY),
    't': (FORCE, 1000 * _GRAVITY), 'tf': (FORCE, 1000 * _GRAVITY), 'lbf': (FORCE, _POUND),
    'kip': (FORCE, 1000 * _POUND),
    'm': (LENGTH, Fraction(1)), 'cm': (LENGTH, Fraction(1, 100)),
    'mm': (LENGTH, Fraction(1, 1000)), 'um': (LENGTH, Fraction(1, 10**6)),
    'nm': (LENGTH, Fraction(1, 10**9)), 'in': (LENGTH, _INCH), 'mil': (LENGTH, _INCH / 1000),
    'Pa': (PRESSURE, Fraction(1)), 'kPa': (PRESSURE, Fraction(1000)),
    'MPa': (PRESSURE, Fraction(10**6)), 'mbar': (PRESSURE, Fraction(100)),
    'bar': (PRESSURE, Fraction(10**5)), 'psi': (PRESSURE, _POUND / (_INCH * _INCH)),
    'V': (VOLTAGE, Fraction(1)), 'mV': (VOLTAGE, Fraction(1, 1000)),
    'A': (CURRENT, Fraction(1)), 'mA': (CURRENT, Fraction(1, 1000)),
    's': (TIME, Fraction(1)), 'ms': (TIME, Fraction(1, 1000)), 'us': (TIME, Fraction(1, 10**6)),
    'ns': (TIME, Fraction(1, 10**9)), 'min': (TIME, Fraction(60)), 'h': (TIME, Fraction(3600)),
    'd': (TIME, Fraction(86400)),
    'rad': (ANGLE, Fraction(1)), 'deg': (ANGLE, Fraction('0.017453292519943295')),
    'raw': (RAW, Fraction(1)),
}

_SAME = {'µm': 'um', 'μm': 'um', 'µs': 'us', 'μs': 'us', 'sec': 's', 'inch': 'in', '°': 'deg'}
"""Other spellings of the same unit."""


@dataclass(frozen=True)
class Unit:
    """A unit: its name, what it measures, and its exact factor to SI."""

    name: str
    quantity: str
    factor: Fraction

    def to_si(self, values: NDArray[np.float64]) -> NDArray[np.float64]:
        """Values in SI, rounded once: multiplied by a whole number or divided by one."""
        if self.factor == 1:
            return values
        if self.factor.denominator == 1:
            return values * float(self.factor)
        if self.factor.numerator == 1:
            return values / float(self.factor.denominator)
        return values * float(self.factor)


def unit_of(name: object, where: str) -> Unit:
    """The unit of that name; ImportingError if it is not known."""
    found = known_unit(name)
    if found is None:
        raise ImportingError(
            f'{where} is {name!r}, which is not a known unit{did_you_mean(str(name), _UNITS)}'
            f' (known: {", ".join(_UNITS)})')
    return found


def known_unit(name: object) -> Unit | None:
    """The unit of that name, None if it is not known."""
    text = _SAME.get(str(name).strip(), str(name).strip())
    return Unit(text, *_UNITS[text]) if text in _UNITS else None


def units_of(quantity: str) -> tuple[str, ...]:
    """The names of all units of a quantity."""
    return tuple(name for name, (kind, _) in _UNITS.items() if kind == quantity)
