"""TDMS files of LabVIEW and DIAdem, by npTDMS: scaled readings, each channel with its own time."""

from collections.abc import Iterator
from contextlib import contextmanager
import logging
from pathlib import Path
from typing import Any

from nptdms import TdmsFile
from nptdms.log import log_manager
import numpy as np
from numpy.typing import NDArray

from saddlering_ros.importing import source
from saddlering_ros.importing.calibration import ImportingError

_LABVIEW = -2_082_844_800
"""1904-01-01, from which LabVIEW counts, in seconds since 1970."""


class TdmsSource(source.Source):
    """A TDMS file, read in slices; every scaling that it holds is applied by npTDMS.

    Its columns are channels, as group/channel; the name of the channel alone will do.
    """

    FORMAT = 'TDMS'

    def __init__(self, path: Path) -> None:
        super().__init__(path)
        try:
            with self._log_as_warnings():
                self._file = TdmsFile.open(path, raw_timestamps=True)
            channels = [channel for group in self._file.groups() for channel in group.channels()]
        except Exception as problem:  # npTDMS has no error class of its own
            raise ImportingError(f'{path}: is damaged, or a TDMS file of an unknown form '
                                 f'({problem}): save it again') from problem
        self._channels = {f'{channel.group_name}/{channel.name}': channel for channel in channels}
        self.columns = tuple(self._column(name) for name in self._channels)

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
        period, start, stamp = float(given.get('wf_increment') or 0.0), None, None
        if period > 0.0:
            start = given.get('wf_start_time')
        if start is not None and start.seconds > 86400:  # else LabVIEW's zero: no time was set
            fraction = (start.second_fractions * 1_000_000_000 + (1 << 63)) >> 64
            stamp = (start.seconds + _LABVIEW) * 1_000_000_000 + fraction
        timing = None if period <= 0.0 else source.Timing(
            stamp, float(given.get('wf_start_offset') or 0.0), period)
        return source.Column(name, unit, len(channel), kind, tuple(map(str, first)), timing,
                             (channel.name,))

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
