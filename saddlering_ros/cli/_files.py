"""Refuses outputs that would destroy an input of a command; every command passes here."""

from __future__ import annotations

import argparse
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
import os
from pathlib import Path

from saddlering_ros.spared import (
    BAG_FILES,
    bag_folder,
    FileConflict,
    resolved,
    same_file,
    spare_bags,
    spare_files,
)

BAGS_READ = ('bag', 'bags', 'folder', 'hold_out', 'check')
"""Arguments that name bags."""
FILES_READ = ('rig', 'params', 'identification', 'store', 'manifest', 'effects', 'files', 'map')
"""Arguments that name files that are read."""
WRITTEN = ('out', 'preview', 'drawing', 'json', 'report', 'plots', 'record', 'log', 'draft',
           'propose')
"""Arguments that name an output."""
FOLDERS_FILLED = (('demo', 'out'), ('campaign', 'out'), ('diagnose', 'propose'),
                  ('validate', 'plots'), ('replay', 'log'))
"""Outputs that are folders for files: files that they hold already stay."""
FOLDERS_OF_BAGS = ('demo', 'campaign')
"""Commands that are given a folder with bags below it."""


@dataclass(frozen=True)
class _Named:
    """A path and the argument that named it."""

    path: Path
    words: str


def check_files(args: argparse.Namespace) -> None:
    """FileConflict if an output is an input, lies in a bag that is read, or is given twice."""
    outputs = list(_named(args, WRITTEN))
    for number, output in enumerate(outputs):
        for other in outputs[:number]:
            if same_file(output.path, other.path):
                raise FileConflict(f'{output.words} and {other.words} are the same file: choose '
                                   'two files')
        spare_files(output.path, output.words, _pairs(_named(args, FILES_READ)))
        spare_files(output.path, output.words, _effects_of_environment())
        spare_bags(output.path, output.words, _pairs(_bags(args)))
        if not _is_filled(args, output):
            _check_contains(output, [*_named(args, FILES_READ), *_bags(args)])


def _effects_of_environment() -> Iterator[tuple[Path, str]]:
    """The effect files of the folder that the environment names."""
    if os.environ.get('SADDLERING_EFFECTS'):
        from saddlering_ros.effects import own_files

        yield from ((file, f'{file} (SADDLERING_EFFECTS)') for file in own_files())


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
            if name == 'effects' and path.is_dir():
                yield from (_Named(file, f'--effects {file}') for file in path.glob('*.yaml'))
            option = '' if name in ('bag', 'bags', 'folder') else f'--{name.replace("_", "-")} '
            yield _Named(path, f'{option}{text}')


def _bags(args: argparse.Namespace) -> Iterator[_Named]:
    """Each bag that is read: the folder it is, or the file; for the demo those in the folder."""
    for named in _named(args, BAGS_READ):
        if args.command in FOLDERS_OF_BAGS:
            yield from (_Named(file.parent, str(file.parent))
                        for file in sorted(named.path.rglob(BAG_FILES[0])))
        else:
            yield _Named(bag_folder(named.path), named.words)


def _pairs(named: Iterable[_Named]) -> Iterator[tuple[Path, str]]:
    return ((one.path, one.words) for one in named)


def _is_filled(args: argparse.Namespace, output: _Named) -> bool:
    return any(args.command == command and output.path == Path(getattr(args, name))
               for command, name in FOLDERS_FILLED if getattr(args, name, None) is not None)


def _check_contains(output: _Named, sources: list[_Named]) -> None:
    for source in sources:
        if any(same_file(folder, output.path) for folder in resolved(source.path).parents):
            raise FileConflict(f'{output.words} is the folder that holds {source.words}, which is '
                               'read: choose another place')


def _exists(path: Path) -> bool:
    try:
        return path.exists()
    except OSError:
        return False
