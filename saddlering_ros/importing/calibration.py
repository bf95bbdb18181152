"""From what a file holds to SI: units with exact factors, calibrations, and times as stamps.

A unit is stated, never guessed. Stamps are nanoseconds since 1970-01-01 UTC, exact to the last.
"""

from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass
from datetime import datetime, timedelta, timezone, tzinfo
from decimal import Decimal
from fractions import Fraction
from pathlib import Path
import re
from typing import Any
from zoneinfo import ZoneInfo, ZoneInfoNotFoundError

import numpy as np
from numpy.typing import NDArray

from saddlering_ros.errors import did_you_mean, plain_number, SaddleringError
from saddlering_ros.plain_yaml import read_regular_text
from saddlering_ros.record.batches import Floats, SECOND, Stamps

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

FACTORS: dict[str, dict[str, int | Fraction]] = {
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
    ANGLE: {'rad': 1, 'mrad': Fraction(1, 1000), 'deg': Fraction('0.017453292519943295')},
    RAW: {'raw': 1},
}
_UNITS = {name: Unit(name, quantity, Fraction(factor))
          for quantity, factors in FACTORS.items() for name, factor in factors.items()}

_SAME = {'µm': 'um', 'μm': 'um', 'µs': 'us', 'μs': 'us', 'sec': 's', 'inch': 'in', '°': 'deg'}
"""Other spellings of the same unit."""


def unit_of(name: object, where: str) -> Unit:
    """The unit of that name; ImportingError if it is not known."""
    unit = known_unit(name)
    if unit is None:
        raise ImportingError(f'{where} is {name!r}, which is not a known unit'
                             f'{did_you_mean(str(name), _UNITS)} (known: {", ".join(_UNITS)})')
    return unit


def known_unit(name: object) -> Unit | None:
    """The unit of that name, None if it is not known."""
    text = str(name).strip()
    return _UNITS.get(_SAME.get(text, text))


def measures(name: object, *quantities: str) -> bool:
    """Whether `name` is a unit of one of the quantities."""
    return getattr(known_unit(name), 'quantity', None) in quantities


@dataclass(frozen=True)
class Polynomial:
    """c0 + c1 reading + c2 reading^2 + ..., in `unit`."""

    unit: Unit
    coefficients: tuple[float, ...]

    def apply(self, readings: Floats) -> Floats:
        """Readings in SI."""
        with np.errstate(invalid='ignore', over='ignore'):  # of a reading that is infinite
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
        values = np.interp(readings, self.readings, self.values, left=np.nan, right=np.nan)
        return self.unit.to_si(values)


Calibration = Polynomial | Table


def read_table(path: Path, reading_unit: Unit, value_unit: Unit | None) -> Table:
    """The table in a CSV file: two columns, the reading and the quantity.

    The first line gives their units, "V;mm" or "reading [V], gap [mm]"; `value_unit` of the map
    does it where there is no such line. Decimal comma with a semicolon or tab between columns.
    """
    text = read_regular_text(path, ImportingError).removeprefix('\ufeff')
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
            # 'mm', 'gap [mm]', 'gap (mm)' or 'gap in mm'.
            words = [re.findall(r'[\[(]\s*([^\])]+?)\s*[\])]', text)[:1] or text.split()[-1:]
                     for text in cells]
            heading = [known_unit(''.join(word)) for word in words]
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


ISO = 'iso'
"""The format of times like 2026-11-20T08:00:00.123Z; a blank may stand for the T."""

FILE = 'file'
"""The format of a column that the file itself declares to hold dates."""

EXACT_UP_TO = 1e6
"""Seconds up to which a float64, rounded to nanoseconds, gives a decimal's last digit."""

MISSING = np.iinfo(np.int64).min
"""The stamp of a row whose time cannot be read."""

MAX_STAMP = 9.2e18
"""Stamp [ns], in the year 2261, above which 64 bits overflow."""

_FRACTION = re.compile(r'^(.*:\d{2})[.,](\d+)(.*)$', re.S)
_EPOCH = datetime(1970, 1, 1, tzinfo=timezone.utc)


@dataclass(frozen=True)
class RegularTime:
    """Rows at a constant `period` [ns] from `start` [ns] on, the first `first` [ns] after it."""

    period: float
    start: int
    first: float = 0.0
    columns: tuple[str, ...] = ()

    def stamps(self, cells: Sequence[NDArray[Any]], rows: NDArray[np.int64]) -> Stamps:
        """Stamps of the rows (N,), counted from 0."""
        return np.asarray(self.start + np.rint(self.first + rows * self.period).astype(np.int64))


