"""The executables: one module per node, thin over `record`, `jobs` and `ros`."""

import os
import signal
import sys

from saddlering_ros.ros.names import names, NODES, SIGNALS


def end_at_once() -> None:
    """From now on, SIGINT and SIGTERM end the process: no resource is open yet."""
    for number in SIGNALS:
        signal.signal(number, lambda *_: os._exit(0))


if os.path.basename(sys.argv[0]) in names() or {node.module for node in NODES} & {*sys.orig_argv}:
    end_at_once()  # as a node, by its executable or by `python -m`
    from saddlering_ros.ros.launcher import check_ros
    check_ros()
