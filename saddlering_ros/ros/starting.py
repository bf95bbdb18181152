"""A node that is stopped while it still imports ends with status 0, without a traceback."""

from __future__ import annotations

import os
from pathlib import Path
import signal
import sys

from saddlering_ros.ros.registry import names, NODES

SIGNALS = (signal.SIGINT, signal.SIGTERM)


def is_node_program() -> bool:
    """Whether this process was started as a node: by its executable, or by `python -m`."""
    modules = {node.module for node in NODES}
    return Path(sys.argv[0]).name in names() or any(word in modules for word in sys.orig_argv)


def end_at_once() -> None:
    """From now on, SIGINT and SIGTERM end the process: no resource is open yet."""
    for number in SIGNALS:
        signal.signal(number, lambda *_: os._exit(0))


def end_as_usual() -> None:
    """From now on, SIGINT and SIGTERM act as in any Python program."""
    signal.signal(signal.SIGINT, signal.default_int_handler)
    signal.signal(signal.SIGTERM, signal.SIG_DFL)
