"""HDF5 files and MATLAB files: by h5py, and by SciPy up to MATLAB's version 7 (format 5)."""

import os
from pathlib import Path
import struct
from typing import Any
import zlib

import h5py
import numpy as np
from numpy.typing import NDArray
from scipy.io import loadmat, whosmat
from scipy.io.matlab import mat_struct, MatReadError

from saddlering_ros.importing.calibration import ImportingError
from saddlering_ros.importing.source import as_numbers, Column, NUMBER, Source, TEXT

MAX_COLUMNS = 4096
"""Columns offered at most: a picture kept as a data set has thousands that nobody chooses."""

MAX_UNPACKED = 1 << 30
"""Most bytes of a MATLAB file of format 5, whose variables are read as a whole."""

_UNITS = ('unit', 'units', 'Unit', 'Units', 'UNITS', 'UNIT')
_DAMAGED = (OSError, RuntimeError, KeyError, ValueError, TypeError)


class Hdf5Source(Source):
    """An HDF5 file; a column is a dataset, a field of a table, or path:3 of a matrix.

    The rows of a matrix lie along its longer side.
    """

    FORMAT = 'HDF5'

    def __init__(self, path: Path) -> None:
        super().__init__(path)
        # Dataset of each column, with the field of a table or the index of a matrix.
        self._places: dict[str, tuple[str, str | int]] = {}
        try:
            self._file = h5py.File(path, 'r')
            self._file.visititems(self._visit)
        except _DAMAGED as problem:
            raise ImportingError(f'{path}: is damaged, or not an HDF5 file ({problem}): save it '
                                 'again') from problem

    def read(self, name: str, rows: slice) -> NDArray[Any]:
        try:
            values = self._values(name, rows)
        except _DAMAGED as problem:
            raise ImportingError(f'{self.path}: {name} cannot be read ({problem}): save the file '
                                 'again') from problem
        return values if self.column(name).kind == TEXT else as_numbers(values)

    def _values(self, name: str, rows: slice) -> NDArray[Any]:
        path, which = self._places[name]
        dataset = self._file[path]
        if isinstance(which, str):
            values = dataset.fields(which)[rows] if which else dataset[rows]
        else:
            is_wide = dataset.shape[1] > dataset.shape[0]
            values = dataset[which, rows] if is_wide else dataset[rows, which]
        if values.dtype.kind in 'SUO':
            return np.array([_text(value) for value in values], dtype=object)
        # By the attributes of netCDF: NaN for missing values, then scaled and shifted.
        where, given = f'{self.path}: {name}', dataset.attrs
        missing = [given[key] for key in ('_FillValue', 'missing_value') if key in given]
        scale, offset = (_number(where, key, given.get(key, usual))
                         for key, usual in (('scale_factor', 1.0), ('add_offset', 0.0)))
        lost = np.isin(values, np.ravel(missing)) if missing else np.zeros(len(values), dtype=bool)
        if lost.any() or (scale, offset) != (1.0, 0.0):
            values = np.where(lost, np.nan, values) * scale + offset
        return np.asarray(values)

    def _visit(self, name: str, dataset: Any) -> None:
        if not isinstance(dataset, h5py.Dataset) or name.startswith('#'):
            return
        before = len(self.columns)
        if (dataset.size or 0) < 2:
            pass
        elif dataset.dtype.names:
            for field in dataset.dtype.names:
                self._add(f'{name}/{field}', name, field, dataset.dtype[field])
        elif dataset.ndim == 1 or (dataset.ndim == 2 and 1 in dataset.shape):
            self._add(name, name, '' if dataset.ndim == 1 else 0, dataset.dtype)
        elif dataset.ndim == 2:
            for index in range(min(*dataset.shape, MAX_COLUMNS)):
                self._add(f'{name}:{index + 1}', name, index, dataset.dtype)
        if len(self.columns) == before:
            self.unread[name] = f'it is of type {dataset.dtype} and shape {dataset.shape}'

    def _add(self, name: str, path: str, which: str | int, kind: np.dtype[Any]) -> None:
        is_text = kind.kind in 'SU' or (kind.kind == 'O' and h5py.check_string_dtype(kind))
        if (not is_text and kind.kind not in 'fiu') or len(self.columns) == MAX_COLUMNS:
            return
        self._places[name] = path, which
        dataset = self._file[path]
        rows = max(dataset.shape)
        units = [dataset.attrs.get(key) for key in _UNITS]
        unit = next((value for value in units if isinstance(value, (bytes, str))), '')
        self.columns += (Column(
            name, _text(unit), rows, TEXT if is_text else NUMBER,
            tuple(map(str, self._values(name, slice(0, min(rows, 3))))),
            # /path with a leading slash, with dots as MATLAB writes it, and the last part
            others=(f'/{name}', name.replace('/', '.'), name.rpartition('/')[2])),)


