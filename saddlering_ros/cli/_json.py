"""Output of `--json`: the figures of a command as one document."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any


def tell_json(args: argparse.Namespace, told: Any) -> bool:
    """Write `told` to the place of --json, if given; whether this is standard output."""
    import json

    from saddlering_ros.rig import write_text_atomically

    if args.json is None:
        return False
    document = json.dumps(told, indent=2)
    if args.json == '-':
        print(document, flush=True)  # some commands run for hours
        return True
    write_text_atomically(Path(args.json), document + '\n')
    return False
