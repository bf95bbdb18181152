"""Files written whole or not at all: beside their place first, then moved into it at one go."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager, suppress
import ctypes
import errno
import os
from pathlib import Path
import tempfile

from saddlering_ros.errors import SaddleringError

_AT_FDCWD = -100
_EXCHANGE = 2


@contextmanager
def whole_file(path: Path | str, error: type[SaddleringError] = SaddleringError) -> Iterator[Path]:
    """A path to write to (same suffix) that becomes `path` when the block ends well.

    A crash, a full disk or Ctrl-C leaves what was at `path` before. Links are followed; a device
    or pipe is written to directly. Raises `error` with one line where nothing can be written.
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
        handle, name = tempfile.mkstemp(
            prefix=f'.{place.name}.', suffix=place.suffix, dir=place.parent)
        os.close(handle)
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
