"""Functions compiled by numba, and the folder in which their machine code is kept.

numba keeps machine code by the contents of the one file that holds a function. A function calls
others from other files, and their code is compiled into it. Here the code is kept by a digest of
every source that takes part: no change of any of them leaves stale code, and a new installation of
the same sources finds the code of the old one.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import cache
import hashlib
import os
from pathlib import Path
import shutil
import sys
import tempfile
import time
from typing import Any

import llvmlite
import numba as nb
from numba.core import caching
import numpy as np

UNUSED_DAYS = 60.0
"""Code that no process has loaded for so long [days] is removed."""


class Compiler:
    """Compiles functions whose code is made of `sources`: files, or folders with all their .py.

    Use as a decorator, as `numba.njit`: `@compiler(nogil=True)`. The code is kept in the first
    folder that can be written to: under NUMBA_CACHE_DIR if set, the user's cache folder, the
    __pycache__ beside the source. If there is none, each process compiles anew.
    """

    def __init__(self, *sources: str | Path) -> None:
        self.digest = digest_of(sources)
        self._beside = Path(sources[0]).resolve()

    def __call__(self, **options: Any) -> Callable[[Callable[..., Any]], Any]:
        def compiled(function: Callable[..., Any]) -> Any:
            dispatcher = nb.njit(**options)(function)
            folder = self.folder
            if folder is not None:
                dispatcher._cache = _cache_class(folder, self.digest)(dispatcher.py_func)
            return dispatcher
        return compiled

    @property
    def folder(self) -> Path | None:
        """Where the code is kept; None if no folder can be written to."""
        return _first_writable(self.digest, self._beside, os.environ.get('NUMBA_CACHE_DIR', ''),
                               os.environ.get('XDG_CACHE_HOME', ''), os.environ.get('HOME', ''))


def digest_of(sources: Sequence[str | Path]) -> str:
    """Digest of the sources' text, of the compiler and of numpy, as hexadecimal digits."""
    found = hashlib.sha256(repr((nb.__version__, llvmlite.__version__, np.__version__,
                                 sys.version_info[:2])).encode())
    for source in sources:
        path = Path(source)
        for file in sorted(path.rglob('*.py')) if path.is_dir() else [path]:
            found.update(file.name.encode() + b'\0' + file.read_bytes() + b'\0')
    return found.hexdigest()[:20]


@cache
def _first_writable(digest: str, source: Path, numba_folder: str, cache_home: str,
                    home: str) -> Path | None:
    places = [Path(numba_folder)] if numba_folder else []
    if cache_home or home:
        places.append(Path(cache_home or f'{home}/.cache') / 'saddlering_ros' / 'compiled')
    places.append((source if source.is_dir() else source.parent) / '__pycache__' / 'compiled')
    for place in places:
        folder = place / f'kept-{digest}'
        try:
            folder.mkdir(parents=True, exist_ok=True)
            tempfile.TemporaryFile(dir=folder).close()
        except OSError:
            continue
        _note_use(folder)
        return folder
    return None


def _note_use(folder: Path) -> None:
    """Mark a folder as used today and remove those that have not been used for long."""
    now = time.time()
    try:
        os.utime(folder)
        for other in folder.parent.glob('kept-*'):
            if now - other.stat().st_mtime > 86400.0 * UNUSED_DAYS:
                shutil.rmtree(other, ignore_errors=True)
    except OSError:
        return  # another process removed it first


@cache
def _cache_class(folder: Path, digest: str) -> type[Any]:
    """Numba's cache of one function, in `folder` and valid for the sources of `digest`."""

    class Locator(caching._CacheLocator):
        def __init__(self, line: int) -> None:
            self._line = line

        def get_cache_path(self) -> str:
            return str(folder)

        def get_source_stamp(self) -> str:
            return digest

        def get_disambiguator(self) -> str:
            return str(self._line)

        @classmethod
        def from_function(cls, function: Any, _file: str) -> Any:
            return cls(function.__code__.co_firstlineno)

    class Implementation(caching.CompileResultCacheImpl):
        _locator_classes = (Locator,)

    class Kept(caching.FunctionCache):
        _impl_class = Implementation

    return Kept
