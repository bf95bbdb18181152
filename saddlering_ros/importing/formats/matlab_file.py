"""MATLAB files up to version 7 (format 5), by SciPy: vectors, matrices, fields of structs."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.io import loadmat, whosmat
from scipy.io.matlab import mat_struct, MatReadError

from saddlering_ros.importing.errors import ImportingError
from saddlering_ros.importing.source import as_numbers, Column, SlicedSource

MAX_COLUMNS = 4096
_READ = ('double', 'single', 'int8', 'uint8', 'int16', 'uint16', 'int32', 'uint32', 'int64',
         'uint64', 'struct')


class MatlabSource(SlicedSource):
    """A MATLAB file of format 5; a column is a vector, name:3 of a matrix, or struct/field.

    The format compresses each variable as a whole, so that a variable is read as a whole too.
    """

    FORMAT = 'MAT 5'

    def __init__(self, path: Path) -> None:
        super().__init__(path)
        try:
            names = [name for name, _, kind in whosmat(path) if kind in _READ]
            held = loadmat(path, variable_names=names, struct_as_record=False, squeeze_me=True)
        except (MatReadError, OSError, ValueError, NotImplementedError, TypeError,
                EOFError) as problem:
            raise ImportingError(f'{path}: is damaged, or a MATLAB file of an unknown form '
                                 f'({problem}): save it again, with -v7 or -v7.3') from problem
        self._values: dict[str, NDArray[Any]] = {}
        for name in names:
            self._collect(name, held[name])
        self._columns = tuple(
            Column(name, '', len(values), samples=tuple(map(str, values[:3])),
                   others=tuple(dict.fromkeys((name.replace('/', '.'), name.rpartition('/')[2]))))
            for name, values in self._values.items())

    @property
    def columns(self) -> tuple[Column, ...]:
        """Its columns in the order of the file."""
        return self._columns

    def read(self, name: str, part: slice) -> NDArray[Any]:
        """The values of a variable in a slice of rows."""
        return self._values[name][part]

    def _collect(self, name: str, value: Any) -> None:
        if isinstance(value, mat_struct):
            for field in value._fieldnames:
                self._collect(f'{name}/{field}', getattr(value, field))
            return
        if not isinstance(value, np.ndarray) or value.dtype.kind not in 'fiu' or value.size < 2:
            return
        if value.ndim == 1:
            self._values[name] = as_numbers(value)
        elif value.ndim == 2:
            rows = value.T if value.shape[1] > value.shape[0] else value
            for index in range(min(rows.shape[1], MAX_COLUMNS)):
                self._values[f'{name}:{index + 1}'] = as_numbers(rows[:, index])
