"""TDMS files of LabVIEW and DIAdem, by npTDMS: scaled readings, each channel with its own time."""

from collections.abc import Iterator
from contextlib import contextmanager
from itertools import pairwise
import logging
from pathlib import Path
from typing import Any, BinaryIO

from nptdms import TdmsFile
from nptdms.log import log_manager
from nptdms.reader import TdmsReader
import numpy as np
from numpy.typing import NDArray

from saddlering_ros.importing import source
from saddlering_ros.importing.calibration import ImportingError, words_of
from saddlering_ros.record.batches import SECOND

_LABVIEW = -2_082_844_800
"""1904-01-01, from which LabVIEW counts, in seconds since 1970."""

MAX_LEAP = 0.05 * SECOND
"""A start of a channel that lies farther [ns] from the end of the rows before it is that of
another recording: clocks of computers scatter by less, and no pause of a test is so short."""


class _Starts(TdmsReader):
    """Every start that a file gives a channel, with its rows before it: npTDMS keeps the last."""

    def __init__(self, stream: BinaryIO) -> None:
        super().__init__(stream)
        self.of_channel: dict[str, list[tuple[int, Any]]] = {}
        self._rows: dict[str, int] = {}
        self.read_metadata()

    def _update_object_properties(self, segment_object_properties: Any) -> None:
        for path, given in (segment_object_properties or {}).items():
            starts = [value for key, value in given if key == 'wf_start_time']
            self.of_channel.setdefault(path, []).extend(
                (self._rows.get(path, 0), start) for start in starts)
        super()._update_object_properties(segment_object_properties)
        self._rows = {path: one.num_values for path, one in self.object_metadata.items()}


class TdmsSource(source.Source):
    """A TDMS file, read in slices; every scaling that it holds is applied by npTDMS.

    Its columns are channels, as group/channel; the name of the channel alone will do.
    """

    FORMAT = 'TDMS'

    def __init__(self, path: Path) -> None:
        super().__init__(path)
        try:
            with self._log_as_warnings():
                with path.open('rb') as stream:
                    self._starts = _Starts(stream).of_channel
                # From a stream, because of a path an old index beside it would count.
                self._file = TdmsFile.open(path.open('rb'), raw_timestamps=True)
                channels = [one for group in self._file.groups() for one in group.channels()]
                self._channels = {f'{one.group_name}/{one.name}': one for one in channels}
                self.columns = tuple(map(self._column, self._channels))
        except Exception as problem:  # npTDMS has no error class of its own
            raise ImportingError(
                f'{path}: is damaged, or a TDMS file of an unknown form '
                f'({type(problem).__name__}: {problem}): save it again') from problem

    def read(self, name: str, rows: slice) -> NDArray[Any]:
        try:
            with self._log_as_warnings():
                values = self._channels[name].read_data(rows.start, rows.stop - rows.start)
        except Exception as problem:
            raise ImportingError(f'{self.path}: channel {name} cannot be read ({problem}): save '
                                 'the file again') from problem
        kind = self.column(name).kind
        if kind == source.MOMENT:  # as seconds since 1904 and fractions of 2^-64 s
            high = (np.asarray(values.second_fractions) >> np.uint64(32)).astype(np.int64)
            fraction = (high * 1_000_000_000 + (1 << 31)) >> 32
            return np.asarray((values.seconds + _LABVIEW) * 1_000_000_000 + fraction, np.int64)
        return np.asarray(values, object) if kind == source.TEXT else source.as_numbers(values)

    def _column(self, name: str) -> source.Column:
        channel = self._channels[name]
        given, kinds = channel.properties, {'TimeStamp': source.MOMENT, 'String': source.TEXT}
        kind = kinds.get(getattr(channel.data_type, '__name__', ''), source.NUMBER)
        first = channel.read_data(0, min(len(channel), 3)) if len(channel) else []
        unit = str(given.get('unit_string', '') or given.get('NI_UnitDescription', ''))
        return source.Column(name, unit, len(channel), kind, tuple(map(str, first)),
                             self._timing(channel), (channel.name,))

    def _timing(self, channel: Any) -> source.Timing | None:
        """The time of a waveform; None for a channel without one."""
        given = channel.properties
        period = float(given.get('wf_increment') or 0.0)
        if period <= 0.0:
            return None
        starts = [(row, _stamp(start)) for row, start in self._starts.get(channel.path, [])]
        leaps = [stamp for (row_before, before), (row, stamp) in pairwise(starts)
                 if stamp and before and stamp != before
                 and abs(stamp - before - (row - row_before) * period * SECOND) > MAX_LEAP]
        fault = (f'holds a second recording, from {words_of(leaps[0])} on: save each recording as '
                 'a file of its own') if leaps else ''
        return source.Timing(starts[0][1] if starts else None,
                             float(given.get('wf_start_offset') or 0.0), period, fault=fault)

    @contextmanager
    def _log_as_warnings(self) -> Iterator[None]:
        """Make what npTDMS logs (that the file is cut off, say) a warning of the import."""
        handler = logging.Handler(logging.WARNING)
        setattr(handler, 'emit',  # noqa: B010
                lambda record: self.warn(f'npTDMS: {record.getMessage()}'))
        loggers = list(log_manager.loggers.values())
        before = [logger.handlers for logger in loggers]
        for logger in loggers:
            logger.handlers, logger.propagate = [handler], False
        try:
            yield
        finally:
            for logger, handlers in zip(loggers, before, strict=True):
                logger.handlers = handlers


def _stamp(start: Any) -> int | None:
    """A start as a stamp [ns]; None for LabVIEW's zero, where no time was set."""
    if start.seconds <= 86400:
        return None
    fraction = (start.second_fractions * 1_000_000_000 + (1 << 63)) >> 64
    return int((start.seconds + _LABVIEW) * 1_000_000_000 + fraction)
