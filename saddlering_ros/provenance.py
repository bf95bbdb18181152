"""The provenance of a result: hashes of its bags and files, and versions of the program."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from functools import lru_cache
import hashlib
from pathlib import Path
import platform
from typing import Any

from saddlering_ros import __version__

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

    found = {'saddlering_ros': __version__, 'code': code_hash(),
             'python': platform.python_version()}
    for name in COMPUTING:
        try:
            found[name] = metadata.version(name)
        except metadata.PackageNotFoundError:
            continue  # a library an environment does without
    return found


@lru_cache(maxsize=1)
def code_hash() -> str:
    """The first 16 digits of a SHA-256 over the package's own Python files, names included."""
    folder = Path(__file__).parent
    digest = hashlib.sha256()
    for path in sorted(folder.rglob('*.py')):
        name = path.relative_to(folder).as_posix()
        digest.update(f'{sha256_of_file(path)}  {name}\n'.encode())
    return digest.hexdigest()[:16]


@dataclass(frozen=True)
class Origin:
    """One input of a result: its path as given, its SHA-256 ('' where it was never a file)."""

    path: str
    sha256: str = ''


@dataclass(frozen=True)
class Provenance:
    """The inputs of a result, and the versions of the software that computed it, by name."""

    bags: tuple[Origin, ...] = ()
    files: tuple[Origin, ...] = ()
    versions: Mapping[str, str] = field(default_factory=versions_in_use)

    @property
    def versions_in_words(self) -> str:
        """The versions on one line."""
        return ', '.join(f'{name} {version}' for name, version in self.versions.items())

    def as_dict(self) -> dict[str, Any]:
        """Plain data for JSON; a hash that is not known is None."""
        return {
            'bags': [_plain(origin) for origin in self.bags],
            'files': [_plain(origin) for origin in self.files],
            'versions': dict(self.versions),
        }


def sha256_of_files(paths: Iterable[Path]) -> str:
    """One SHA-256 for several files of a folder: `sha256sum * | sha256sum` there (LC_ALL=C)."""
    ordered = sorted(paths, key=lambda path: path.name)
    lines = [f'{sha256_of_file(path)}  {path.name}\n' for path in ordered]
    return hashlib.sha256(''.join(lines).encode()).hexdigest()


def files(*paths: Path | str | None) -> tuple[Origin, ...]:
    """The origins of those files that were given."""
    return tuple(Origin(str(path), sha256_of_file(path)) for path in paths if path is not None)


def add_origins(document: dict[str, Any], origins: Iterable[Origin]) -> dict[str, Any]:
    """`document`, a result's JSON, with these files added to its provenance."""
    document['provenance']['files'] += [_plain(origin) for origin in origins]
    return document


def _plain(origin: Origin) -> dict[str, str | None]:
    return {'path': origin.path, 'sha256': origin.sha256 or None}
