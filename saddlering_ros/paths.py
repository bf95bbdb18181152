"""Places of the files shipped beside the code: config, launch files and bags."""

import os
from pathlib import Path
import sys

from saddlering_ros.errors import SaddleringError

PACKAGE = 'saddlering_ros'


class PathError(SaddleringError):
    """A file shipped with the package is not where an install puts it."""


def share_directory() -> Path:
    """Return the directory that holds config/, launch/ and bags/.

    In order: the source tree this module runs from, every prefix of AMENT_PREFIX_PATH, and the
    prefix of this Python. It raises PathError when none of them holds the package.
    """
    source = Path(__file__).resolve().parent.parent
    if (source / 'package.xml').is_file():
        return source
    prefixes = [*os.environ.get('AMENT_PREFIX_PATH', '').split(os.pathsep), sys.prefix]
    for prefix in filter(None, prefixes):
        share = Path(prefix) / 'share' / PACKAGE
        if (share / 'package.xml').is_file():
            return share
    raise PathError(f'{PACKAGE}: config and bags not found under {sys.prefix}/share; '
                    'source the workspace (install/setup.bash), or install the package again')
