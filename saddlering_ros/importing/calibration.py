"""Units with exact factors to SI, and the way from a recorded reading to the quantity in SI.

A unit is stated, never guessed.
"""

from __future__ import annotations

from dataclasses import dataclass
from fractions import Fraction
from pathlib import Path
import re

import numpy as np
from numpy.typing import NDArray

from saddlering_ros.errors import did_you_mean, plain_number, SaddleringError


class ImportingError(SaddleringError):
    """A measured file or its map cannot be used; one line: fault, place, remedy."""


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


Floats = NDArray[np.float64]

MAX_TABLE = 1 << 20
"""Longest calibration table that is read [bytes]."""


@dataclass(frozen=True)
class Linear:
    """reading * scale + offset, in `unit`."""

    unit: Unit
    scale: float = 1.0
    offset: float = 0.0

    def apply(self, readings: Floats) -> Floats:
        """Readings in SI; with scale 1 and offset 0 only the unit changes them."""
        values = readings if self.scale == 1.0 else readings * self.scale
        values = values if self.offset == 0.0 else values + self.offset
        return self.unit.to_si(values)


@dataclass(frozen=True)
class Polynomial:
    """c0 + c1 reading + c2 reading^2 + ..., in `unit`."""

    unit: Unit
    coefficients: tuple[float, ...]

    def apply(self, readings: Floats) -> Floats:
        """Readings in SI."""
        values = np.polynomial.polynomial.polyval(readings, np.array(self.coefficients))
        return self.unit.to_si(np.asarray(values, dtype=np.float64))


@dataclass(frozen=True)
class Table:
    """A calibration table: linear between its points, NaN outside of them; path: its file."""

    unit: Unit
    readings: tuple[float, ...]
    values: tuple[float, ...]
    path: Path | None = None

    def apply(self, readings: Floats) -> Floats:
        """Readings in SI."""
        found = np.interp(readings, self.readings, self.values, left=np.nan, right=np.nan)
        return self.unit.to_si(found)


Calibration = Linear | Polynomial | Table


def read_table(path: Path, reading_unit: Unit, value_unit: Unit | None) -> Table:
    """The table in a CSV file: two columns, the reading and the quantity.

    The first line gives their units, "V;mm" or "reading [V], gap [mm]"; `value_unit` of the map
    does it where there is no such line. Decimal comma with a semicolon or tab between columns.
    """
    lines = _lines(path)
    delimiter = next((mark for mark in ('\t', ';') if mark in lines[0]), ',')
    header, rows = [], []
    for number, line in enumerate(lines, 1):
        cells = [cell.strip() for cell in line.split(delimiter)]
        if len(cells) != 2:
            raise ImportingError(f'{path}, line {number}: has {len(cells)} columns: a '
                                 'calibration table has two columns, the reading and the quantity')
        numbers = [_number(cell, delimiter) for cell in cells]
        if None not in numbers:
            rows.append(numbers)
        elif number == 1:
            header = [_unit_in(cell) for cell in cells]
        else:
            raise ImportingError(f'{path}, line {number}: {line!r} is not two numbers: correct '
                                 'the table')
    if header and header[0] is not None and header[0].name != reading_unit.name:
        raise ImportingError(f'{path}: its readings are in {header[0].name}, the map gives the '
                             f'column in {reading_unit.name}: correct one')
    unit = value_unit or (header[1] if header else None)
    if unit is None:
        raise ImportingError(f'{path}: does not give the unit of its second column: make its '
                             f'first line "{reading_unit.name}{delimiter}mm", or give table_unit')
    readings, values = (tuple(float(row[i] or 0.0) for row in rows) for i in (0, 1))
    steps = np.diff(readings)
    if len(readings) < 2 or not (np.all(steps > 0) or np.all(steps < 0)):
        raise ImportingError(f'{path}: its readings must rise or fall from line to line, in at '
                             'least two lines: sort the table')
    if steps[0] < 0:
        readings, values = readings[::-1], values[::-1]
    return Table(unit, readings, values, path)


def scaled_unit(text: str, reading_unit: Unit, where: str) -> Unit:
    """The unit of reading * scale, from a scale_unit like mm/V."""
    above, slash, below = text.partition('/')
    if not slash or known_unit(below) is None or known_unit(below) != reading_unit:
        raise ImportingError(f'{where}.scale_unit is {text!r}: give the unit of the quantity over '
                             f'that of the column, like mm/{reading_unit.name}'
                             + did_you_mean(text, [f'mm/{reading_unit.name}']))
    return unit_of(above, f'{where}.scale_unit')


def _lines(path: Path) -> list[str]:
    try:
        if not path.is_file() or path.stat().st_size > MAX_TABLE:
            raise ImportingError(f'{path}: is no calibration table (a regular file of at most '
                                 '1 MB): check the path')
        text = path.read_text(encoding='utf-8-sig')
    except (OSError, UnicodeDecodeError) as problem:
        raise ImportingError(f'{path}: cannot be read: check the path of the calibration '
                             'table') from problem
    lines = [line for line in text.splitlines() if line.strip()]
    if not lines:
        raise ImportingError(f'{path}: is empty: give a calibration table')
    return lines


def _number(cell: str, delimiter: str) -> float | None:
    text = cell.replace(',', '.') if delimiter != ',' else cell
    try:
        value = plain_number(text)
    except ValueError:
        return None
    return value if np.isfinite(value) else None


def _unit_in(cell: str) -> Unit | None:
    """The unit in a heading: 'mm', 'gap [mm]', 'gap (mm)' or 'gap in mm'."""
    bracket = re.search(r'[\[(]\s*([^\])]+?)\s*[\])]', cell)
    return known_unit(bracket[1] if bracket else cell.split()[-1] if cell.split() else '')
