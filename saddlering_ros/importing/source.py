"""Measured files: the reader for each, and the face of readers, columns and blocks of values."""

from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass
import fnmatch
from importlib import import_module
from pathlib import Path
import re
import stat
from typing import Any

import numpy as np
from numpy.typing import NDArray

from saddlering_ros.errors import did_you_mean
from saddlering_ros.files import resolved
from saddlering_ros.importing.calibration import (
    FACTORS,
    ImportingError,
    known_unit,
    measures,
    TIME,
    Unit,
)

BLOCK_ROWS = 1 << 16
"""Rows that are read at a time."""

MAX_LEFT_OUT = 0.01
"""Largest share of a file's rows that may be left out: those whose time does not rise, and those
with another number of columns."""

MAX_RATE_ERROR = 1e-3
"""Share by which a rate of the map may differ from the file's own: crystals differ by less, and
loggers state rounded rates."""

TIME_NAME = re.compile(r'time|zeit|stamp|date|datum|^t\b', re.I)
"""Names of columns that hold times."""

_HDF5 = b'\x89HDF\r\n\x1a\n'

NUMBER, TEXT, MOMENT = 'number', 'text', 'moment'
"""Kinds of columns: float64, text, int64 nanoseconds since 1970-01-01 UTC."""

Block = dict[str, NDArray[Any]]
"""Rows of some columns, by name."""


@dataclass(frozen=True)
class Timing:
    """The time that a file gives a channel of its own.

    start [ns], None where the file has no date; first [s] of the first row after it and period [s]
    of regular rows; column: of the times otherwise, in seconds after `start`; fault: why it cannot
    be used, '' if it can.
    """

    start: int | None
    first: float = 0.0
    period: float = 0.0
    column: str = ''
    fault: str = ''


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


class Source:
    """One measured file; `columns` in the order of the file, which a reader finds."""

    FORMAT = ''

    def __init__(self, path: Path) -> None:
        self.path = path
        self.columns: tuple[Column, ...] = ()
        self.unread: dict[str, str] = {}  # what is no column, and why
        self.shape_words: tuple[str, ...] = ()
        self.settings: dict[str, Any] = {}
        self._warnings: dict[str, list[Any]] = {}

    def blocks(self, names: Sequence[str], as_text: Collection[str] = ()) -> Iterator[Block]:
        """The named columns, BLOCK_ROWS or so at a time; as_text: those read as text."""
        counts = {name: self.column(name).rows or 0 for name in names}
        rows = counts[names[0]]
        if set(counts.values()) != {rows}:
            listed = ', '.join(f'{name}: {count}' for name, count in counts.items())
            raise ImportingError(f'{self.path}: columns that belong together have different '
                                 f'numbers of rows ({listed}): give each channel a time: of its '
                                 'own')
        for start in range(0, rows, BLOCK_ROWS):
            rows_read = slice(start, min(start + BLOCK_ROWS, rows))
            yield {name: self.read(name, rows_read) for name in names}

    def read(self, name: str, rows: slice) -> NDArray[Any]:
        """The values of a column in a slice of rows, for a reader without blocks of its own."""
        raise NotImplementedError

    def number_texts(self, name: str, cells: NDArray[Any], first: int) -> NDArray[Any]:
        """Texts of numbers in plain digits with a decimal point; first: row of the first cell."""
        return cells

    def column(self, name: str) -> Column:
        return next(column for column in self.columns if column.name == name)

    def warn(self, words: str, number: int = 0, first: str = '') -> None:
        """Note a fault that does not prevent the use of the file.

        number: of cases more, 0 for a fault that is not counted; first: place of the first case.
        """
        self._warnings.setdefault(f'{self.path}: {words}', [0, first])[0] += number

    def compare_unit(self, column: str, unit: Unit, key: str) -> None:
        """Note a unit of the map, at `key`, that is not the one that the file states."""
        stated = known_unit(self.column(column).unit)
        if stated is not None and stated != unit:
            self.warn(f'column {column!r} is in {stated.name} by the file and in {unit.name} by '
                      f'the map ({key}), which counts: correct the map if the file is right')

    def compare_period(self, column: str, period: float) -> None:
        """Note a period [s] of the map that is not the one that the file gives the column."""
        timing = self.column(column).timing
        own = 0.0 if timing is None else timing.period
        if timing is not None and timing.column:
            own = float(np.median(np.diff(next(self.blocks([timing.column]))[timing.column])))
        if own > 0.0 and abs(period / own - 1.0) > MAX_RATE_ERROR:
            self.warn(f'columns of {1.0 / own:.6g} Hz by the file are read at {1.0 / period:.6g} '
                      'Hz, by rate: of the map: give time: {from: file} if the file is right',
                      first=column)
        for other in self.columns if timing is None else ():
            if other.kind == NUMBER and TIME_NAME.search(other.name.rpartition('/')[2]):
                self._compare_steps(other, period)

    def _compare_steps(self, column: Column, period: float) -> None:
        """Note a column of times whose step is another period [s]; a count of rows is none."""
        steps = np.diff(next(self.blocks([column.name]))[column.name])
        unit = known_unit(column.unit) if measures(column.unit, TIME) else None
        factors = FACTORS[TIME].values() if unit is None else [unit.factor]
        # Of times with few digits the median step is none or two.
        typical = [float(np.median(steps)), float(np.mean(steps))] if steps.size else [0.0]
        step = typical[0]
        if step > 0.0 and (step != 1.0 or unit is not None) and not any(
                abs(one * float(factor) / period - 1.0) < MAX_RATE_ERROR
                for factor in factors for one in typical):
            self.warn(f'column {column.name!r} rises by {step:g} a row, and the rows are read at '
                      f'{1.0 / period:.6g} Hz, by rate: of the map: give time: {{column: '
                      f'{column.name}, unit: ..}} if the file is right')

    @property
    def warnings(self) -> list[str]:
        """Every fault that was noted, as one line."""
        return [line + (f': {number}' if number else '') + (f', first {first}' if first else '')
                for line, (number, first) in self._warnings.items()]


