"""Folders that hold all files of goals and services; links and `..` do not lead out of them."""

from __future__ import annotations

from pathlib import Path
from typing import Protocol

from saddlering_ros.ros.errors import NodeError
from saddlering_ros.ros.parameters import NodeSettings


class WithSettings(Protocol):
    """A node whose parameters were declared."""

    settings: NodeSettings

    def get_name(self) -> str:
        """The node's name."""


def root_folder(node: WithSettings, parameter: str, default: Path) -> Path:
    """The folder a parameter names, or `default`; NodeError if it is not there."""
    given = node.settings.text(parameter)
    root = Path(given).expanduser() if given else default
    if given and not root.is_dir():
        raise NodeError(f'{node.get_name()}: parameter {parameter} is {given}: '
                        'give a folder that exists')
    return root.resolve()


MAX_SHOWN = 200
"""Characters of a name that an error repeats."""


def below(root: Path, name: str, what: str) -> Path:
    """The file or folder `name` (relative to `root`, or absolute), which must lie below `root`.

    Links and `..` are resolved first. NodeError with one line if it does not, or is not there.
    """
    path = Path(name)
    try:
        real = (path if path.is_absolute() else root / path).resolve()
        is_there = real.exists()
    except (OSError, RuntimeError, ValueError) as problem:
        raise NodeError(
            f'{what} {name[:MAX_SHOWN]!r}: cannot be resolved: give a path below {root}'
        ) from problem
    if not name or not real.is_relative_to(root):
        parameter = 'bag_root' if what == 'bag' else 'parameters_root'
        raise NodeError(f'{what} {name!r} is not below {root}: put it there, or set the '
                        f"node's parameter {parameter}")
    if not is_there:
        raise NodeError(f'{what} {name!r} is not in {root}: check the name')
    return real


def bag_below(root: Path, name: str) -> Path:
    """A bag below `root` none of whose files is a link to somewhere else."""
    path = below(root, name, 'bag')
    inside = sorted(path.iterdir()) if path.is_dir() else [path]
    for file in inside:
        if not file.resolve().is_relative_to(root):
            raise NodeError(f'bag {name!r} holds {file.name}, a link to outside {root}: '
                            'copy the file there')
    return path
