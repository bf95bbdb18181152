"""Text files with columns (CSV): any delimiter, decimal comma, lines before the headings."""

from __future__ import annotations

from collections import Counter
from collections.abc import Collection, Iterator, Mapping, Sequence
from pathlib import Path
import re
from typing import Any

import numpy as np
from numpy.typing import NDArray
import pyarrow as pa
from pyarrow import compute, csv

from saddlering_ros.importing.errors import ImportingError
from saddlering_ros.importing.formats.csv_shape import is_number, shape_of
from saddlering_ros.importing.source import Column, NUMBER, Source, TEXT

BLOCK_BYTES = 1 << 20
"""Read at a time; Arrow reads up to 32 such blocks ahead."""
_PLAIN_NUMBER = r'^[-+]?(\d+\.?\d*|\.\d+)([eE][-+]?\d+)?$'
_MISSING = pa.array(['', 'nan', 'NaN', 'NAN', 'null', '-'])
_BRACKETED = re.compile(r'^(.*?)\s*[\[(]\s*([^\])]*?)\s*[\])]\s*$')


class CsvSource(Source):
    """A text file with columns; every cell is read as text first, so that no digit is lost."""

    FORMAT = 'CSV'

    def __init__(self, path: Path, shape: Mapping[str, Any]) -> None:
        super().__init__(path)
        self.shape, self._rows = shape_of(path, shape)
        self._columns = self._find_columns()

    @property
    def columns(self) -> tuple[Column, ...]:
        """Its columns in their order."""
        return self._columns

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
        return self.shape.as_map()

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

    # -- the file ------------------------------------------------------------------------------

    def _find_columns(self) -> tuple[Column, ...]:
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
        return tuple(columns)

    def _is_numeric(self, cells: Sequence[str]) -> bool:
        filled = [cell for cell in cells if cell.strip()]
        good = sum(is_number(cell, self.shape.decimal) for cell in filled)
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
        width = len(self._columns)

        def on_bad_row(row: csv.InvalidRow) -> str:
            if row.text.strip():
                where = '' if row.number is None else f'line {row.number}'
                self.warnings.count(
                    f'{self.path}: rows without {width} columns are left out', 1,
                    f'{where} with {row.actual_columns}'.strip())
            return 'skip'

        try:
            reader = csv.open_csv(
                pa.OSFile(str(self.path)),
                read_options=csv.ReadOptions(
                    use_threads=False, block_size=BLOCK_BYTES, skip_rows=self.shape.first_line - 1,
                    column_names=[column.name for column in self._columns],
                    encoding=_arrow_encoding(self.shape.encoding)),
                parse_options=csv.ParseOptions(
                    delimiter=self.shape.delimiter, invalid_row_handler=on_bad_row,
                    ignore_empty_lines=True),
                convert_options=csv.ConvertOptions(
                    column_types={name: pa.string() for name in names},
                    include_columns=list(names), strings_can_be_null=False,
                    quoted_strings_can_be_null=False))
            yield from reader
        except (pa.ArrowInvalid, UnicodeDecodeError) as problem:
            reason = ' '.join(str(problem).split())[:200]
            raise ImportingError(f'{self.path}: cannot be read as a table ({reason}): state csv: '
                                 'in the map') from problem

    def _numbers(self, name: str, cells: pa.Array, first_row: int) -> NDArray[np.float64]:
        texts = compute.utf8_trim_whitespace(cells)
        if self.shape.decimal == ',':
            texts = compute.replace_substring(texts, ',', '.')
        try:
            return np.asarray(compute.cast(texts, pa.float64()))
        except pa.ArrowInvalid:
            return self._with_gaps(name, texts, first_row)

    def _with_gaps(self, name: str, texts: pa.Array, first_row: int) -> NDArray[np.float64]:
        """NaN where a cell is empty or no number; the latter is a warning."""
        good = compute.match_substring_regex(texts, _PLAIN_NUMBER)
        empty = compute.is_in(texts, _MISSING)
        bad = np.flatnonzero(~(np.asarray(good) | np.asarray(empty)))
        if len(bad):
            cell = texts[int(bad[0])].as_py()
            self.warnings.count(f'{self.path}: cells of column {name!r} that are not numbers are '
            'left out', len(bad), f'{cell!r} in about line {first_row + bad[0]}')
        kept = compute.if_else(good, texts, None)
        return np.asarray(compute.fill_null(compute.cast(kept, pa.float64()), np.nan))


def _texts(cells: pa.Array) -> NDArray[np.object_]:
    return np.asarray(cells.to_numpy(zero_copy_only=False), dtype=object)


def _arrow_encoding(encoding: str) -> str:
    return 'utf8' if encoding in ('utf-8', 'utf-8-sig') else encoding
