"""The output of a command with a result of the API: JSON, or a summary and the written files."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import TYPE_CHECKING

from saddlering_ros.cli._json import tell_json

if TYPE_CHECKING:
    from saddlering_ros.api.results import Result


def finish(args: argparse.Namespace, result: Result, *written: Path | None) -> int:
    """Write or print the requested output; the exit status."""
    if args.json is not None and tell_json(args, result.to_json()):
        return 0
    print(result.summary())
    for path in written:
        if path is not None:
            print(f'written: {path}')
    return 0
