"""The channels of measured files that share a clock, as runs of stamps and readings in SI."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
import fnmatch

import numpy as np
from numpy.typing import NDArray

from saddlering_ros.bags.write import END_OF_STAMPS
from saddlering_ros.importing import calibration
from saddlering_ros.importing.calibration import CountedTime, ImportingError
from saddlering_ros.importing.mapping import ChannelMap, ImportMap, Split
from saddlering_ros.importing.source import Block, find_column, MAX_LEFT_OUT, MOMENT, Source
from saddlering_ros.record.batches import Floats, SECOND, Stamps

UNDATED, DAY = 10 * 365 * 86400 * SECOND, 86400 * SECOND
"""A stamp before 1980 [ns] comes of a time without a date: no rig was recorded then. It counts
from 1970-01-02, because a ROS header holds no time before 1970, and 0 for no time at all."""

LARGEST = float(np.finfo(np.float32).max)
"""Messages of probes hold 32-bit numbers."""

Samples = dict[str, tuple[Stamps, Floats]]
"""Stamps and readings in SI, by channel."""

Part = tuple[tuple[int, str], Samples]
"""Rows of one run: its number from 0 on and its label, and their samples."""


@dataclass
class Piece:
    """Channels of one file that are read together, and their clock.

    columns: by channel; rod_pressures: of the other side of the piston, by channel.
    """

    source: Source
    time: calibration.RegularTime | CountedTime | calibration.DatedTime
    split_column: str
    columns: dict[str, str] = field(default_factory=dict)
    rod_pressures: dict[str, str] = field(default_factory=dict)

    def blocks(self) -> Iterator[tuple[Block, Stamps, int]]:
        """Every column that is needed, with the stamp of each row and the number of the first."""
        as_text = [*self.time.columns, *([self.split_column] if self.split_column else [])]
        names = [*self.columns.values(), *self.rod_pressures.values(), *as_text]
        first = nights = 0
        before = np.int64(0)
        for block in self.source.blocks(list(dict.fromkeys(names)), as_text):
            cells = [block[name] for name in self.time.columns]
            count = len(next(iter(block.values())))
            if isinstance(self.time, CountedTime):
                (column,) = self.time.columns
                if self.source.column(column).kind == MOMENT:
                    raise ImportingError(f'{self.source.path}: column {column} holds dates: give '
                                         'format: file in place of its unit')
                if cells[0].dtype.kind == 'O':
                    cells = [self.source.number_texts(column, cells[0], first)]
            stamps = self.time.stamps(cells, np.arange(first, first + count))
            found = stamps != calibration.MISSING
            # A time of day that falls by half a day or more is of the next day.
            is_of_day = isinstance(self.time, calibration.DatedTime) and not self.time.is_dated
            if is_of_day and found.any():
                times = stamps[found]
                days = nights + np.cumsum(np.diff(times, prepend=before) < -DAY // 2)
                stamps[found], before, nights = times + DAY * days, times[-1], int(days[-1])
            wrong = np.flatnonzero(found & ((stamps < -DAY) | (stamps >= END_OF_STAMPS)))
            if len(wrong):
                raise ImportingError(
                    f'{self.source.path}: row {first + wrong[0] + 1} is of '
                    f'{calibration.words_of(stamps[wrong[0]])}, and a bag holds times from 1970 '
                    'to 2038: correct unit: and start: in time: (spreadsheets count days from '
                    '1899-12-30T00:00:00Z, LabVIEW seconds from 1904-01-01T00:00:00Z)')
            early = (stamps < UNDATED) & found
            if early.any():
                stamps[early] += DAY
                self.source.warn('stamps count from 1970-01-02, because the time has no date: '
                                 'give start: in time:')
            yield block, stamps, first
            first += count

    def first_stamp(self) -> int:
        """The first stamp, by which several files are put in order."""
        for _, stamps, _ in self.blocks():
            good = stamps[stamps != calibration.MISSING]
            if len(good):
                return int(good[0])
        raise ImportingError(f'{self.source.path}: has no row whose time can be read: correct '
                             'time: in the map')


def feeds_of(sources: Sequence[Source], mapping: ImportMap) -> list['Feed']:
    """Channels that are read together, by clock."""
    channels = {channel.name: channel for channel in mapping.channels}
    pieces: dict[object, Piece] = {}
    for channel in mapping.channels:
        where = f'channels.{channel.name}'
        held = [source for source in sources if fnmatch.fnmatch(source.path.name, channel.file)]
        if not held:
            raise ImportingError(f'{where}: there is no file named {channel.file!r}')
        for source, column in find_column(held, channel.column, where):
            time, together = _clock(source, column, channel.time or mapping.time)
            split = ''
            if mapping.split is not None and mapping.split.by == 'column':
                ((_, split),) = find_column([source], mapping.split.column, 'split.column')
            piece = pieces.setdefault((source.path, time, together), Piece(source, time, split))
            piece.columns[channel.name] = column
            source.compare_unit(column, channel.unit, f'{where}.unit')
            if channel.rod_pressure:
                ((_, rod),) = find_column([source], channel.rod_pressure, f'{where}.rod_pressure')
                source.compare_unit(rod, channel.unit, f'{where}.unit, of both pressures')
                piece.rod_pressures[channel.name] = rod
    # Pieces with the same channels follow each other in time.
    groups: dict[tuple[str, ...], list[Piece]] = {}
    for piece in pieces.values():
        groups.setdefault(tuple(piece.columns), []).append(piece)
    return [Feed(sorted(group, key=Piece.first_stamp) if len(group) > 1 else group, channels,
                 mapping.split) for group in groups.values()]


def _clock(
    source: Source, column: str, time: calibration.TimeSource,
) -> tuple[calibration.RegularTime | CountedTime | calibration.DatedTime, object]:
    """The clock of a column, by the names of the file, and what else equal clocks must share."""
    if isinstance(time, calibration.RegularTime):
        source.compare_period(column, time.period / SECOND)
        return time, source.column(column).rows
    if not isinstance(time, calibration.FileTime):
        names = [find_column([source], name, 'time.column')[0][1] for name in time.columns]
        if isinstance(time, CountedTime):
            source.compare_unit(names[0], time.unit, 'time.unit')
        return replace(time, columns=tuple(names)), None
    timing = source.column(column).timing
    if timing is None:
        raise ImportingError(f'{source.path}: column {column} has no time of its own: give '
                             'time: {column: ..} or {rate: .., start: ..}')
    if timing.fault:
        raise ImportingError(f'{source.path}: channel {column} {timing.fault}')
    start = time.start if time.start is not None else timing.start or 0
    if timing.column:
        return CountedTime((timing.column,), calibration.unit_of('s', 'time'), start), None
    return calibration.RegularTime(timing.period * SECOND, start, timing.first * SECOND), column


@dataclass
class Feed:
    """Channels that share a clock, over one file or several in order of time."""

    pieces: Sequence[Piece]
    channels: Mapping[str, ChannelMap]
    split: Split | None
    _run: int = 0
    _label: str = ''
    _last: int = calibration.MISSING

    @property
    def names(self) -> list[str]:
        return list(self.pieces[0].columns)

    def parts(self) -> Iterator[Part]:
        """Its samples, run after run, in order of time."""
        for piece in self.pieces:
            rows = left_out = 0
            for block, stamps, first in piece.blocks():
                rows += len(stamps)
                bad = np.flatnonzero(stamps == calibration.MISSING)
                if len(bad):  # a table pads its shorter columns with rows of empty cells
                    bad = bad[[any(str(cells[row]).strip() not in ('', 'nan')
                                   for cells in block.values()) for row in bad]]
                if len(bad):
                    left_out += len(bad)
                    shown = ' '.join(str(block[name][bad[0]]) for name in piece.time.columns)
                    words = (f'does not fit {piece.time.format}'
                             if isinstance(piece.time, calibration.DatedTime)
                             else 'is no number that is a time in this unit (of a datenum of '
                             'MATLAB subtract 719529)')
                    piece.source.warn('rows with an unreadable time are left out', len(bad),
                                      f'row {first + bad[0] + 1}, {shown!r} {words}')
                good = np.flatnonzero(stamps != calibration.MISSING)
                for run_rows in self._runs(piece, block, stamps, good):
                    # Kept are rows whose time is later than that of every row before them.
                    times = stamps[run_rows]
                    before = np.maximum.accumulate(np.concatenate([[self._last], times]))
                    self._last, before = int(before[-1]), before[:-1]
                    stuck, back = run_rows[times == before], run_rows[times < before]
                    is_repeat = np.all([(stuck > 0) & (cells[stuck] == cells[stuck - 1])
                                        for cells in block.values()], axis=0)
                    for words, rows_of in (('repeat the row before', stuck[is_repeat]),
                                           ('have the time of an earlier row', stuck[~is_repeat])):
                        if len(rows_of):
                            piece.source.warn(f'rows that {words} are left out', len(rows_of),
                                              f'row {rows_of[0] + first + 1}')
                    if len(back):
                        furthest = float((before - times)[times < before].max()) / SECOND
                        piece.source.warn('rows whose time goes back are left out', len(back),
                                          f'row {back[0] + first + 1}, by up to {furthest:.6g} s')
                    kept = run_rows[times > before]
                    left_out += len(run_rows) - len(kept) - int(is_repeat.sum())
                    if len(kept):
                        yield self._part(piece, block, stamps, kept)
            if left_out > max(1.0, MAX_LEFT_OUT * rows):
                reasons = '; '.join(line.partition(': ')[2] for line in piece.source.warnings
                                    if 'time' in line)
                raise ImportingError(
                    f'{piece.source.path}: {left_out} of {rows} rows have a time that does not '
                    f'rise ({reasons}): several runs in one file need split: {{by: gap}}, a time '
                    'with too few digits or a counter that rolls over rate: and start:, local '
                    'time at the end of daylight saving the times of the logger in UTC')

    def _runs(
        self, piece: Piece, block: Block, stamps: Stamps, rows: NDArray[np.int64],
    ) -> Iterator[NDArray[np.int64]]:
        """The rows of each run; `_run`, `_label` and `_last` are those of the run they belong to.

        A run by gaps ends where the time leaps, one by a column where its label changes.
        """
        if self.split is None or not len(rows):
            yield rows
        elif self.split.by == 'gap':
            before = stamps[rows[0]] if self._last == calibration.MISSING else self._last
            leaps = np.abs(np.diff(stamps[rows], prepend=before)) > self.split.seconds * SECOND
            for index, run_rows in enumerate(np.split(rows, np.flatnonzero(leaps))):
                if index:
                    self._run += 1
                    self._last = calibration.MISSING
                if len(run_rows):
                    yield run_rows
        else:
            cells = block[piece.split_column][rows].tolist()
            labels = np.array([
                str(cell).strip() if not isinstance(cell, float) else
                '' if np.isnan(cell) else f'{cell:g}' for cell in cells], dtype=object)
            starts = np.flatnonzero(labels[1:] != labels[:-1]) + 1
            for run_rows, label in zip(np.split(rows, starts), labels[[0, *starts]], strict=True):
                if label == '':
                    piece.source.warn(f'rows between runs (column {piece.split_column!r} is '
                                      'empty), left out', len(run_rows))
                    continue
                if label != self._label:
                    self._run += bool(self._label)
                    self._label, self._last = label, calibration.MISSING
                yield run_rows


    def _part(self, piece: Piece, block: Block, stamps: Stamps, rows: NDArray[np.int64]) -> Part:
        """Readings in SI of these rows, without those that no message can hold."""
        samples = {}
        for name, column in piece.columns.items():
            if block[column].dtype.kind not in 'fiu':
                if column in (*piece.time.columns, piece.split_column):
                    raise ImportingError(f'{piece.source.path}: column {column!r} is that of the '
                                         'time or of split: too: name another column')
                raise ImportingError(f'{piece.source.path}: column {column!r} holds text and no '
                                     'numbers: name another column')
            channel, readings = self.channels[name], np.asarray(block[column][rows], np.float64)
            values = channel.calibration.apply(readings * channel.polarity)
            is_read, applied = np.isfinite(readings), np.isfinite(values)
            piston, rod = channel.areas
            if piston:
                values = values * piston
            if name in piece.rod_pressures:
                other = np.asarray(block[piece.rod_pressures[name]][rows], np.float64)
                values = values - channel.calibration.apply(other * channel.polarity) * rod
            usable = np.abs(values) <= LARGEST
            for words, lost in (
                    (f'readings of {name} outside of its calibration table, left out',
                     is_read & ~applied),
                    (f'missing readings of {name}, left out', ~is_read),
                    (f'readings of {name} without a rod pressure, or too large for a message, '
                     'left out', applied & ~usable)):
                if lost.any():
                    piece.source.warn(words, int(lost.sum()))
            shifted = stamps[rows] - round(channel.delay * SECOND)
            samples[name] = (shifted, values) if usable.all() else (
                shifted[usable], values[usable])
        return (self._run, self._label), samples
