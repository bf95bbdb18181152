"""Text files with columns (CSV): their shape, found or stated, and their cells, read by Arrow."""

from __future__ import annotations

from collections import Counter
from collections.abc import Collection, Iterator, Mapping, Sequence
from csv import reader
from dataclasses import asdict, dataclass, replace
from io import StringIO
from pathlib import Path
import re
from typing import Any

import numpy as np
from numpy.typing import NDArray
import pyarrow as pa
from pyarrow import compute, csv

from saddlering_ros.errors import refuse_unknown_keys
from saddlering_ros.importing.calibration import ImportingError, known_unit
from saddlering_ros.importing.source import Column, NUMBER, Source, TEXT

SNIFFED_BYTES = 1 << 18
SNIFFED_LINES = 400
DELIMITERS = ('\t', ';', ',', '|', ' ')

_NUMBERS = {mark: re.compile(rf'\s*[-+]?(\d+{mark}?\d*|{mark}\d+)([eE][-+]?\d+)?\s*')
          for mark in (r'\.', ',')}
_MARKS = (',', '.', "'", '’', ' ', '\u00a0', '\u202f')
"""Marks that group digits somewhere; one of ',' and '.' is the decimal mark."""

_MISSING = ('', 'nan', 'NaN', 'NAN', 'null', '-')


@dataclass(frozen=True)
class CsvShape:
    """How a text file is laid out; lines count from 1, 0 for none.

    thousands: the mark that groups digits, '' for none; header_line: with the columns' names;
    units_line: with their units; first_line: of the data.
    """

    encoding: str = 'utf-8'
    delimiter: str = ','
    decimal: str = '.'
    thousands: str = ''
    header_line: int = 1
    units_line: int = 0
    first_line: int = 2


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
    if shape.thousands and (shape.thousands == shape.decimal or shape.thousands not in _MARKS):
        raise ImportingError(f'{path}: csv.thousands is {shape.thousands!r}: give the mark that '
                             'groups digits, and that is not csv.decimal')
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
    lines = StringIO(text, newline=None).read().split('\n')  # only the line ends of Arrow
    return encoding, lines if is_whole and lines[-1] else lines[:-1]


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
            for row in (list(reader([line], delimiter=delimiter)) or [[]])]