@dataclass(frozen=True)
class CountedTime:
    """A column of numbers, in `unit`, counted from `start` [ns]."""

    columns: tuple[str, ...]
    unit: Unit
    start: int

    def stamps(self, cells: Sequence[NDArray[Any]], rows: NDArray[np.int64]) -> Stamps:
        """Stamps of the cells (N,), texts or the numbers of the file; MISSING for no number."""
        numbers = cells[0]
        scale = self.unit.factor * SECOND
        if numbers.dtype.kind not in 'fi':
            texts = [str(cell).strip().replace(',', '.') for cell in numbers]
            numbers = np.full(len(texts), np.nan)
            for row, text in enumerate(texts):
                with suppress(ValueError):
                    numbers[row] = plain_number(text)
            seconds = np.abs(numbers) * float(self.unit.factor)
            if np.nanmax(seconds, initial=0.0) >= EXACT_UP_TO:
                return np.array([self._of_text(text) for text in texts], dtype=np.int64)
        is_exact = numbers.dtype.kind == 'i' and scale.denominator == 1
        if is_exact and np.abs(numbers).max(initial=0) < MAX_STAMP / scale:
            return np.asarray(numbers * int(scale) + self.start, dtype=np.int64)
        numbers = numbers.astype(np.float64)
        with np.errstate(invalid='ignore', over='ignore'):
            nanoseconds = np.rint(numbers * float(scale)) if scale.denominator == 1 else \
                np.rint(numbers / float(1 / scale))
        good = np.isfinite(nanoseconds) & (np.abs(nanoseconds) < MAX_STAMP)
        result = np.full(len(numbers), MISSING, dtype=np.int64)
        result[good] = nanoseconds[good].astype(np.int64) + self.start
        return result

    def _of_text(self, text: str) -> int:
        try:
            number = Decimal(text) * self.unit.factor.numerator * SECOND
            stamp = self.start + int((number / self.unit.factor.denominator).to_integral_value())
        except (ArithmeticError, ValueError):
            return MISSING
        return stamp if abs(stamp) < MAX_STAMP else MISSING


@dataclass(frozen=True)
class DatedTime:
    """Columns with date and time as text, joined by a blank; `zone` where the text has none.

    start: midnight [ns] before times of day, where the format has no date.
    """

    columns: tuple[str, ...]
    format: str
    zone: tzinfo | None
    start: int | None = None

    @property
    def is_dated(self) -> bool:
        """Whether the format has a date beside the time of day."""
        return self.format in (ISO, FILE) or bool(re.search('%[dejxcDFs]', self.format))

    def stamps(self, cells: Sequence[NDArray[Any]], rows: NDArray[np.int64]) -> Stamps:
        """Stamps of the cells (N,) of each column; MISSING where a text cannot be read."""
        if len(cells) == 1 and cells[0].dtype.kind == 'i':
            return np.asarray(cells[0], dtype=np.int64)
        if self.format == FILE:
            raise ImportingError(f"column {self.columns[0]} holds no dates of the file's own "
                                 'kind: give format: iso, or like "%d.%m.%Y %H:%M:%S"')
        seconds: dict[str, int] = {}
        result = np.empty(len(rows), dtype=np.int64)
        for row, texts in enumerate(zip(*(column.tolist() for column in cells), strict=True)):
            base, fraction = _parted(' '.join(map(str, texts)).strip())
            if base not in seconds:
                seconds[base] = self._whole_seconds(base)
            result[row] = MISSING if seconds[base] == MISSING else seconds[base] + fraction
        return result

    def _whole_seconds(self, text: str) -> int:
        try:
            moment = parse_moment(text, self.format)
        except ValueError:
            return MISSING
        if not self.is_dated:
            if self.start is None:
                raise ImportingError(
                    f'the times of column {self.columns[-1]} ({text!r}) have no date: add start: '
                    'to time:, the midnight before them like "2026-11-20T00:00:00Z"')
            # The format has no date, so that strptime gives the first of 1900.
            return self.start + _nanoseconds(moment, timezone.utc) - _nanoseconds(
                datetime(1900, 1, 1), timezone.utc)
        if moment.tzinfo is None and self.zone is None:
            raise ImportingError(f'the times of column {self.columns[-1]} ({text!r}) have no '
                                 'time zone: add zone: to time:, like UTC or Europe/Berlin')
        if doubt := _doubt_of(moment, self.zone):
            raise ImportingError(
                f'the times of column {self.columns[-1]} ({text!r}) are doubtful: it {doubt}')
        stamp = _nanoseconds(moment, self.zone)
        return stamp if abs(stamp) < MAX_STAMP else MISSING