def _number(where: str, key: str, value: Any) -> float:
    """An attribute that is one number, also as text. ImportingError if it is none."""
    try:
        [number] = map(float, np.ravel(value))
    except ValueError:
        raise ImportingError(f'{where}: its attribute {key} is {value!r}: give one number, or '
                             'remove it') from None
    return number


def _text(value: object) -> str:
    return value.decode('utf-8', 'replace') if isinstance(value, bytes) else str(value)


class Matlab73Source(Hdf5Source):
    """A MATLAB file of version 7.3: variables, and fields of structs as struct/field."""

    FORMAT = 'MAT 7.3'

    def _visit(self, name: str, dataset: Any) -> None:
        kind = bytes(dataset.attrs.get('MATLAB_class', b''))
        if kind not in _NOT_READ and 'MATLAB_empty' not in dataset.attrs:
            super()._visit(name, dataset)


_NOT_READ = (b'char', b'cell', b'function_handle')
_READ = ('double', 'single', 'int8', 'uint8', 'int16', 'uint16', 'int32', 'uint32', 'int64',
         'uint64', 'struct')


class MatlabSource(Source):
    """A MATLAB file of format 5; a column is a vector, name:3 of a matrix, or struct/field.

    The format compresses each variable as a whole, so that a variable is read as a whole too.
    """

    FORMAT = 'MAT 5'

    def __init__(self, path: Path) -> None:
        super().__init__(path)
        _check_unpacked_size(path)
        try:
            kinds = {name: kind for name, _, kind in whosmat(path)}
            self.unread = {name: f'it is of class {kind}' for name, kind in kinds.items()
                           if kind not in _READ}
            names = [name for name, kind in kinds.items() if kind in _READ]
            held = loadmat(path, variable_names=names, struct_as_record=False, squeeze_me=True)
        except (MatReadError, *_DAMAGED, NotImplementedError, EOFError, IndexError, zlib.error,
                MemoryError) as problem:
            raise ImportingError(f'{path}: is damaged, or a MATLAB file of an unknown form '
                                 f'({problem}): save it again, with -v7 or -v7.3') from problem
        self._values: dict[str, NDArray[Any]] = {}
        for name in names:
            self._collect(name, held[name])
        self.columns = tuple(
            Column(name, '', len(values), samples=tuple(map(str, values[:3])),
                   others=(name.replace('/', '.'), name.rpartition('/')[2]))
            for name, values in self._values.items())

    def read(self, name: str, rows: slice) -> NDArray[Any]:
        return self._values[name][rows]

    def _collect(self, name: str, value: Any) -> None:
        if isinstance(value, mat_struct):
            for field in value._fieldnames:
                self._collect(f'{name}/{field}', getattr(value, field))
            return
        if not isinstance(value, np.ndarray) or value.dtype.kind not in 'fiu' or value.size < 2:
            self.unread[name] = 'it is no vector or matrix of real numbers'
            return
        if value.ndim == 1:
            self._values[name] = as_numbers(value)
        elif value.ndim == 2:
            rows = value.T if value.shape[1] > value.shape[0] else value
            for index in range(min(rows.shape[1], MAX_COLUMNS)):
                self._values[f'{name}:{index + 1}'] = as_numbers(rows[:, index])


def _check_unpacked_size(path: Path) -> None:
    """ImportingError if the elements of a MATLAB file unpack to more than MAX_UNPACKED bytes.

    Elements follow the header of 128 bytes, each with its type and size (MAT-file format, level
    5). SciPy judges what is no compressed element.
    """
    unpacked = 0
    with path.open('rb') as file:
        order = '<' if file.read(128)[126:128] == b'IM' else '>'
        while len(head := file.read(8)) == 8:
            kind, size = struct.unpack(f'{order}II', head)
            if kind != 15:  # miCOMPRESSED
                file.seek(size, os.SEEK_CUR)
                continue
            unzip, packed = zlib.decompressobj(), file.read(size)
            while packed:
                try:
                    unpacked += len(unzip.decompress(packed, 1 << 24))
                except zlib.error:
                    return
                packed = unzip.unconsumed_tail
                if unpacked > MAX_UNPACKED:
                    raise ImportingError(f'{path}: unpacks to more than 1 GB, and this format is '
                                         'only read as a whole: save it with -v7.3')
