"""Long arrays in scratch files: the memory that a bag needs does not grow with its length.

An array beyond `LONG` numbers lies in a file without a name, which the system removes with the
process. It is mapped, and used like any other array. Code that goes through it block by block
(`blocks`) and forgets what it has used (`forget`) holds one block of it in memory.
"""

from collections.abc import Callable, Iterator
import mmap
import os
from pathlib import Path
import tempfile
from typing import Any, BinaryIO

import numpy as np
from numpy.typing import DTypeLike, NDArray

from saddlering_ros.errors import BagError

LONG = 1 << 20
"""Samples beyond which an array lies in a scratch file: 105 s at 10 kHz."""

BLOCK = 1 << 18
"""Samples of a long array that are processed together."""

PARTS = 16
"""Stretches of a long record from which medians are taken."""


def scratch_array(shape: tuple[int, ...], dtype: DTypeLike) -> NDArray[Any]:
    """An array of zeros, to be filled; BagError if there is no room for it."""
    if shape[-1] <= LONG:
        return np.zeros(shape, dtype)
    try:
        return np.asarray(np.memmap(scratch_file(), dtype, 'w+', 0, shape))
    except OSError as problem:
        raise no_room(problem) from problem


def scratch_copy(values: NDArray[Any]) -> NDArray[Any]:
    """The same numbers (N,), in a scratch file if there are many."""
    copy = GrowingArray(values.dtype)
    for block in blocks(len(values)):
        copy.append(values[block])
    return copy.array()


def scratch_file() -> BinaryIO:
    """A file without a name, on a disk if possible: /tmp may be memory."""
    folder = os.environ.get('TMPDIR') or ('/var/tmp' if os.access('/var/tmp', os.W_OK) else None)
    try:
        return tempfile.TemporaryFile(buffering=0, dir=folder)
    except OSError as problem:
        raise no_room(problem) from problem


def no_room(problem: OSError) -> BagError:
    """Remedy if a scratch file cannot be written."""
    place = Path(os.environ.get('TMPDIR') or '/var/tmp')
    return BagError(f'{place}: a long bag needs scratch files there, which cannot be written '
                    f'({problem.strerror or problem}): let TMPDIR name a folder with more room')


class GrowingArray:
    """Numbers (N,) of one kind that arrive in parts, in a scratch file beyond `LONG`."""

    def __init__(self, dtype: DTypeLike) -> None:
        self._dtype = np.dtype(dtype)
        self.clear()

    def clear(self) -> None:
        self._parts: list[NDArray[Any]] = []
        self._file: BinaryIO | None = None
        self._count = 0

    def __len__(self) -> int:
        return self._count

    def append(self, values: NDArray[Any]) -> None:
        """Add numbers at the end; BagError if the disk is full."""
        if len(values):
            self._parts.append(np.ascontiguousarray(values, self._dtype))
            self._count += len(values)
        if self._count <= LONG:
            return
        self._file = self._file or scratch_file()
        try:
            for stored in self._parts:
                data = stored.data.cast('B')
                while data:
                    data = data[self._file.write(data):]
        except OSError as problem:
            raise no_room(problem) from problem
        self._parts.clear()

    def array(self) -> NDArray[Any]:
        """All of them; those of a file are mapped."""
        if self._file is not None:
            return np.asarray(np.memmap(self._file, self._dtype, 'r+', 0, self._count))
        self._parts = [np.concatenate([np.empty(0, self._dtype), *self._parts])]
        return self._parts[0]


def blocks(count: int, *arrays: NDArray[Any], size: int = BLOCK) -> Iterator[slice]:
    """The rows 0 to `count` in stretches of `size`; `arrays` are released after each."""
    for start in range(0, count, size):
        yield slice(start, min(start + size, count))
        forget(*arrays)


def forget(*arrays: NDArray[Any]) -> None:
    """Release the memory of mapped arrays; their numbers stay in the file."""
    for array in arrays:
        mapping: Any = array
        while mapping is not None and not isinstance(mapping, mmap.mmap):
            mapping = getattr(mapping, 'base', None)
        if mapping is not None:
            mapping.madvise(mmap.MADV_DONTNEED)


def _stretches(values: NDArray[Any]) -> list[NDArray[Any]]:
    """All numbers (N,) if they are few, else `PARTS` stretches spread evenly, one at the start."""
    if len(values) <= LONG:
        return [values]
    size = LONG // PARTS
    starts = np.linspace(0, len(values) - size, PARTS).astype(int).tolist()
    stretches = [values[start:start + size].copy() for start in starts]
    forget(values)
    return stretches


def spread(values: NDArray[Any]) -> NDArray[Any]:
    """The numbers (N,) if they are few, else some stretches in a row: about a million."""
    return values if len(values) <= LONG else np.concatenate(_stretches(values))


def spread_changes(values: NDArray[Any]) -> NDArray[Any]:
    """Differences of neighbours within the same stretches of numbers (N,)."""
    return np.concatenate([np.diff(stretch) for stretch in _stretches(values)])


def extremes(values: NDArray[Any]) -> tuple[Any, Any]:
    """Lowest and highest of the numbers (N,), NaN if one of them is."""
    limits = [(values[block].min(), values[block].max()) for block in blocks(len(values), values)]
    lowest, highest = np.array(limits).T
    return lowest.min(), highest.max()


def count_where(
    test: Callable[..., NDArray[np.bool_]], *arrays: NDArray[Any], ahead: int = 0,
) -> int:
    """Number of rows for which a test of blocks of `arrays` (..., N) is true.

    ahead: rows of the next block that each block includes, and that the test does not return.
    """
    count = arrays[0].shape[-1]
    return sum(
        int(np.count_nonzero(test(*(one[..., block.start:block.stop + ahead] for one in arrays))))
        for block in blocks(count, *arrays))


def complete_rows(
    load: NDArray[np.float64], gaps: NDArray[np.float64],
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Load (M,) and gaps (4, M) where all are finite; of a long record every so many samples."""
    step = -(-len(load) // LONG)
    complete = []
    for block in blocks(len(load), load, gaps, size=BLOCK // step * step):
        rows = np.vstack([load[block][::step], gaps[:, block][:, ::step]])
        complete.append(rows[:, np.isfinite(rows).all(axis=0)])
    kept = np.concatenate(complete, axis=1)
    return kept[0], kept[1:]
