"""Signals that end a command: as an exception, at a moment when Python can take one.

Compiled code calls back into Python (to rebuild an object, to find an argument's type) and does
not check whether that raised: an exception there ends in a segmentation fault. There the signal is
put off by some milliseconds.
"""

from __future__ import annotations

import os
import signal
from types import FrameType

ENDING = ('SIGTERM', 'SIGHUP')
RETRY = 0.01
"""Seconds after which a signal that came at a bad moment is taken up again."""

CALLED_BACK = frozenset({'_numba_unpickle', 'typeof_pyval'})
"""Functions of numba that compiled code calls."""

_COMPILER = f'{os.sep}numba{os.sep}'


def leave_by_exception() -> None:
    """End the process by an exception, so that everything open is closed, and children end."""
    for name in ENDING:
        signal.signal(getattr(signal, name), _leave)
    if signal.getsignal(signal.SIGINT) is signal.default_int_handler:
        signal.signal(signal.SIGINT, _leave)


def _leave(number: int, frame: FrameType | None) -> None:
    if _is_called_back(frame):
        signal.signal(signal.SIGALRM, lambda _, later: _leave(number, later))
        signal.setitimer(signal.ITIMER_REAL, RETRY)
        return
    if number == signal.SIGINT:
        raise KeyboardInterrupt
    raise SystemExit(128 + number)


def _is_called_back(frame: FrameType | None) -> bool:
    """Whether compiled code waits for one of the frames to return."""
    while frame is not None:
        code = frame.f_code
        if code.co_name in CALLED_BACK and _COMPILER in code.co_filename:
            return True
        frame = frame.f_back
    return False
