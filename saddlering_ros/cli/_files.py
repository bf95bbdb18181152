"""Refuses outputs that would destroy what a command reads; every command passes through here."""

from __future__ import annotations

import argparse
from collections.abc import Iterator
from dataclasses import dataclass
import os
from pathlib import Path

from saddlering_ros.errors import SaddleringError

BAGS_READ = ('bag', 'bags', 'folder', 'hold_out', 'check')
"""Arguments that name bags."""
FILES_READ = ('rig', 'params', 'identification', 'store', 'manifest', 'effects', 'files', 'map')
"""Arguments that name files that are read."""
WRITTEN = ('out', 'preview', 'drawing', 'json', 'report', 'plots', 'record', 'log', 'draft',
           'propose')
"""Arguments that name what is written."""
FOLDERS_FILLED = (('demo', 'out'), ('campaign', 'out'), ('diagnose', 'propose'),
                  ('validate', 'plots'), ('replay', 'log'))
"""Outputs that are folders to put files into: what is in them already stays."""
FOLDERS_OF_BAGS = ('demo', 'campaign')
"""Commands that are given a folder with bags below it."""
BAG_FILES = ('metadata.yaml', '*.mcap', '*.mcap.zstd')


class FileConflict(SaddleringError):
    """An output would replace something that the same command reads or writes."""


@dataclass(frozen=True)
class _Named:
    """A path and the argument that named it."""

    path: Path
    words: str


def check_files(args: argparse.Namespace) -> None:
    """Raise FileConflict if an output is an input, lies in a bag that is read, or stands twice."""
    outputs = list(_named(args, WRITTEN))
    for number, output in enumerate(outputs):
        for other in outputs[:number]:
            if _same(output.path, other.path):
                raise FileConflict(f'{output.words} and {other.words} are the same file: choose '
                                   'two files')
        for source in _named(args, FILES_READ):
            _check_against_file(output, source)
        for bag in _bags(args):
            _check_against_bag(output, bag)
        if not _is_filled(args, output):
            _check_contains(output, [*_named(args, FILES_READ), *_bags(args)])


def _named(args: argparse.Namespace, names: tuple[str, ...]) -> Iterator[_Named]:
    """Each path of these arguments; '-' and devices are no files to lose."""
    for name in names:
        value = getattr(args, name, None)
        for text in value if isinstance(value, list) else [value]:
            if not isinstance(text, (str, Path)) or str(text) == '-':
                continue
            path = Path(text)
            if _exists(path) and not (path.is_file() or path.is_dir()):
                continue
            option = '' if name in ('bag', 'bags', 'folder') else f'--{name.replace("_", "-")} '
            yield _Named(path, f'{option}{text}')


def _bags(args: argparse.Namespace) -> Iterator[_Named]:
    """Each bag that is read: the folder it is, or the file; for the demo those in the folder."""
    for named in _named(args, BAGS_READ):
        if args.command in FOLDERS_OF_BAGS:
            yield from (_Named(file.parent, str(file.parent))
                        for file in sorted(named.path.rglob(BAG_FILES[0])))
        elif named.path.is_file() and _is_bag(named.path.resolve().parent):
            yield _Named(named.path.resolve().parent, named.words)
        else:
            yield named


def _is_bag(folder: Path) -> bool:
    return (folder / BAG_FILES[0]).exists()


def _is_filled(args: argparse.Namespace, output: _Named) -> bool:
    return any(args.command == command and output.path == Path(getattr(args, name))
               for command, name in FOLDERS_FILLED if getattr(args, name, None) is not None)


def _check_against_file(output: _Named, source: _Named) -> None:
    if _same(output.path, source.path):
        raise FileConflict(f'{output.words} is the file that is read as {source.words}: '
                           'choose another name for the output')


def _check_against_bag(output: _Named, bag: _Named) -> None:
    place = _resolved(output.path)
    inside = any(_same(folder, bag.path) for folder in (place, *place.parents))
    linked = output.path.is_file() and bag.path.is_dir() and any(
        _same(output.path, file) for pattern in BAG_FILES for file in bag.path.glob(pattern))
    if inside or linked:
        raise FileConflict(f'{output.words} is part of the bag {bag.words} that is read: '
                           'choose a place outside the bag')


def _check_contains(output: _Named, sources: list[_Named]) -> None:
    for source in sources:
        if any(_same(folder, output.path) for folder in _resolved(source.path).parents):
            raise FileConflict(f'{output.words} is the folder that holds {source.words}, which is '
                               'read: choose another place')


def _same(first: Path, second: Path) -> bool:
    """Whether two paths are one file or folder, by any link; of those not there yet, by name."""
    try:
        return os.path.samefile(first, second)
    except OSError:
        return _resolved(first) == _resolved(second)


def _resolved(path: Path) -> Path:
    try:
        return path.resolve()
    except (OSError, RuntimeError):  # a loop of links, or a name that no system takes
        return Path(os.path.abspath(path))


def _exists(path: Path) -> bool:
    try:
        return path.exists()
    except OSError:
        return False