def open_sources(
    files: Sequence[Path], csv_shape: Mapping[str, Any] | None = None,
) -> list[Source]:
    """The reader of each file, found by its first bytes; csv_shape: of the map, for text files."""
    places = [resolved(file) for file in files]
    for number, file in enumerate(files):
        if places[number] in places[:number]:
            raise ImportingError(f'{file}: is given twice: give each file once')
    sources: list[Source] = []
    for path in files:
        try:
            if not stat.S_ISREG(path.stat().st_mode):
                raise ImportingError(f'{path}: is no regular file: give a measured file')
            with path.open('rb') as stream:
                head = stream.read(4096)
        except OSError as problem:
            raise ImportingError(f'{path}: cannot be read ({problem.strerror}): check the path'
                                 ) from problem
        if not head:
            raise ImportingError(f'{path}: is empty: give a measured file')
        module, name = 'csv_file', 'CsvSource'
        if head.startswith(b'TDSm'):
            module, name = 'tdms_file', 'TdmsSource'
        elif head.startswith((b'MDF     ', b'UnFinMF ')):
            module, name = 'mdf_file', 'MdfSource'
        elif head.startswith(_HDF5) or head[512:520] == _HDF5:
            is_matlab = head.startswith(b'MATLAB 7.3')
            module, name = 'array_files', 'Matlab73Source' if is_matlab else 'Hdf5Source'
        elif head.startswith(b'MATLAB 5.0'):
            module, name = 'array_files', 'MatlabSource'
        try:
            reader = getattr(import_module(f'saddlering_ros.importing.{module}'), name)
        except ModuleNotFoundError as problem:
            raise ImportingError(f'{path}: reading this format needs the Python package '
                                 f'{problem.name}: install it (pip install {problem.name})'
                                 ) from problem
        sources.append(reader(path, csv_shape or {}) if name == 'CsvSource' else reader(path))
    return sources


def find_column(sources: Sequence[Source], pattern: str, where: str) -> list[tuple[Source, str]]:
    """The one column that `pattern` means, in each file that has it; ImportingError otherwise.

    An exact name comes before other names of a column, and these before patterns with * and ?.
    """
    places = []
    for source in sources:
        names = (
            [column.name for column in source.columns if column.name == pattern]
            or [column.name for column in source.columns if pattern in column.others]
            or [column.name for column in source.columns
                if fnmatch.filter((column.name, *column.others), pattern)])
        if len(names) > 1:
            raise ImportingError(f'{where}: {pattern!r} matches several columns of {source.path} '
                                 f'({", ".join(names[:5])}): give one name')
        places += [(source, name) for name in names]
    if not places:
        for source in sources:
            for name, why in source.unread.items():
                if pattern in (name, name.rpartition('/')[2]):
                    raise ImportingError(f'{where}: column {pattern!r} of {source.path} is not '
                                         f'read, because {why}: save it as plain numbers')
        headings = [name for source in sources for column in source.columns
                    for name in (column.name, *column.others)]
        listed = ', '.join(dict.fromkeys(headings[:12]))
        raise ImportingError(f'{where}: no file has a column {pattern!r}'
                             f'{did_you_mean(pattern, headings)} (there are: {listed})')
    return places


def as_numbers(values: NDArray[Any]) -> NDArray[np.float64] | NDArray[np.int64]:
    """Whole numbers as int64, so that a time in nanoseconds keeps its last digit; else float64."""
    array = np.asarray(values)
    if array.dtype.kind in 'iu' and (array.dtype.itemsize < 8 or array.dtype.kind == 'i' or
                                     not len(array) or array.max() < 1 << 63):
        return array.astype(np.int64)
    return array.astype(np.float64)
