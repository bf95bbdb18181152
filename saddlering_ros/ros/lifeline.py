"""A pipe by which a node notices that its starter has ended, killed or not."""

from __future__ import annotations

import contextlib
import os
import signal
import threading

LIFELINE = 'SADDLERING_LIFELINE'
"""Environment variable with the number of the pipe's reading end."""

LAST_WORDS = 5.0


def follow_lifeline() -> None:
    """Leave (SIGTERM to oneself, exit a while later) when the pipe's other end closes."""
    number = os.environ.pop(LIFELINE, '')
    if not number.isdigit():
        return

    def watch() -> None:
        with contextlib.suppress(OSError):
            while os.read(int(number), 1):
                pass
        os.kill(os.getpid(), signal.SIGTERM)
        threading.Event().wait(LAST_WORDS)
        os._exit(1)

    threading.Thread(target=watch, name='lifeline', daemon=True).start()
