"""Units with exact factors to SI, and the way from a recorded reading to the quantity in SI.

A unit is stated, never guessed.
"""

from dataclasses import dataclass
from fractions import Fraction
from pathlib import Path
import re

import numpy as np
from numpy.typing import NDArray

from saddlering_ros.errors import did_you_mean, plain_number, SaddleringError

Floats = NDArray[np.float64]

MAX_TABLE = 1 << 20
"""Longest calibration table that is read [bytes]."""

FORCE, LENGTH, PRESSURE, VOLTAGE, CURRENT, TIME, ANGLE, RAW = (
    'force', 'length', 'pressure', 'voltage', 'current', 'time', 'angle', 'raw')


class ImportingError(SaddleringError):
    """A measured file or its map cannot be used; one line: fault, place, remedy."""


@dataclass(frozen=True)
class Unit:
    """A unit: its name, what it measures, and its exact factor to SI."""

    name: str
    quantity: str
    factor: Fraction

    def to_si(self, values: Floats) -> Floats:
        """Values in SI, rounded once: multiplied by a whole number or divided by one."""
        if self.factor.numerator == 1:
            return values / float(self.factor.denominator)
        return values * float(self.factor)


_GRAVITY = Fraction('9.80665')
_POUND = Fraction('0.45359237') * _GRAVITY
_INCH = Fraction('0.0254')

_FACTORS: dict[str, dict[str, int | Fraction]] = {
    FORCE: {'N': 1, 'daN': 10, 'kN': 1000, 'MN': 10**6, 'kgf': _GRAVITY, 'kp': _GRAVITY,
            't': 1000 * _GRAVITY, 'tf': 1000 * _GRAVITY, 'lbf': _POUND, 'kip': 1000 * _POUND},
    LENGTH: {'m': 1, 'cm': Fraction(1, 100), 'mm': Fraction(1, 1000), 'um': Fraction(1, 10**6),
             'nm': Fraction(1, 10**9), 'in': _INCH, 'mil': _INCH / 1000},
    PRESSURE: {'Pa': 1, 'kPa': 1000, 'MPa': 10**6, 'mbar': 100, 'bar': 10**5,
               'psi': _POUND / (_INCH * _INCH)},
    VOLTAGE: {'V': 1, 'mV': Fraction(1, 1000)},
    CURRENT: {'A': 1, 'mA': Fraction(1, 1000)},
    TIME: {'s': 1, 'ms': Fraction(1, 1000), 'us': Fraction(1, 10**6), 'ns': Fraction(1, 10**9),
           'min': 60, 'h': 3600, 'd': 86400},
    ANGLE: {'rad': 1, 'deg': Fraction('0.017453292519943295')},
    RAW: {'raw': 1},
}
_UNITS = {name: Unit(name, quantity, Fraction(factor))
          for quantity, factors in _FACTORS.items() for name, factor in factors.items()}

_SAME = {'µm': 'um', 'μm': 'um', 'µs': 'us', 'μs': 'us', 'sec': 's', 'inch': 'in', '°': 'deg'}
"""Other spellings of the same unit."""


def unit_of(name: object, where: str) -> Unit:
    """The unit of that name; ImportingError if it is not known."""
    if (found := known_unit(name)) is not None:
        return found
    raise ImportingError(f'{where} is {name!r}, which is not a known unit'
                         f'{did_you_mean(str(name), _UNITS)} (known: {", ".join(_UNITS)})')


def known_unit(name: object) -> Unit | None:
    """The unit of that name, None if it is not known."""
    text = str(name).strip()
    return _UNITS.get(_SAME.get(text, text))


def measures(name: object, *quantities: str) -> bool:
    """Whether `name` is a unit of one of the quantities."""
    unit = known_unit(name)
    return unit is not None and unit.quantity in quantities


def units_of(quantity: str) -> tuple[str, ...]:
    """The names of all units of a quantity."""
    return tuple(_FACTORS[quantity])


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
    path: Path

    def apply(self, readings: Floats) -> Floats:
        """Readings in SI."""
        found = np.interp(readings, self.readings, self.values, left=np.nan, right=np.nan)
        return self.unit.to_si(found)


Calibration = Polynomial | Table


def read_table(path: Path, reading_unit: Unit, value_unit: Unit | None) -> Table:
    """The table in a CSV file: two columns, the reading and the quantity.

    The first line gives their units, "V;mm" or "reading [V], gap [mm]"; `value_unit` of the map
    does it where there is no such line. Decimal comma with a semicolon or tab between columns.
    """
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
    delimiter = next((mark for mark in ('\t', ';') if mark in lines[0]), ',')
    heading: list[Unit | None] = [None, None]
    rows = []
    for number, line in enumerate(lines, 1):
        cells = [cell.strip() for cell in line.split(delimiter)]
        if len(cells) != 2:
            raise ImportingError(f'{path}, line {number}: has {len(cells)} columns: a '
                                 'calibration table has two columns, the reading and the quantity')
        try:
            row = [plain_number(cell if delimiter == ',' else cell.replace(',', '.'))
                   for cell in cells]
            if not np.isfinite(row).all():
                raise ValueError(line)
            rows.append(row)
        except ValueError as problem:
            if number > 1:
                raise ImportingError(f'{path}, line {number}: {line!r} is not two numbers: '
                                     'correct the table') from problem
            heading = [_unit_in(cell) for cell in cells]
    if heading[0] not in (None, reading_unit):
        raise ImportingError(f'{path}: its readings are in {heading[0].name}, the map gives the '
                             f'column in {reading_unit.name}: correct one')
    unit = value_unit or heading[1]
    if unit is None:
        raise ImportingError(f'{path}: does not give the unit of its second column: make its '
                             f'first line "{reading_unit.name}{delimiter}mm", or give table_unit')
    steps = np.diff([reading for reading, _ in rows])
    if not len(steps) or not (np.all(steps > 0) or np.all(steps < 0)):
        raise ImportingError(f'{path}: its readings must rise or fall from line to line, in at '
                             'least two lines: sort the table')
    readings, values = zip(*sorted(rows), strict=True)
    return Table(unit, readings, values, path)


def _unit_in(cell: str) -> Unit | None:
    """The unit in a heading: 'mm', 'gap [mm]', 'gap (mm)' or 'gap in mm'."""
    bracket = re.search(r'[\[(]\s*([^\])]+?)\s*[\])]', cell)
    return known_unit(bracket[1] if bracket else cell.split()[-1] if cell else '')
