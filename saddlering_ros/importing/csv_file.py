"""Text files with columns (CSV): their shape, found or stated, and their cells, read by Arrow."""

from collections import Counter
from collections.abc import Collection, Iterator, Mapping, Sequence
import csv
from dataclasses import asdict, dataclass, replace
from io import StringIO
from itertools import islice
from pathlib import Path
import re
from typing import Any

import numpy as np
from numpy.typing import NDArray
import pyarrow as pa
from pyarrow import compute
from pyarrow import csv as arrow_csv

from saddlering_ros.errors import counted, refuse_unknown_keys
from saddlering_ros.importing.calibration import ImportingError, known_unit
from saddlering_ros.importing.source import Block, Column, MAX_LEFT_OUT, NUMBER, Source, TEXT

SNIFFED_BYTES = 1 << 18
SNIFFED_LINES = 400
"""What is read of a file to learn its form; above the data, loggers write some tens of lines."""
DELIMITERS = {'\t': 'tab', ';': 'semicolon', ',': 'comma', '|': 'bar', ' ': 'blank'}

BLOCK_BYTES = 1 << 20
"""Read at a time; Arrow reads up to 32 such blocks ahead."""

_MARKS = (',', '.', "'", '’', ' ', '\u00a0', '\u202f')
"""Marks that group digits somewhere; one of ',' and '.' is the decimal mark."""

_MISSING = ('', 'nan', 'NaN', 'NAN', 'null', '-')
_NUMBERS = {mark: re.compile(rf'\s*[-+]?(\d+[{mark}]?\d*|[{mark}]\d+)([eE][-+]?\d+)?\s*')
            for mark in '.,'}
_MARKED_NUMBER = rf'^[-+]?\d+([{"".join(_MARKS)}]\d+)+([eE][-+]?\d+)?$'
_PLAIN_NUMBER = r'^[-+]?(\d+\.?\d*|\.\d+)([eE][-+]?\d+)?$'
_BRACKETED = re.compile(r'^(.*?)\s*[\[(]\s*([^\])]*?)\s*[\])]\s*$')


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
    with path.open('rb') as file:
        data = file.read(SNIFFED_BYTES)
        if _lines_above(given) > SNIFFED_LINES:  # then data may begin beyond these bytes
            data += b''.join(islice(file, _lines_above(given) + SNIFFED_LINES))
        is_whole = not file.read(1)
    encoding = str(given.get('encoding') or _encoding(data))
    try:
        text = data.decode(encoding, 'ignore')
    except LookupError as problem:
        raise ImportingError(f'{path}: csv.encoding is {encoding!r}, which is not known: give '
                             'utf-8, latin-1 or utf-16') from problem
    if '\0' in text.rstrip('\0'):  # a recorder that was cut off leaves some at the end
        raise ImportingError(f'{path}: is neither a text file nor of another format that is read '
                             '(TDMS, MAT, HDF5, MDF4): check the path')
    lines = StringIO(text, newline=None).read().split('\n')  # only the line ends of Arrow
    lines = lines if is_whole and lines[-1] else lines[:-1]
    for key, usual in asdict(CsvShape()).items():
        if type(given.get(key, usual)) is not type(usual):
            kind = 'a number' if isinstance(usual, int) else 'a text'
            raise ImportingError(f'{path}: csv.{key} is {given[key]!r}: give {kind}')
    stated = {key: value.replace('\\t', '\t') if key == 'delimiter' else value
              for key, value in given.items()}
    shape = replace(_sniffed(path, lines, stated), **{'encoding': encoding, **stated})
    if len(shape.delimiter) != 1 or shape.decimal not in '.,':
        raise ImportingError(f'{path}: csv.delimiter must be one character, csv.decimal . or ,')
    if shape.thousands and (shape.thousands == shape.decimal or shape.thousands not in _MARKS):
        raise ImportingError(f'{path}: csv.thousands is {shape.thousands!r}: give the mark that '
                             'groups digits, and that is not csv.decimal')
    return shape, _rows(lines, shape.delimiter, given)


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


