"""Functions compiled by numba, and the folder in which their machine code is kept.

numba keeps machine code by the contents of the one file that holds a function. A function calls
others from other files, and their code is compiled into it. Here the code is kept by a digest of
every source that takes part: no change of any of them leaves stale code, and a new installation of
the same sources finds the code of the old one.

To load kept code is to run it (numba pickles it). It is therefore loaded from a folder only that
belongs to this user and that no other user can write to, and from a file only whose digest is that
of its content.
"""

from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from functools import cache
import hashlib
import io
import os
from pathlib import Path
import shutil
import stat
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

DIGEST_BYTES = 32
"""A file of kept code ends in the SHA-256 of all before it."""


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
                dispatcher._cache = _Kept(dispatcher.py_func, folder, self.digest)
            return dispatcher
        return compiled

    @property
    def folder(self) -> Path | None:
        """Where the code is kept; None if no folder can be written to."""
        return _first_writable(self.digest, self._beside, *(
            os.environ.get(name, '') for name in ('NUMBA_CACHE_DIR', 'XDG_CACHE_HOME', 'HOME')))


def digest_of(sources: Sequence[str | Path]) -> str:
    """Digest of the sources' text, of the compiler and of numpy, as hexadecimal digits."""
    digest = hashlib.sha256(repr((nb.__version__, llvmlite.__version__, np.__version__,
                                  sys.version_info[:2], DIGEST_BYTES)).encode())
    for source in sources:
        path = Path(source)
        for file in sorted(path.rglob('*.py')) if path.is_dir() else [path]:
            digest.update(file.name.encode() + b'\0' + file.read_bytes() + b'\0')
    return digest.hexdigest()[:20]


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
            folder.mkdir(mode=0o700, parents=True, exist_ok=True)
            if not _is_of_this_user_alone(folder):
                continue
            tempfile.TemporaryFile(dir=folder).close()
        except OSError:
            continue
        now = time.time()
        with suppress(OSError):  # another process may have removed one first
            os.utime(folder)
            for other in place.glob('kept-*'):
                if now - other.stat().st_mtime > 86400.0 * UNUSED_DAYS:
                    shutil.rmtree(other, ignore_errors=True)
        return folder
    return None


def _is_of_this_user_alone(folder: Path) -> bool:
    """Whether a folder is of this user; it is closed to others, and rid of what they wrote."""
    state = folder.lstat()
    if not stat.S_ISDIR(state.st_mode) or state.st_uid != os.geteuid():
        return False
    was_open = bool(state.st_mode & 0o022)
    folder.chmod(0o700)
    for file in folder.iterdir():
        of_file = file.lstat()
        if was_open or of_file.st_uid != os.geteuid() or not stat.S_ISREG(of_file.st_mode):
            shutil.rmtree(file) if stat.S_ISDIR(of_file.st_mode) else file.unlink()
    return True


class _Kept(caching.FunctionCache):
    """Numba's cache of one function, in `folder` and valid for the sources of `digest`."""

    def __init__(self, function: Callable[..., Any], folder: Path, digest: str) -> None:
        class Locator(caching._CacheLocator):
            def get_cache_path(self) -> str:
                return str(folder)

            def get_source_stamp(self) -> str:
                return digest

            def get_disambiguator(self) -> str:
                return str(function.__code__.co_firstlineno)

            @classmethod
            def from_function(cls, _function: Any, _file: str) -> Any:
                return cls()

        class Implementation(caching.CompileResultCacheImpl):
            _locator_classes = (Locator,)

        self._impl_class = Implementation
        super().__init__(function)
        self._cache_file = _CheckedFile(
            cache_path=self._cache_path, filename_base=self._impl.filename_base,
            source_stamp=digest)


class _CheckedFile(caching.IndexDataCacheFile):
    """Numba's files of one function, each with the digest of its content at its end.

    Numba reads as far as its own data go. A damaged file is removed, and its code compiled again.
    """

    @contextmanager
    def _open_for_write(self, filepath: str) -> Iterator[io.BytesIO]:
        content = io.BytesIO()
        yield content
        with super()._open_for_write(filepath) as file:
            file.write(content.getvalue() + hashlib.sha256(content.getvalue()).digest())

    def _load_index(self) -> Any:
        return super()._load_index() if _is_whole(Path(self._index_path)) else {}

    def _load_data(self, name: str) -> Any:
        return super()._load_data(name) if _is_whole(Path(self._data_path(name))) else None


def _is_whole(path: Path) -> bool:
    """Whether a file is as it was written, or not there; one that is not is removed."""
    try:
        content = path.read_bytes()
    except FileNotFoundError:
        return True
    is_whole = hashlib.sha256(content[:-DIGEST_BYTES]).digest() == content[-DIGEST_BYTES:]
    if not is_whole:
        _note_damage()
        path.unlink(missing_ok=True)
    return is_whole


@cache
def _note_damage() -> None:
    print('note: kept machine code was damaged and is compiled again', file=sys.stderr)
