"""Measured files: the reader for each, and the face of readers, columns and blocks of values."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
import fnmatch
from functools import cached_property
from importlib import import_module
from pathlib import Path
import stat
from typing import Any

import numpy as np
from numpy.typing import NDArray

from saddlering_ros.errors import did_you_mean
from saddlering_ros.files import sha256_of_file
from saddlering_ros.importing.calibration import ImportingError

BLOCK_ROWS = 1 << 16
"""Rows that are read at a time."""

_HDF5 = b'\x89HDF\r\n\x1a\n'

NUMBER, TEXT, MOMENT = 'number', 'text', 'moment'
"""Kinds of columns: float64, text, int64 nanoseconds since 1970-01-01 UTC."""


@dataclass(frozen=True)
class Timing:
    """The time that a file gives a channel of its own.

    start [ns], None where the file has no date; first [s] of the first row after it and period [s]
    of regular rows; column: of the times otherwise, in seconds after `start` or as moments.
    """

    start: int | None
    first: float = 0.0
    period: float = 0.0
    column: str = ''


@dataclass(frozen=True)
class Column:
    """A column as a file declares it.

    unit: as in the file, '' if it states none; rows: how many, None if not known before reading;
    samples: its first cells, for people; others: further names that it answers to.
    """

    name: str
    unit: str = ''
    rows: int | None = None
    kind: str = NUMBER
    samples: tuple[str, ...] = ()
    timing: Timing | None = None
    others: tuple[str, ...] = ()


@dataclass
class Warnings:
    """Faults of a file that do not prevent its use: words and places."""

    lines: list[str] = field(default_factory=list)
    counts: dict[str, list[Any]] = field(default_factory=dict)

    def add(self, line: str) -> None:
        """A warning of its own."""
        if line not in self.lines:
            self.lines.append(line)

    def count(self, what: str, number: int, first: str = '') -> None:
        """`number` more cases of `what`; the first is named."""
        entry = self.counts.setdefault(what, [0, first])
        entry[0] += number

    def all(self) -> list[str]:
        """Every warning as one line."""
        counted = [f'{what}: {number}' + (f', first {first}' if first else '')
                   for what, (number, first) in self.counts.items()]
        return [*self.lines, *counted]


class Source(ABC):
    """One measured file; `columns` in the order of the file, which a reader finds."""

    FORMAT = ''

    def __init__(self, path: Path) -> None:
        self.path = path
        self.warnings = Warnings()
        self.columns: tuple[Column, ...] = ()

    @abstractmethod
    def blocks(
        self, names: Sequence[str], as_text: Collection[str] = (),
    ) -> Iterator[dict[str, NDArray[Any]]]:
        """The named columns, rows together, BLOCK_ROWS or so at a time.

        as_text: columns of a text file whose cells are read as text.
        """

    def number_texts(self, name: str, cells: NDArray[Any], first: int) -> NDArray[Any]:
        """Texts of numbers in plain digits with a decimal point; first: row of the first cell."""
        return cells

    @cached_property
    def sha256(self) -> str:
        """Of the whole file."""
        return sha256_of_file(self.path)

    def describe(self) -> list[str]:
        """Findings about the shape of the file, for people."""
        return []

    def settings(self) -> dict[str, Any]:
        """Entries of a map on the shape of the file, as found."""
        return {}

    def column(self, name: str) -> Column:
        """The column of that exact name."""
        return next(column for column in self.columns if column.name == name)

    def check_equal_rows(self, names: Sequence[str]) -> None:
        """ImportingError if columns that are read together have different numbers of rows."""
        rows = {name: self.column(name).rows for name in names}
        if len(set(rows.values())) > 1:
            listed = ', '.join(f'{name}: {count}' for name, count in rows.items())
            raise ImportingError(f'{self.path}: columns that belong together have different '
                                 f'numbers of rows ({listed}): give each channel a time: of its '
                                 'own')


class SlicedSource(Source):
    """A file whose columns can be read a slice of rows at a time, each on its own."""

    def blocks(
        self, names: Sequence[str], as_text: Collection[str] = (),
    ) -> Iterator[dict[str, NDArray[Any]]]:
        """Columns of equal length, slice by slice."""
        self.check_equal_rows(names)
        for part in slices(self.column(names[0]).rows or 0):
            yield {name: self.read(name, part) for name in names}

    @abstractmethod
    def read(self, name: str, part: slice) -> NDArray[Any]:
        """The values of a column in a slice of rows."""


def open_source(path: Path, csv_shape: Mapping[str, Any] | None = None) -> Source:
    """The reader of the file at `path`, found by its first bytes; ImportingError if there is none.

    csv_shape: entries of a map on the shape of its text files.
    """
    module, name = _reader(_head(path))
    try:
        reader = getattr(import_module(f'saddlering_ros.importing.{module}'), name)
        source: Source = reader(path, csv_shape or {}) if module == 'csv_file' else reader(path)
    except ModuleNotFoundError as problem:
        raise ImportingError(f'{path}: reading this format needs the Python package '
                             f'{problem.name}: install it (pip install {problem.name})'
                             ) from problem
    return source


def _head(path: Path) -> bytes:
    try:
        if not stat.S_ISREG(path.stat().st_mode):
            raise ImportingError(f'{path}: is no regular file: give a measured file')
        with path.open('rb') as file:
            head = file.read(4096)
    except OSError as problem:
        raise ImportingError(f'{path}: cannot be read ({problem.strerror}): check the path'
                             ) from problem
    if not head:
        raise ImportingError(f'{path}: is empty: give a measured file')
    return head


def _reader(head: bytes) -> tuple[str, str]:
    """Module and class of the reader for a file that begins with `head`."""
    if head.startswith(b'TDSm'):
        return 'tdms_file', 'TdmsSource'
    if head.startswith(b'MDF     '):
        return 'mdf_file', 'MdfSource'
    if head.startswith(_HDF5) or head[512:520] == _HDF5:
        is_matlab = head.startswith(b'MATLAB 7.3')
        return 'array_files', 'Matlab73Source' if is_matlab else 'Hdf5Source'
    if head.startswith(b'MATLAB 5.0'):
        return 'array_files', 'MatlabSource'
    return 'csv_file', 'CsvSource'


def find_column(sources: Sequence[Source], pattern: str, where: str) -> list[tuple[Source, str]]:
    """The one column that `pattern` means, in each file that has it; ImportingError otherwise."""
    found = []
    for source in sources:
        names = _matching(source.columns, pattern)
        if len(names) > 1:
            raise ImportingError(f'{where}: {pattern!r} matches several columns of {source.path} '
                                 f'({", ".join(names[:5])}): give one name')
        found += [(source, name) for name in names]
    if not found:
        known = [name for source in sources for column in source.columns
                 for name in (column.name, *column.others)]
        listed = ', '.join(dict.fromkeys(known[:12]))
        raise ImportingError(f'{where}: no file has a column {pattern!r}'
                             f'{did_you_mean(pattern, known)} (there are: {listed})')
    return found


def _matching(columns: Sequence[Column], pattern: str) -> list[str]:
    """Exact names first, then other names of a column, then patterns with * and ?."""
    exact = [column.name for column in columns if column.name == pattern]
    if exact:
        return exact
    others = [column.name for column in columns if pattern in column.others]
    if others:
        return others
    return [column.name for column in columns
            if any(fnmatch.fnmatchcase(name, pattern) for name in (column.name, *column.others))]


def slices(rows: int) -> Iterator[slice]:
    """`rows` rows, BLOCK_ROWS at a time."""
    for start in range(0, rows, BLOCK_ROWS):
        yield slice(start, min(start + BLOCK_ROWS, rows))


def as_numbers(values: NDArray[Any]) -> NDArray[np.float64] | NDArray[np.int64]:
    """Whole numbers as int64, so that a time in nanoseconds keeps its last digit; else float64."""
    array = np.asarray(values)
    if array.dtype.kind in 'iu' and (array.dtype.itemsize < 8 or array.dtype.kind == 'i' or
                                     not len(array) or array.max() < 1 << 63):
        return array.astype(np.int64)
    return array.astype(np.float64)
