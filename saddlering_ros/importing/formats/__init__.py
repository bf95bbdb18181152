"""Readers of measured files, one format each; `open_source` finds the one for a file."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path
import stat
from typing import Any

from saddlering_ros.importing.errors import ImportingError
from saddlering_ros.importing.source import Source


def open_source(path: Path, csv_shape: Mapping[str, Any] | None = None) -> Source:
    """The reader of the file at `path`, found by its first bytes; ImportingError if there is none.

    csv_shape: entries of a map on the shape of its text files.
    """
    head = _head(path)
    try:
        return _reader(head)(path, csv_shape or {})
    except ModuleNotFoundError as problem:
        raise ImportingError(f'{path}: reading this format needs the Python package '
                             f'{problem.name}: install it (pip install {problem.name})'
                             ) from problem


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


def _reader(head: bytes) -> Callable[[Path, Mapping[str, Any]], Source]:
    """The reader for a file that begins with `head`."""
    if head.startswith(b'TDSm'):
        return _tdms
    if head.startswith(b'MDF     '):
        return _mdf
    if head.startswith(b'\x89HDF\r\n\x1a\n') or head[512:520] == b'\x89HDF\r\n\x1a\n':
        return _matlab_73 if head.startswith(b'MATLAB 7.3') else _hdf5
    if head.startswith(b'MATLAB 5.0'):
        return _matlab_5
    return _csv


def _csv(path: Path, shape: Mapping[str, Any]) -> Source:
    from saddlering_ros.importing.formats.csv_file import CsvSource

    return CsvSource(path, shape)


def _tdms(path: Path, _: Mapping[str, Any]) -> Source:
    from saddlering_ros.importing.formats.tdms_file import TdmsSource

    return TdmsSource(path)


def _mdf(path: Path, _: Mapping[str, Any]) -> Source:
    from saddlering_ros.importing.formats.mdf_file import MdfSource

    return MdfSource(path)


def _hdf5(path: Path, _: Mapping[str, Any]) -> Source:
    from saddlering_ros.importing.formats.hdf5_file import Hdf5Source

    return Hdf5Source(path)


def _matlab_73(path: Path, _: Mapping[str, Any]) -> Source:
    from saddlering_ros.importing.formats.hdf5_file import Matlab73Source

    return Matlab73Source(path)


def _matlab_5(path: Path, _: Mapping[str, Any]) -> Source:
    from saddlering_ros.importing.formats.matlab_file import MatlabSource

    return MatlabSource(path)