@dataclass(frozen=True)
class FileTime:
    """The time that the file itself gives each channel, as TDMS and MDF do."""

    start: int | None = None


TimeSource = RegularTime | CountedTime | DatedTime | FileTime


def zone_of(name: object, where: str) -> tzinfo:
    """The time zone of that name: UTC, Europe/Berlin, +01:00."""
    text = str(name).strip()
    try:
        if offset := re.fullmatch(r'([+-])(\d{1,2}):?(\d{2})', text):
            span = timedelta(hours=int(offset[2]), minutes=int(offset[3]))
            return timezone(span if offset[1] == '+' else -span)
        return timezone.utc if text.upper() in ('UTC', 'Z', 'GMT') else ZoneInfo(text)
    except (ZoneInfoNotFoundError, ValueError, OSError) as problem:
        raise ImportingError(f'{where} is {text!r}, which is not a known time zone: give UTC, a '
                             'name like Europe/Berlin, or +01:00') from problem


def start_of(value: object, zone: tzinfo | None, where: str) -> int:
    """A start [ns] from a map: text, or the value of YAML for a date without quotes."""
    if isinstance(value, datetime):
        moment, fraction = value, 0
    else:
        base, fraction = _parted(str(value).strip())
        try:
            moment = parse_moment(base, ISO)
        except ValueError as problem:
            raise ImportingError(f'{where} is {value!r}: give a date and time like '
                                 '"2026-11-20T08:00:00Z"') from problem
    if moment.tzinfo is None and zone is None:
        raise ImportingError(f'{where} is {value!r} without a time zone: write it with Z or '
                             '+01:00, or add zone:')
    if doubt := _doubt_of(moment, zone):
        raise ImportingError(f'{where} is {str(value)!r}, which {doubt}')
    return _nanoseconds(moment, zone) + fraction


def parse_moment(text: str, format_: str) -> datetime:
    """A date and time to the second; ValueError where the text is another."""
    if format_ != ISO:
        return datetime.strptime(text, format_)
    plain = re.sub(r'[Zz]$', '+00:00', text).replace('/', '-')
    plain = re.sub(r'([+-]\d\d)(\d\d)$', r'\1:\2', plain)
    if not re.match(r'\d{4}-\d\d-\d\d[T ]\d\d:\d\d', plain):
        raise ValueError(text)
    return datetime.fromisoformat(plain)


def words_of(stamp: int) -> str:
    """A stamp as people read it, in UTC."""
    return str(np.datetime64(int(stamp) // 1_000_000, 'ms')).replace('T', ' ') + ' UTC'


def _parted(text: str) -> tuple[str, int]:
    """The text without its fraction of a second, and the fraction [ns]."""
    match = _FRACTION.match(text)
    return (text, 0) if match is None else (match[1] + match[3], int(match[2][:9].ljust(9, '0')))


def _doubt_of(moment: datetime, zone: tzinfo | None) -> str:
    """Why a local time is none, or is two, where the clocks of its zone change; '' otherwise."""
    if moment.tzinfo is not None:
        return ''
    first, second = (moment.replace(tzinfo=zone, fold=fold) for fold in (0, 1))
    change = (second.utcoffset() or timedelta()) - (first.utcoffset() or timedelta())
    if not change:
        return ''
    before, after = (f'{one:%z}'[:3] + ':' + f'{one:%z}'[3:5] for one in (first, second))
    if change > timedelta():
        return (f'does not occur in {zone} (beginning of summer time): give the zone of a clock '
                f'that does not change, {before}')
    return (f'occurs twice in {zone} (end of summer time): give zone: {before} for the first time '
            f'or {after} for the second')


def _nanoseconds(moment: datetime, zone: tzinfo | None) -> int:
    """The stamp of a moment; zone: where it has none of its own."""
    span = (moment if moment.tzinfo else moment.replace(tzinfo=zone)) - _EPOCH
    return span // timedelta(microseconds=1) * 1000
