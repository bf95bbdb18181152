"""Files: the shipped ones, inputs that no output replaces, whole-file writes, hashes of inputs."""

from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager, ExitStack, suppress
import ctypes
from dataclasses import dataclass, field
import errno
import fcntl
from functools import lru_cache
import hashlib
import os
from pathlib import Path
import platform
import shutil
import sys
import tempfile
import time
from typing import Any

from saddlering_ros import __version__
from saddlering_ros.errors import SaddleringError


def share_directory() -> Path:
    """Return the directory that holds config/, launch/ and bags/.

    In order: the source tree this module runs from, every prefix of AMENT_PREFIX_PATH, and the
    prefix of this Python. SaddleringError when none of them holds the package.
    """
    source = Path(__file__).resolve().parent.parent
    if (source / 'package.xml').is_file():
        return source
    prefixes = [*os.environ.get('AMENT_PREFIX_PATH', '').split(os.pathsep), sys.prefix]
    for prefix in filter(None, prefixes):
        share = Path(prefix) / 'share' / 'saddlering_ros'
        if (share / 'package.xml').is_file():
            return share
    raise SaddleringError(
        f'saddlering_ros: config and bags not found under {sys.prefix}/share; '
        'source the workspace (install/setup.bash), or install the package again')


BAG_FILES = ('metadata.yaml', '*.mcap', '*.mcap.zstd')


class FileConflict(SaddleringError):
    """An output would replace something that is read, or another output.

    A command asks for all of its paths before any work; a result of the API, which no command may
    have made, asks when it writes; an import asks for the tables that only its map names.
    """


def spare_files(output: Path, words: str, sources: Iterable[tuple[Path, str]]) -> None:
    """FileConflict if `output`, called `words`, is one of the files that are read."""
    for source, its_words in sources:
        if same_file(output, source):
            raise FileConflict(f'{words} is the file that is read as {its_words}: '
                               'choose another name for the output')


def spare_bags(output: Path, words: str, bags: Iterable[tuple[Path, str]]) -> None:
    """FileConflict if `output`, called `words`, is or lies in a bag, or is one of its files."""
    place = resolved(output)
    for bag, its_words in bags:
        inside = any(same_file(folder, bag) for folder in (place, *place.parents))
        linked = output.is_file() and bag.is_dir() and any(
            same_file(output, file) for pattern in BAG_FILES for file in bag.glob(pattern))
        if inside or linked:
            raise FileConflict(f'{words} is part of the bag {its_words} that is read: '
                               'choose a place outside the bag')


def check_writable(folder: Path, words: str) -> None:
    """FileConflict if the output called `words` cannot be put into the folder, there or not."""
    there = next(path for path in (folder, *folder.parents) if path.exists())
    if not there.is_dir():
        raise FileConflict(f'{words}: {there.name} is not a folder: choose another place')
    try:
        tempfile.TemporaryFile(dir=there).close()
    except OSError as problem:
        raise FileConflict(f'{words}: {there} cannot be written to ({problem.strerror}): choose '
                           'another place') from problem


def bag_folder(bag: Path) -> Path:
    """The folder that is the bag whose file is `bag`, or `bag` itself."""
    folder = resolved(bag).parent
    return folder if bag.is_file() and (folder / BAG_FILES[0]).exists() else bag


def same_file(first: Path, second: Path) -> bool:
    """Whether two paths are one file or folder, by any link; of those not there yet, by name."""
    try:
        return os.path.samefile(first, second)
    except OSError:
        return resolved(first) == resolved(second)


def resolved(path: Path) -> Path:
    """The path without links, as far as it can be followed."""
    try:
        return path.resolve()
    except (OSError, RuntimeError):  # a loop of links, or a name that no system takes
        return Path(os.path.abspath(path))


_AT_FDCWD, _NO_REPLACE, _EXCHANGE = -100, 1, 2

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
    with ExitStack() as stack:
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
            stack.callback(os.close, handle)
            stack.callback(Path(name).unlink, missing_ok=True)
            with suppress(OSError):  # some file systems have no locks: nothing is removed there
                fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
            yield Path(name)
            umask = os.umask(0)
            os.umask(umask)
            os.chmod(name, 0o666 & ~umask)
            settle(Path(name))
            os.replace(name, place)
            settle(place.parent)
        except OSError as problem:
            raise error(f'{path}: cannot be written ({problem.strerror or problem}): '
                        'choose another place') from problem


