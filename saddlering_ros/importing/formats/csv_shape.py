"""The shape of a text file with columns: encoding, delimiter, decimal mark, headings, units."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
import csv
from dataclasses import asdict, dataclass, replace
from pathlib import Path
import re
from typing import Any

from saddlering_ros.errors import refuse_unknown_keys
from saddlering_ros.importing.errors import ImportingError
from saddlering_ros.importing.units import known_unit

SNIFFED_BYTES = 1 << 18
SNIFFED_LINES = 400
DELIMITERS = ('\t', ';', ',', '|', ' ')

NUMBER = {mark: re.compile(rf'\s*[-+]?(\d+{mark}?\d*|{mark}\d+)([eE][-+]?\d+)?\s*')
          for mark in (r'\.', ',')}
_MISSING = ('', 'nan', 'NaN', 'NAN', 'null', '-')


@dataclass(frozen=True)
class CsvShape:
    """How a text file is laid out; lines count from 1, 0 for none.

    header_line: with the columns' names; units_line: with their units; first_line: of the data.
    """

    encoding: str = 'utf-8'
    delimiter: str = ','
    decimal: str = '.'
    header_line: int = 1
    units_line: int = 0
    first_line: int = 2

    def as_map(self) -> dict[str, Any]:
        """As a map states it."""
        return asdict(self)


def shape_of(path: Path, given: Mapping[str, Any]) -> tuple[CsvShape, list[list[str]]]:
    """The shape of the file, where entries of the map replace those found, and its first rows.

    The rows go up to a few of data, cut into cells.
    """
    refuse_unknown_keys(given, tuple(asdict(CsvShape())), 'csv', str(path), ImportingError)
    encoding, lines = _first_lines(path, given.get('encoding'))
    shape = _sniffed(path, encoding, lines, given)
    delimiter = str(given.get('delimiter', shape.delimiter)).replace('\\t', '\t')
    shape = replace(shape, **{**given, 'delimiter': delimiter})
    if len(shape.delimiter) != 1 or shape.decimal not in '.,':
        raise ImportingError(f'{path}: csv.delimiter must be one character, csv.decimal . or ,')
    return shape, _rows(lines, shape.delimiter)


def _first_lines(path: Path, given: object) -> tuple[str, list[str]]:
    with path.open('rb') as file:
        data = file.read(SNIFFED_BYTES)
        is_whole = not file.read(1)
    encoding = str(given) if given else _encoding(data)
    try:
        text = data.decode(encoding, 'ignore')
    except LookupError as problem:
        raise ImportingError(f'{path}: csv.encoding is {encoding!r}, which is not known: give '
                             'utf-8, latin-1 or utf-16') from problem
    if '\0' in text:
        raise ImportingError(f'{path}: is neither a text file nor of another format that is read '
                             '(TDMS, MAT, HDF5, MDF4): check the path')
    lines = text.splitlines()
    return encoding, lines if is_whole else lines[:-1]


def _encoding(data: bytes) -> str:
    if data.startswith(b'\xef\xbb\xbf'):
        return 'utf-8-sig'
    if data.startswith((b'\xff\xfe', b'\xfe\xff')):
        return 'utf-16'
    try:
        data[:-8].decode('utf-8') if len(data) == SNIFFED_BYTES else data.decode('utf-8')
    except UnicodeDecodeError:
        return 'latin-1'
    return 'utf-8'


def _rows(lines: Sequence[str], delimiter: str) -> list[list[str]]:
    return [row for line in lines[:SNIFFED_LINES]
            for row in (list(csv.reader([line], delimiter=delimiter)) or [[]])]


def _sniffed(
    path: Path, encoding: str, lines: Sequence[str], given: Mapping[str, Any],
) -> CsvShape:
    """The delimiter and decimal mark by which most cells of the last lines are numbers."""
    best: tuple[float, CsvShape] = (0.0, CsvShape())
    marks = [str(given['delimiter'])] if 'delimiter' in given else list(DELIMITERS)
    for delimiter in (mark.replace('\\t', '\t') for mark in marks):
        rows = _rows(lines, delimiter)
        width = _width(rows)
        if width < 2:
            continue
        for decimal in ('.', ','):
            if decimal == delimiter and not any('"' in line for line in lines[-20:]):
                continue
            share = _share_of_numbers(rows, width, decimal)
            score = share * (1.0 + 0.01 * width)
            if score > best[0] + 1e-9:
                best = score, replace(_headings(rows, width, decimal), encoding=encoding,
                                      delimiter=delimiter, decimal=decimal)
    if not best[0]:
        raise ImportingError(f'{path}: no columns of numbers were found: state csv: {{delimiter, '
                             'decimal, header_line, first_line} in the map')
    return best[1]


def _width(rows: Sequence[Sequence[str]]) -> int:
    """The number of columns that most of the later rows have."""
    counts = [len(row) for row in rows[len(rows) // 2:] if row]
    return max(set(counts), key=counts.count) if counts else 0


def _share_of_numbers(rows: Sequence[Sequence[str]], width: int, decimal: str) -> float:
    cells = [cell for row in rows[len(rows) // 2:] if len(row) == width for cell in row]
    return sum(is_number(cell, decimal) for cell in cells) / max(len(cells), 1)


def is_number(cell: str, decimal: str) -> bool:
    """Whether a cell is a number, decimal mark as given."""
    return NUMBER[r'\.' if decimal == '.' else ','].fullmatch(cell) is not None


def _headings(rows: Sequence[Sequence[str]], width: int, decimal: str) -> CsvShape:
    """Where data begin, and the names and units above them."""
    def is_data(row: Sequence[str]) -> bool:
        numbers = sum(is_number(cell, decimal) for cell in row)
        others = sum(not is_number(cell, decimal) and cell.strip() not in _MISSING for cell in row)
        return len(row) == width and numbers >= 1 and numbers >= others

    first = next((i for i in range(len(rows)) if is_data(rows[i])
                  and all(is_data(row) for row in rows[i:i + 3])), 0)
    above = [i for i in range(first) if width - 1 <= len(rows[i]) <= width and
             any(cell.strip() for cell in rows[i])]
    if not above:
        return CsvShape(header_line=0, first_line=first + 1)
    units = above[-1] if len(above) > 1 and _holds_units(rows[above[-1]]) else None
    header = above[-1] if units is None else above[-2]
    return CsvShape(header_line=header + 1, units_line=0 if units is None else units + 1,
                    first_line=first + 1)


def _holds_units(row: Sequence[str]) -> bool:
    cells = [cell.strip().strip('[]()') for cell in row if cell.strip()]
    return bool(cells) and sum(known_unit(cell) is not None for cell in cells) * 2 >= len(cells)
