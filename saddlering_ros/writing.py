"""Files written as a whole or not at all: beside their place first, then renamed."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager, suppress
import ctypes
import errno
import fcntl
import os
from pathlib import Path
import shutil
import tempfile
import time

from saddlering_ros.errors import SaddleringError

_AT_FDCWD = -100
_EXCHANGE = 2

RANDOM_LETTERS = 8
"""By which the names of temporary files differ (tempfile.mkstemp)."""

MIN_AGE = 2.0
"""A temporary file younger than this [s] may not be locked by its writer yet."""


@contextmanager
def whole_file(path: Path | str, error: type[SaddleringError] = SaddleringError) -> Iterator[Path]:
    """A path to write to (same suffix) that becomes `path` when the block ends well.

    A crash, a full disk or Ctrl-C leaves the former file at `path`. Links are followed; a device
    or pipe is written to directly. Raises `error` with one line if nothing can be written.
    """
    path = Path(path)
    try:
        place = path.resolve()
        if place.is_dir():
            raise error(f'{path}: is a directory: give the name of a file')
        if place.exists() and not place.is_file():
            yield place
            return
        place.parent.mkdir(parents=True, exist_ok=True)
        _sweep(place.parent, f'.{place.name}.', place.suffix)
        handle, name = tempfile.mkstemp(
            prefix=f'.{place.name}.', suffix=place.suffix, dir=place.parent)
        with suppress(OSError):  # some file systems have no locks: nothing is removed there
            fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except OSError as problem:
        raise _unwritable(path, problem, error) from problem
    temporary = Path(name)
    try:
        yield temporary
        os.chmod(temporary, 0o666 & ~_umask())
        settle(temporary)
        os.replace(temporary, place)
        settle(place.parent)
    except OSError as problem:
        raise _unwritable(path, problem, error) from problem
    finally:
        temporary.unlink(missing_ok=True)
        os.close(handle)


@contextmanager
def temporary_folder(parent: Path, prefix: str) -> Iterator[Path]:
    """A folder in `parent` that is removed when the block ends.

    One that a killed process left under the same prefix is removed first. OSError if none can be
    made.
    """
    _sweep(parent, prefix, '')
    folder = Path(tempfile.mkdtemp(prefix=prefix, dir=parent))
    handle = os.open(folder, os.O_RDONLY)
    try:
        with suppress(OSError):
            fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
        yield folder
    finally:
        os.close(handle)
        shutil.rmtree(folder, ignore_errors=True)


def _sweep(parent: Path, prefix: str, suffix: str) -> None:
    """Remove the files of writers that were killed: a living writer holds a lock."""
    for left in parent.iterdir():
        middle = left.name[len(prefix):len(left.name) - len(suffix)]
        if not (left.name.startswith(prefix) and left.name.endswith(suffix)
                and len(middle) == RANDOM_LETTERS):
            continue
        with suppress(OSError):
            if time.time() - left.stat().st_mtime < MIN_AGE:
                continue
            handle = os.open(left, os.O_RDONLY | os.O_NOFOLLOW)
            try:
                fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
                if left.is_dir():
                    shutil.rmtree(left)
                else:
                    left.unlink()
            finally:
                os.close(handle)


def write_text(path: Path | str, text: str,
               error: type[SaddleringError] = SaddleringError) -> None:
    """Put `text` at `path`, whole or not at all."""
    with whole_file(path, error) as temporary:
        temporary.write_text(text, encoding='utf-8')


def settle(path: Path) -> None:
    """Wait until a file's bytes, or a folder's names, are on the disk and not only on the way."""
    handle = os.open(path, os.O_RDONLY)
    try:
        os.fsync(handle)
    except OSError as problem:
        if problem.errno not in (errno.EINVAL, errno.ENOTSUP):
            raise  # some file systems cannot do it for folders
    finally:
        os.close(handle)


def exchange(new: Path, old: Path) -> None:
    """Let two paths on one disk change places, at one go where the kernel can (Linux 3.15)."""
    with suppress(AttributeError):
        library = ctypes.CDLL(None, use_errno=True)
        if not library.renameat2(_AT_FDCWD, os.fsencode(new), _AT_FDCWD, os.fsencode(old),
                                 _EXCHANGE):
            return
    aside = new.with_name(f'{new.name}.replaced')
    old.rename(aside)
    new.rename(old)
    aside.rename(new)


def _umask() -> int:
    umask = os.umask(0)
    os.umask(umask)
    return umask


def _unwritable(path: Path, problem: OSError, error: type[SaddleringError]) -> SaddleringError:
    return error(f'{path}: cannot be written ({problem.strerror or problem}): '
                 'choose another place')