@contextmanager
def temporary_folder(parent: Path, prefix: str) -> Iterator[Path]:
    """A folder in `parent` that is removed when the block ends.

    What a killed process left under the same prefix is removed first. OSError if none can be made.
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
        if left.name.startswith(prefix) and left.name.endswith(suffix) and (
                len(left.name) == len(prefix) + RANDOM_LETTERS + len(suffix)):
            remove_unlocked(left, left)


def remove_unlocked(lock: Path, *paths: Path) -> bool:
    """Remove files and folders unless a living process holds `lock`; whether it did."""
    with suppress(OSError):
        if time.time() - lock.stat().st_mtime < MIN_AGE:
            return False
        handle = os.open(lock, os.O_RDONLY | os.O_NOFOLLOW)
        try:
            fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
            for path in paths:
                if path.is_dir():
                    shutil.rmtree(path)
                else:
                    path.unlink(missing_ok=True)
            return True
        finally:
            os.close(handle)
    return False


PAGE_ENDINGS = ('.html', '.htm')


def check_ending(path: Path | str, endings: Sequence[str], error: type[Exception]) -> None:
    """Raise `error` if a file would have the ending of another format; none at all is allowed."""
    ending = Path(path).suffix.lower()
    if ending and ending not in endings:
        raise error(f'{path}: is not written as {ending[1:].upper()}: give a name that ends in '
                    f'{" or ".join(endings)}')


def write_text(path: Path | str, text: str,
               error: type[SaddleringError] = SaddleringError) -> None:
    """Put `text` at `path`, whole or not at all."""
    with whole_file(path, error) as temporary:
        temporary.write_text(text, encoding='utf-8')


def write_csv(path: Path | str, columns: Mapping[str, Iterable[Any]],
              error: type[SaddleringError] = SaddleringError) -> None:
    """Write columns of equal length as CSV, whole or not at all; an empty cell for None."""
    import csv  # which takes longer than most that `--help` needs

    with whole_file(path, error) as temporary, temporary.open(
            'w', encoding='utf-8', newline='') as file:
        table = csv.writer(file)
        table.writerow(columns)
        table.writerows(zip(*columns.values(), strict=True))


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


def _renamed(new: Path, place: Path, flag: int) -> bool:
    """Rename by a flag of renameat2 (Linux 3.15); whether kernel and file system can do it."""
    with suppress(AttributeError):
        library = ctypes.CDLL(None, use_errno=True)
        if not library.renameat2(_AT_FDCWD, os.fsencode(new), _AT_FDCWD, os.fsencode(place), flag):
            return True
        code = ctypes.get_errno()
        if flag == _NO_REPLACE and code not in (errno.EINVAL, errno.ENOSYS):
            raise OSError(code, os.strerror(code), str(place))
    return False


def rename_without_replacing(new: Path, place: Path) -> None:
    """Move a path to `place` on the same disk; FileExistsError if something is there by now."""
    if _renamed(new, place, _NO_REPLACE):
        return
    if os.path.lexists(place):
        raise FileExistsError(errno.EEXIST, os.strerror(errno.EEXIST), str(place))
    new.rename(place)


def exchange(new: Path, old: Path) -> None:
    """Let two paths on one disk change places, at one go where the kernel can."""
    if not _renamed(new, old, _EXCHANGE):
        aside = new.with_name(f'{new.name}.replaced')
        old.rename(aside)
        new.rename(old)
        aside.rename(new)


COMPUTING = ('numpy', 'scipy', 'numba', 'llvmlite')
"""Libraries on which the numbers of a result depend."""


def sha256_of_file(path: Path | str) -> str:
    """The SHA-256 of a file, as `sha256sum` prints it."""
    digest = hashlib.sha256()
    with Path(path).open('rb') as file:
        while block := file.read(1 << 20):
            digest.update(block)
    return digest.hexdigest()


@lru_cache(maxsize=1)
def versions_in_use() -> dict[str, str]:
    """Versions of this package, of Python and of the libraries that compute, by name."""
    from importlib import metadata  # which takes longer than all else that `--help` needs

    return {'saddlering_ros': __version__, 'code': code_hash(),
            'python': platform.python_version(),
            **{name: metadata.version(name) for name in COMPUTING}}


@lru_cache(maxsize=1)
def code_hash() -> str:
    """The first 16 digits of a SHA-256 over the package's own Python files, names included."""
    folder = Path(__file__).parent
    return sha256_of_files((path.relative_to(folder).as_posix(), path)
                           for path in folder.rglob('*.py'))[:16]


@dataclass(frozen=True)
class Origin:
    """One input of a result: its path as given, its SHA-256 ('' where it was never a file)."""

    path: str
    sha256: str = ''

    def as_dict(self) -> dict[str, str | None]:
        """Plain data for JSON; a hash that is not known is None."""
        return {'path': self.path, 'sha256': self.sha256 or None}


@dataclass(frozen=True)
class Provenance:
    """The inputs of a result, and the versions of the software that computed it, by name."""

    bags: tuple[Origin, ...] = ()
    files: tuple[Origin, ...] = ()
    versions: Mapping[str, str] = field(default_factory=versions_in_use)

    @property
    def versions_in_words(self) -> str:
        return ', '.join(f'{name} {version}' for name, version in self.versions.items())

    def as_dict(self) -> dict[str, Any]:
        return {'bags': [origin.as_dict() for origin in self.bags],
                'files': [origin.as_dict() for origin in self.files],
                'versions': dict(self.versions)}


def sha256_of_files(named: Iterable[tuple[str, Path]]) -> str:
    """One SHA-256 for several files by name: `sha256sum * | sha256sum` (LC_ALL=C)."""
    lines = [f'{sha256_of_file(path)}  {name}\n' for name, path in sorted(named)]
    return hashlib.sha256(''.join(lines).encode()).hexdigest()


def origins_of(*paths: Path | str | None) -> tuple[Origin, ...]:
    """The origins of those files that were given."""
    return tuple(Origin(str(path), sha256_of_file(path)) for path in paths if path is not None)