def _sniffed(
    path: Path, encoding: str, lines: Sequence[str], given: Mapping[str, Any],
) -> CsvShape:
    """The delimiter and decimal mark by which most cells of the last lines are numbers."""
    best: tuple[float, CsvShape] = (0.0, CsvShape())
    marks = [str(given['delimiter'])] if 'delimiter' in given else list(DELIMITERS)
    decimals = [str(given['decimal'])] if 'decimal' in given else ['.', ',']
    thousands = str(given.get('thousands', ''))
    for delimiter in (mark.replace('\\t', '\t') for mark in marks):
        rows = _rows([line.replace(thousands, '') for line in lines] if thousands else lines,
                     delimiter)
        later = rows[len(rows) // 2:]
        counts = [len(row) for row in later if row]
        width = max(set(counts), key=counts.count) if counts else 0
        if width < 2:
            continue
        for decimal in decimals:
            is_quoted = any('"' in line for line in lines[-20:])
            if decimal == thousands or (decimal == delimiter and not is_quoted):
                continue
            cells = [cell for row in later if len(row) == width for cell in row]
            share = sum(is_number(cell, decimal) for cell in cells) / max(len(cells), 1)
            score = share * (1.0 + 0.01 * width)
            if score > best[0] + 1e-9:
                best = score, replace(_headings(rows, width, decimal), encoding=encoding,
                                      delimiter=delimiter, decimal=decimal)
    if not best[0]:
        raise ImportingError(f'{path}: no columns of numbers were found: state csv: {{delimiter, '
                             'decimal, header_line, first_line} in the map')
    return best[1]


def is_number(cell: str, decimal: str) -> bool:
    """Whether a cell is a number, decimal mark as given."""
    return _NUMBERS[r'\.' if decimal == '.' else ','].fullmatch(cell) is not None


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


BLOCK_BYTES = 1 << 20
"""Read at a time; Arrow reads up to 32 such blocks ahead."""
_MARKED_NUMBER = rf'^[-+]?\d+([{"".join(_MARKS)}]\d+)+([eE][-+]?\d+)?$'
_PLAIN_NUMBER = r'^[-+]?(\d+\.?\d*|\.\d+)([eE][-+]?\d+)?$'
_BRACKETED = re.compile(r'^(.*?)\s*[\[(]\s*([^\])]*?)\s*[\])]\s*$')


class CsvSource(Source):
    """A text file with columns; every cell is read as text first, so that no digit is lost."""

    FORMAT = 'CSV'

    def __init__(self, path: Path, shape: Mapping[str, Any]) -> None:
        super().__init__(path)
        self.shape, self._rows = shape_of(path, shape)
        first = self._rows[self.shape.first_line - 1:]
        if not first:
            raise ImportingError(f'{self.path}: has no data from line {self.shape.first_line} on')
        width = max(set(map(len, first)), key=[len(row) for row in first].count)
        names, units = self._headings(width)
        columns = []
        for index, (name, unit) in enumerate(zip(names, units, strict=True)):
            cells = [row[index] for row in first if len(row) == width]
            kind = NUMBER if self._is_numeric(cells) else TEXT
            plain = _BRACKETED.match(name)
            others = (plain[1],) if plain and plain[1] else ()
            columns.append(Column(name, unit, None, kind, tuple(cells[:3]),
                                  others=(*others, f'#{index + 1}')))
        self.columns = tuple(columns)

    def describe(self) -> list[str]:
        """The shape of the file."""
        names = {'\t': 'tab', ';': 'semicolon', ',': 'comma', '|': 'bar', ' ': 'blank'}
        shape = self.shape
        return [f'{names.get(shape.delimiter, repr(shape.delimiter))} between columns, decimal '
                f'{"comma" if shape.decimal == "," else "point"}, {shape.encoding}; names in line '
                f'{shape.header_line or "none"}, units in line {shape.units_line or "none"}, data '
                f'from line {shape.first_line}']

    def settings(self) -> dict[str, Any]:
        """The shape as a map states it."""
        return asdict(self.shape)

    def blocks(
        self, names: Sequence[str], as_text: Collection[str] = (),
    ) -> Iterator[dict[str, NDArray[Any]]]:
        """Columns as float64 (NaN for a missing cell), or as the texts that the file holds."""
        numbers = [name for name in names if name not in as_text]
        row = self.shape.first_line
        for batch in self._batches(names):
            yield {name: self._numbers(name, batch.column(name), row) if name in numbers
                   else _texts(batch.column(name)) for name in names}
            row += batch.num_rows

    def number_texts(self, name: str, cells: NDArray[Any], first: int) -> NDArray[Any]:
        """The cells in plain digits with a decimal point."""
        texts = compute.utf8_trim_whitespace(pa.array(cells, pa.string()))
        return _texts(self._plain(name, texts, self.shape.first_line + first))

    # -- the file ------------------------------------------------------------------------------

    def _is_numeric(self, cells: Sequence[str]) -> bool:
        filled = [cell for cell in cells if cell.strip()]
        good = sum(is_number(cell.replace(self.shape.thousands, ''), self.shape.decimal)
                   for cell in filled)
        return 2 * good > len(filled)

    def _headings(self, width: int) -> tuple[list[str], list[str]]:
        line = self.shape.header_line
        cells = [cell.strip() for cell in self._rows[line - 1]] if line else []
        names = [cells[i] if i < len(cells) and cells[i] else f'column {i + 1}'
                 for i in range(width)]
        for name, count in Counter(names).items():
            if count > 1:
                self.warnings.add(
                    f'{self.path}: {count} columns are named {name!r}: the later ones are '
                    f'{name}#2 and so on')
        seen: Counter[str] = Counter()
        unique = []
        for name in names:
            seen[name] += 1
            unique.append(name if seen[name] == 1 else f'{name}#{seen[name]}')
        units = [''] * width
        if self.shape.units_line:
            row = [cell.strip().strip('[]()') for cell in self._rows[self.shape.units_line - 1]]
            units = [row[i] if i < len(row) else '' for i in range(width)]
        for index, name in enumerate(names):
            found = _BRACKETED.match(name)
            if found and not units[index]:
                units[index] = found[2]
        return unique, units

    def _batches(self, names: Sequence[str]) -> Iterator[pa.RecordBatch]:
        width = len(self.columns)
        read = 0

        def on_bad_row(row: csv.InvalidRow) -> str:
            nonlocal read
            read += 1
            if row.text.strip():
                where = '' if row.number is None else f'line {row.number}'
                self.warnings.count(
                    f'{self.path}: rows without {width} columns are left out', 1,
                    f'{where} with {row.actual_columns}'.strip())
            return 'skip'

        try:
            batches = csv.open_csv(
                pa.OSFile(str(self.path)),
                read_options=csv.ReadOptions(
                    use_threads=False, block_size=BLOCK_BYTES, skip_rows=self.shape.first_line - 1,
                    column_names=[column.name for column in self.columns],
                    encoding='utf8' if self.shape.encoding in ('utf-8', 'utf-8-sig')
                    else self.shape.encoding),
                parse_options=csv.ParseOptions(
                    delimiter=self.shape.delimiter, invalid_row_handler=on_bad_row,
                    ignore_empty_lines=True),
                convert_options=csv.ConvertOptions(
                    column_types={name: pa.string() for name in names},
                    include_columns=list(names), strings_can_be_null=False,
                    quoted_strings_can_be_null=False))
            for batch in batches:
                read += batch.num_rows
                yield batch
        except (pa.ArrowInvalid, UnicodeDecodeError) as problem:
            reason = ' '.join(str(problem).split())[:200]
            raise ImportingError(f'{self.path}: cannot be read as a table ({reason}): state csv: '
                                 'in the map') from problem
        self._check_read(read)

    def _check_read(self, read: int) -> None:
        """ImportingError unless every line of data was read as one row, or counted as left out."""
        rows, unpaired, line = 0, 0, '\n'
        with self.path.open(encoding=self.shape.encoding, errors='replace') as file:
            for number, line in enumerate(file, 1):
                if number < self.shape.first_line or line == '\n':
                    continue
                rows += 1
                if not unpaired and line.count('"') % 2:
                    unpaired = number
        if not line.endswith('\n'):
            self.warnings.add(f'{self.path}: its last line has no line end, so that the file may '
                              'be cut off: check its last row')
        if rows != read:
            place = (f'line {unpaired} has a quotation mark without its partner: correct it'
                     if unpaired else 'the line ends are unclear: save the file again')
            raise ImportingError(f'{self.path}: {rows - read} rows of {rows} would be lost; '
                                 f'{place}')

    def _numbers(self, name: str, cells: pa.Array, first_row: int) -> NDArray[np.float64]:
        texts = compute.utf8_trim_whitespace(cells)
        if self.shape.decimal == ',' or self.shape.thousands:
            texts = self._plain(name, texts, first_row)
        try:
            return np.asarray(compute.cast(texts, pa.float64()))
        except pa.ArrowInvalid:
            if self.shape.decimal == '.' and not self.shape.thousands:
                self._plain(name, texts, first_row)
            return self._with_gaps(name, texts, first_row)

    def _plain(self, name: str, texts: pa.Array, first_row: int) -> pa.Array:
        """Texts without grouped digits and with a decimal point.

        A number with a mark that is neither the decimal mark nor declared is refused: 4.735 may be
        four or four thousand.
        """
        decimal, thousands = self.shape.decimal, self.shape.thousands
        number = rf'^[-+]?\d*(\{decimal}\d*)?([eE][-+]?\d+)?$'
        if thousands:
            number = (rf'^[-+]?(\d*|\d{{1,3}}([{thousands}]\d{{3}})+)(\{decimal}\d*)?'
                      r'([eE][-+]?\d+)?$')
        unclear = compute.and_not(compute.match_substring_regex(texts, _MARKED_NUMBER),
                                  compute.match_substring_regex(texts, number))
        if compute.any(unclear).as_py():
            first = int(np.flatnonzero(np.asarray(unclear))[0])
            raise ImportingError(
                f'{self.path}: {texts[first].as_py()!r} in column {name!r} (about line '
                f'{first_row + first}) is no clear number where the decimal mark is {decimal!r}'
                f'{f" and {thousands!r} groups digits" if thousands else ""}: state csv: '
                f'{{decimal: ".", thousands: ","}}, or csv: {{decimal: ",", thousands: "."}}, in '
                'the map, or correct the file')
        if thousands:
            texts = compute.replace_substring(texts, thousands, '')
        return compute.replace_substring(texts, ',', '.') if decimal == ',' else texts

    def _with_gaps(self, name: str, texts: pa.Array, first_row: int) -> NDArray[np.float64]:
        """NaN where a cell is empty or no number; the latter is a warning."""
        good = compute.match_substring_regex(texts, _PLAIN_NUMBER)
        empty = compute.is_in(texts, pa.array(_MISSING))
        bad = np.flatnonzero(~(np.asarray(good) | np.asarray(empty)))
        if len(bad):
            cell = texts[int(bad[0])].as_py()
            self.warnings.count(f'{self.path}: cells of column {name!r} that are not numbers are '
            'left out', len(bad), f'{cell!r} in about line {first_row + bad[0]}')
        kept = compute.if_else(good, texts, None)
        return np.asarray(compute.fill_null(compute.cast(kept, pa.float64()), np.nan))


def _texts(cells: pa.Array) -> NDArray[np.object_]:
    return np.asarray(cells.to_numpy(zero_copy_only=False), dtype=object)
