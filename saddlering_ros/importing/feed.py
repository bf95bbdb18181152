"""The channels of measured files that share a clock, as runs of stamps and readings in SI."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from saddlering_ros.importing import clock
from saddlering_ros.importing.calibration import ImportingError
from saddlering_ros.importing.clock import CountedTime, DatedTime, RegularTime, SECOND, Stamps
from saddlering_ros.importing.mapping import ChannelMap, Split
from saddlering_ros.importing.source import MOMENT, Source, Timing

Floats = NDArray[np.float64]

MAX_LEFT_OUT = 0.01
"""Largest share of a file's rows that may be left out because their time does not rise."""


LARGEST = float(np.finfo(np.float32).max)
"""Messages of probes hold 32-bit numbers."""


@dataclass(frozen=True)
class Part:
    """Rows of one run: its number from 0 on, its label, and samples by channel."""

    run: int
    label: str
    samples: Mapping[str, tuple[Stamps, Floats]]


@dataclass(frozen=True)
class Piece:
    """Channels of one file that are read together: columns by channel, and their clock."""

    source: Source
    columns: Mapping[str, str]
    seconds: Mapping[str, str]
    time: clock.TimeSource
    split_column: str = ''

    def names(self) -> list[str]:
        """Every column that has to be read."""
        names = [*self.columns.values(), *self.seconds.values(), *self.time_columns()]
        return list(dict.fromkeys([*names, *([self.split_column] if self.split_column else [])]))

    def as_text(self) -> tuple[str, ...]:
        """The columns whose cells are read as the text of the file."""
        return (*self.time_columns(), *([self.split_column] if self.split_column else []))

    def time_columns(self) -> tuple[str, ...]:
        """The columns that hold its time."""
        if isinstance(self.time, CountedTime):
            return (self.time.column,)
        if isinstance(self.time, DatedTime):
            return self.time.columns
        timing = self._timing()
        return (timing.column,) if timing is not None and timing.column else ()

    def stamps(self, block: Mapping[str, NDArray[Any]], first: int, count: int) -> Stamps:
        """The stamp of each row of a block that begins at row `first`."""
        if isinstance(self.time, RegularTime):
            return self.time.stamps(first, count)
        if isinstance(self.time, CountedTime):
            cells = block[self.time.column]
            if cells.dtype.kind == 'O':
                cells = self.source.number_texts(self.time.column, cells, first)
            if self.source.column(self.time.column).kind == MOMENT:
                raise ImportingError(f'{self.source.path}: column {self.time.column} holds dates: '
                                     'give format: file in place of its unit')
            return self.time.stamps(cells)
        if isinstance(self.time, DatedTime):
            return self.time.stamps([block[name] for name in self.time.columns])
        return self._own_stamps(block, first, count)

    def empty_rows(self, block: Mapping[str, NDArray[Any]]) -> NDArray[np.bool_]:
        """Rows (N,) without any cell: a table pads its shorter columns with them."""
        return np.logical_and.reduce([_is_empty(block[name]) for name in self.names()])

    def time_in_words(self, block: Mapping[str, NDArray[Any]], row: int) -> str:
        """The time cells of a row, and what they should be."""
        shown = ' '.join(str(block[name][row]) for name in self.time_columns())
        if isinstance(self.time, DatedTime):
            return f'{shown!r} does not fit {self.time.format}'
        return f'{shown!r} is no number'

    def _timing(self) -> Timing | None:
        column = self.source.column(next(iter(self.columns.values())))
        return column.timing

    def _own_stamps(self, block: Mapping[str, NDArray[Any]], first: int, count: int) -> Stamps:
        timing = self._timing()
        name = next(iter(self.columns.values()))
        if timing is None:
            raise ImportingError(f'{self.source.path}: column {name} has no time of its own: give '
                                 'time: {column: ..} or {rate: .., start: ..}')
        given = self.time.start if isinstance(self.time, clock.FileTime) else None
        start = given if given is not None else timing.start
        if start is None:
            self.source.warnings.add(f'{self.source.path}: has no date: stamps count from '
                                     '1970-01-01; give time: {from: file, start: ..}')
            start = 0
        if timing.column:
            if self.source.column(timing.column).kind == MOMENT:
                return np.asarray(block[timing.column], dtype=np.int64)
            return np.asarray(np.rint(np.asarray(block[timing.column], dtype=np.float64) * SECOND),
                              dtype=np.int64) + start
        rows = np.arange(first, first + count)
        elapsed = (timing.first + rows * timing.period) * SECOND
        return np.asarray(start + np.rint(elapsed).astype(np.int64))