def _lines_above(given: Mapping[str, Any]) -> int:
    """Lines above the data, where the map states it; else 0."""
    first = given.get('first_line')
    return max(first - 1, 0) if isinstance(first, int) else 0


def _rows(lines: Sequence[str], delimiter: str, given: Mapping[str, Any]) -> list[list[str]]:
    some = lines[:_lines_above(given) + SNIFFED_LINES]
    return [next(csv.reader([line], delimiter=delimiter), []) for line in some]


def _sniffed(path: Path, lines: Sequence[str], given: Mapping[str, Any]) -> CsvShape:
    """The delimiter and decimal mark by which most cells of the last lines are numbers."""
    best, columns, shape = 0.0, 0, CsvShape()
    thousands = str(given.get('thousands', ''))
    is_quoted = any('"' in line for line in lines[-20:])
    lines = [line.replace(thousands, '') for line in lines] if thousands else lines
    for delimiter in [given['delimiter']] if 'delimiter' in given else DELIMITERS:
        rows = _rows(lines, delimiter, given)
        later = rows[max(len(rows) // 2, _lines_above(given)):]
        counts = [len(row) for row in later if row]
        width = max(set(counts), key=counts.count) if counts else 0
        if width < 2:
            continue
        for decimal in [str(given['decimal'])] if 'decimal' in given else '.,':
            if decimal == thousands or (decimal == delimiter and not is_quoted):
                continue
            cells = [cell for row in later if len(row) == width for cell in row]
            share = sum(is_number(cell, decimal) for cell in cells) / max(len(cells), 1)
            score = share * (1.0 + 0.01 * width)
            if score > best + 1e-9:
                best, columns = score, width
                shape = replace(_headings(rows, width, decimal), delimiter=delimiter,
                                decimal=decimal)
    if not best and not given.keys() >= {'delimiter', 'decimal', 'header_line', 'first_line'}:
        raise ImportingError(f'{path}: no columns of numbers were found: state csv: {{delimiter, '
                             'decimal, header_line, first_line} in the map')
    for delimiter in () if 'first_line' in given else DELIMITERS.keys() - {shape.delimiter}:
        if sum(len(row) == columns and 2 * sum(is_number(cell, shape.decimal) for cell in row)
               > columns for row in _rows(lines[:shape.first_line - 1], delimiter, given)) > 2:
            raise ImportingError(
                f'{path}: the delimiter changes in line {shape.first_line} from '
                f'{DELIMITERS[delimiter]} to {DELIMITERS.get(shape.delimiter, shape.delimiter)}: '
                'correct the file, or state csv: {first_line} in the map')
    return shape


def is_number(cell: str, decimal: str) -> bool:
    """Whether a cell is a number, decimal mark as given."""
    return _NUMBERS['.' if decimal == '.' else ','].fullmatch(cell) is not None


def _headings(rows: Sequence[Sequence[str]], width: int, decimal: str) -> CsvShape:
    """Where data begin, and the names and units above them."""
    def is_data(row: Sequence[str]) -> bool:
        numbers = sum(is_number(cell, decimal) for cell in row)
        others = sum(not is_number(cell, decimal) and cell.strip() not in _MISSING for cell in row)
        return len(row) == width and numbers >= max(others, 1)

    first = next((i for i in range(len(rows)) if all(map(is_data, rows[i:i + 3]))), 0)
    above = [i for i in range(first) if width - 1 <= len(rows[i]) <= width and
             any(cell.strip() for cell in rows[i])]
    if not above:
        return CsvShape(header_line=0, first_line=first + 1)
    lowest = [known_unit(cell.strip().strip('[]()')) is not None
              for cell in rows[above[-1]] if cell.strip()]
    if len(above) > 1 and sum(lowest) * 2 >= len(lowest):
        return CsvShape(header_line=above[-2] + 1, units_line=above[-1] + 1, first_line=first + 1)
    return CsvShape(header_line=above[-1] + 1, first_line=first + 1)


class CsvSource(Source):
    """A text file with columns; every cell is read as text first, so that no digit is lost."""

    FORMAT = 'CSV'

    def __init__(self, path: Path, given: Mapping[str, Any]) -> None:
        super().__init__(path)
        self._shape, rows = shape_of(path, given)
        shape, data = self._shape, rows[self._shape.first_line - 1:]
        self.settings = asdict(shape)
        self.shape_words = (
            f'{DELIMITERS.get(shape.delimiter, repr(shape.delimiter))} between columns, decimal '
            f'{"comma" if shape.decimal == "," else "point"}, {shape.encoding}; names in line '
            f'{shape.header_line or "none"}, units in line {shape.units_line or "none"}, data '
            f'from line {shape.first_line}',)
        if not data:
            raise ImportingError(f'{path}: has no data from line {shape.first_line} on')
        widths = [len(row) for row in data]
        width = max(set(widths), key=widths.count)
        names, units = (
            ([cell.strip() for row in rows[line - 1:line] for cell in row if line]
             + [''] * width)[:width] for line in (shape.header_line, shape.units_line))
        seen: Counter[str] = Counter()
        for index, (heading, unit) in enumerate(zip(names, units, strict=True)):
            name = heading or f'column {index + 1}'
            bracketed = _BRACKETED.match(name)
            seen[name] += 1
            unique = name if seen[name] == 1 else f'{name}#{seen[name]}'
            plain = _BRACKETED.match(unique)
            cells = [row[index] for row in data if len(row) == width]
            numeric = [is_number(cell.replace(shape.thousands, ''), shape.decimal)
                       for cell in cells if cell.strip()]
            self.columns += (Column(
                unique, unit.strip('[]()') or (bracketed[2] if bracketed else ''), None,
                NUMBER if 2 * sum(numeric) > len(numeric) else TEXT, tuple(cells[:3]),
                others=(*((plain[1],) if plain and plain[1] else ()), f'#{index + 1}')),)
        for name, count in seen.items():
            if count > 1:
                self.warn(f'{count} columns are named {name!r}: the later ones are {name}#2 and '
                          'so on')

    def blocks(self, names: Sequence[str], as_text: Collection[str] = ()) -> Iterator[Block]:
        """Columns as float64 (NaN for a missing cell), or as the texts that the file holds."""
        line = self._shape.first_line
        for batch in self._batches(names):
            yield {name: _texts(batch.column(name)) if name in as_text
                   else self._numbers(name, batch.column(name), line) for name in names}
            line += batch.num_rows

    def number_texts(self, name: str, cells: NDArray[Any], first: int) -> NDArray[Any]:
        """The cells in plain digits with a decimal point."""
        texts = compute.utf8_trim_whitespace(pa.array(cells, pa.string()))
        return _texts(self._plain(name, texts, self._shape.first_line + first))

    def _batches(self, names: Sequence[str]) -> Iterator[pa.RecordBatch]:
        shape, width = self._shape, len(self.columns)
        read = left_out = 0

        def on_bad_row(row: arrow_csv.InvalidRow) -> str:
            nonlocal read, left_out
            read += 1
            if row.text.strip():
                left_out += 1
                where = '' if row.number is None else f'line {row.number}'
                self.warn(f'rows without {width} columns are left out', 1,
                          f'{where} with {row.actual_columns}'.strip())
            return 'skip'

        try:
            batches = arrow_csv.open_csv(
                pa.OSFile(str(self.path)),
                read_options=arrow_csv.ReadOptions(
                    use_threads=False, block_size=BLOCK_BYTES, skip_rows=shape.first_line - 1,
                    column_names=[column.name for column in self.columns],
                    encoding='utf8' if shape.encoding in ('utf-8', 'utf-8-sig')
                    else shape.encoding),
                parse_options=arrow_csv.ParseOptions(
                    delimiter=shape.delimiter, invalid_row_handler=on_bad_row,
                    ignore_empty_lines=True),
                convert_options=arrow_csv.ConvertOptions(
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
        if left_out > max(1.0, MAX_LEFT_OUT * read):
            reason = next(line for line in self.warnings if 'columns are left out' in line)
            raise ImportingError(f'{reason}, of {read} rows: correct the file, or state csv: '
                                 '{delimiter} in the map')

    def _check_read(self, read: int) -> None:
        """ImportingError unless every line of data was read as one row, or counted as left out."""
        rows, unpaired, line = 0, 0, '\n'
        with self.path.open(encoding=self._shape.encoding, errors='replace') as file:
            for number, line in enumerate(file, 1):
                if number < self._shape.first_line or line == '\n':
                    continue
                rows += 1
                if not unpaired and line.count('"') % 2:
                    unpaired = number
        if not line.endswith('\n'):
            self.warn('its last line has no line end, so that the file may be cut off: check its '
                      'last row')
        if rows != read:
            place = (f'line {unpaired} has a quotation mark without its partner: correct it'
                     if unpaired else 'the line ends are unclear: save the file again')
            raise ImportingError(f'{self.path}: {counted(rows - read, "row")} of {rows} would be '
                                 f'lost; {place}')

    def _numbers(self, name: str, cells: pa.Array, line: int) -> NDArray[np.float64]:
        """Numbers of cells from `line` on; NaN where a cell is empty or, said once, no number."""
        texts = compute.utf8_trim_whitespace(cells)
        is_plain = self._shape.decimal == '.' and not self._shape.thousands
        if not is_plain:
            texts = self._plain(name, texts, line)
        try:
            return np.asarray(compute.cast(texts, pa.float64()))
        except pa.ArrowInvalid:
            if is_plain:
                self._plain(name, texts, line)
        good = compute.match_substring_regex(texts, _PLAIN_NUMBER)
        empty = compute.is_in(texts, pa.array(_MISSING))
        bad = np.flatnonzero(~(np.asarray(good) | np.asarray(empty)))
        if len(bad):
            cell = texts[int(bad[0])].as_py()
            self.warn(f'cells of column {name!r} that are not numbers are left out', len(bad),
                      f'{cell!r} in about line {line + bad[0]}')
        kept = compute.if_else(good, texts, None)
        return np.asarray(compute.fill_null(compute.cast(kept, pa.float64()), np.nan))

    def _plain(self, name: str, texts: pa.Array, line: int) -> pa.Array:
        """Texts without grouped digits and with a decimal point.

        A number with a mark that is neither the decimal mark nor declared is refused: 4.735 may be
        four or four thousand.
        """
        decimal, thousands = self._shape.decimal, self._shape.thousands
        whole = rf'(\d*|\d{{1,3}}([{thousands}]\d{{3}})+)' if thousands else r'\d*'
        number = rf'^[-+]?{whole}(\{decimal}\d*)?([eE][-+]?\d+)?$'
        unclear = compute.and_not(compute.match_substring_regex(texts, _MARKED_NUMBER),
                                  compute.match_substring_regex(texts, number))
        if compute.any(unclear).as_py():
            first = int(np.flatnonzero(np.asarray(unclear))[0])
            raise ImportingError(
                f'{self.path}: {texts[first].as_py()!r} in column {name!r} (about line '
                f'{line + first}) is no clear number where the decimal mark is {decimal!r}'
                f'{f" and {thousands!r} groups digits" if thousands else ""}: state csv: '
                f'{{decimal: ".", thousands: ","}}, or csv: {{decimal: ",", thousands: "."}}, in '
                'the map, or correct the file')
        if thousands:
            texts = compute.replace_substring(texts, thousands, '')
        return compute.replace_substring(texts, ',', '.') if decimal == ',' else texts


def _texts(cells: pa.Array) -> NDArray[np.object_]:
    return np.asarray(cells.to_numpy(zero_copy_only=False), dtype=object)
