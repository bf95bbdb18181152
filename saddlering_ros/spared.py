"""Refuses an output that would replace an input of its result."""

from __future__ import annotations

from collections.abc import Iterable
import os
from pathlib import Path

from saddlering_ros.errors import SaddleringError

BAG_FILES = ('metadata.yaml', '*.mcap', '*.mcap.zstd')


class FileConflict(SaddleringError):
    """An output would replace something that is read, or another output."""


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