@dataclass
class Feed:
    """Channels that share a clock, over one file or several in order of time."""

    pieces: list[Piece]
    channels: Mapping[str, ChannelMap]
    split: Split | None
    _run: int = 0
    _label: str = ''
    _last: int = clock.MISSING

    def parts(self) -> Iterator[Part]:
        """Its samples, run after run, in order of time."""
        for piece in self.pieces:
            rows = left_out = 0
            for block in piece.source.blocks(piece.names(), piece.as_text()):
                count = len(next(iter(block.values())))
                stamps = piece.stamps(block, rows, count)
                for part, kept, out in self._cut(piece, block, stamps, rows):
                    left_out += out
                    if len(kept):
                        yield self._part(part, piece, block, stamps, kept)
                rows += count
            self._check_left_out(piece, left_out, rows)

    def _cut(
        self, piece: Piece, block: Mapping[str, NDArray[Any]], stamps: Stamps, first: int,
    ) -> Iterator[tuple[tuple[int, str], NDArray[np.int64], int]]:
        """Runs of rows, each with the rows to keep and how many of its rows are left out."""
        good = np.flatnonzero(stamps != clock.MISSING)
        bad = good[:0]
        if len(good) < len(stamps):
            bad = np.flatnonzero((stamps == clock.MISSING) & ~piece.empty_rows(block))
        if len(bad):
            piece.source.warnings.count(
                f'{piece.source.path}: rows with an unreadable time are left out', len(bad),
                f'row {first + bad[0] + 1}, {piece.time_in_words(block, int(bad[0]))}')
        for run_rows in self._runs(piece, block, stamps, good):
            kept, out = self._going_on(piece, stamps, run_rows, first)
            yield (self._run, self._label), kept, out
        yield (self._run, self._label), good[:0], len(bad)

    def _runs(
        self, piece: Piece, block: Mapping[str, NDArray[Any]], stamps: Stamps,
        rows: NDArray[np.int64],
    ) -> Iterator[NDArray[np.int64]]:
        if self.split is None or not len(rows):
            yield rows
        elif self.split.by == 'gap':
            yield from self._runs_by_gap(stamps, rows)
        else:
            yield from self._runs_by_column(piece, block, rows)

    def _runs_by_gap(self, stamps: Stamps, rows: NDArray[np.int64]) -> Iterator[NDArray[np.int64]]:
        limit = round((self.split.seconds if self.split else 1.0) * SECOND)
        steps = np.diff(stamps[rows], prepend=stamps[rows[0]] if self._last == clock.MISSING
                        else self._last)
        starts = np.flatnonzero((steps > limit) | (steps < -limit))
        for index, part in enumerate(np.split(rows, starts)):
            if index:
                self._run += 1
                self._last = clock.MISSING
            if len(part):
                yield part

    def _runs_by_column(
        self, piece: Piece, block: Mapping[str, NDArray[Any]], rows: NDArray[np.int64],
    ) -> Iterator[NDArray[np.int64]]:
        cells = block[piece.split_column][rows]
        labels = np.array([_label(cell) for cell in cells.tolist()], dtype=object)
        starts = np.flatnonzero(labels[1:] != labels[:-1]) + 1
        for part, label in zip(np.split(rows, starts),
                               labels[np.concatenate([[0], starts])], strict=True):
            if label == '':
                piece.source.warnings.count(
                    f'{piece.source.path}: rows between runs (column {piece.split_column!r} is '
                    'empty), left out', len(part))
                continue
            if label != self._label:
                self._run += bool(self._label)
                self._label, self._last = label, clock.MISSING
            yield part

    def _going_on(
        self, piece: Piece, stamps: Stamps, rows: NDArray[np.int64], first: int,
    ) -> tuple[NDArray[np.int64], int]:
        """Those rows whose time is later than that of every row before them."""
        times = stamps[rows]
        before = np.maximum.accumulate(np.concatenate([[self._last], times]))[:-1]
        later = times > before
        self._last = int(max(before[-1], times[-1])) if len(times) else self._last
        stuck = int(np.sum(times == before))
        back = int(np.sum(times < before))
        path = piece.source.path
        if stuck:
            place = int(rows[np.argmax(times == before)]) + first + 1
            piece.source.warnings.count(f'{path}: rows with the time of an earlier row are left '
                                        'out', stuck, f'row {place}')
        if back:
            place = int(rows[np.argmax(times < before)]) + first + 1
            furthest = float((before - times)[times < before].max()) / SECOND
            piece.source.warnings.count(f'{path}: rows whose time goes back are left out', back,
                                        f'row {place}, by up to {furthest:.6g} s')
        return rows[later], stuck + back

    def _check_left_out(self, piece: Piece, left_out: int, rows: int) -> None:
        if left_out > max(1.0, MAX_LEFT_OUT * rows):
            reasons = '; '.join(line.partition(': ')[2] for line in piece.source.warnings.all()
                                if 'time' in line)
            raise ImportingError(
                f'{piece.source.path}: {left_out} of {rows} rows have a time that does not rise '
                f'({reasons}): several runs in one file need split: {{by: gap}}, a time with too '
                'few digits rate: and start:, local time at the end of daylight saving the times '
                'of the logger in UTC')

    def _part(
        self, part: tuple[int, str], piece: Piece, block: Mapping[str, NDArray[Any]],
        stamps: Stamps, rows: NDArray[np.int64],
    ) -> Part:
        samples = {}
        for name, column in piece.columns.items():
            channel = self.channels[name]
            second = block[piece.seconds[name]][rows] if name in piece.seconds else None
            values = self._values(piece, channel, _floats(piece, column, block[column][rows]),
                                  second)
            known = np.isfinite(values)
            shifted = stamps[rows] - round(channel.delay * SECOND)
            samples[name] = (shifted, values) if known.all() else (shifted[known], values[known])
        return Part(*part, samples)

    def _values(
        self, piece: Piece, channel: ChannelMap, readings: Floats, second: NDArray[Any] | None,
    ) -> Floats:
        values = channel.calibration.apply(readings * channel.polarity
                                           if channel.polarity < 0 else readings)
        lost = int(np.sum(np.isfinite(readings) & ~np.isfinite(values)))
        if lost:
            piece.source.warnings.count(
                f'{piece.source.path}: readings of {channel.name} outside of its calibration '
                'table, left out', lost)
        missing = int(np.sum(~np.isfinite(readings)))
        if missing:
            piece.source.warnings.count(
                f'{piece.source.path}: missing readings of {channel.name}, left out', missing)
        applied = np.isfinite(values)
        piston, rod = channel.areas
        if piston:
            values = values * piston
        if second is not None:
            other = channel.calibration.apply(np.asarray(second, dtype=np.float64))
            values = values - other * rod
        usable = np.abs(values) <= LARGEST
        unusable = int(np.sum(applied & ~usable))
        if unusable:
            piece.source.warnings.count(
                f'{piece.source.path}: readings of {channel.name} without a rod pressure, or too '
                'large for a message, left out', unusable)
        return np.where(usable, values, np.nan)


def _floats(piece: Piece, column: str, cells: NDArray[Any]) -> Floats:
    if cells.dtype.kind not in 'fiu':
        raise ImportingError(f'{piece.source.path}: column {column!r} holds text and no numbers: '
                             'name another column')
    return np.asarray(cells, dtype=np.float64)


def _is_empty(cells: NDArray[Any]) -> NDArray[np.bool_]:
    if cells.dtype.kind == 'f':
        return np.asarray(np.isnan(cells))
    if cells.dtype.kind == 'O':
        return np.array([not str(cell).strip() for cell in cells], dtype=bool)
    return np.zeros(len(cells), dtype=bool)


def _label(cell: object) -> str:
    if isinstance(cell, float):
        return '' if np.isnan(cell) else f'{cell:g}'
    return str(cell).strip()


def first_stamp(piece: Piece) -> int:
    """The first stamp of a piece, by which several files are put in order."""
    for block in piece.source.blocks(piece.names(), piece.as_text()):
        count = len(next(iter(block.values())))
        stamps = piece.stamps(block, 0, count)
        good = stamps[stamps != clock.MISSING]
        if len(good):
            return int(good[0])
    raise ImportingError(f'{piece.source.path}: has no row whose time can be read: correct time: '
                         'in the map')
