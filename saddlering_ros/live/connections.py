"""Connections of the page's server: a bound on their number, time-outs, and a quiet log.

A connection that has not sent its whole request head gets HEAD_SECONDS. While MAX_WAITING of them
wait, each new one replaces the oldest, so that half-open requests cannot keep a browser out.
"""

from __future__ import annotations

import asyncio
from collections.abc import Callable
import logging
import time
from typing import Any

HEAD_SECONDS = 5.0
MAX_WAITING = 64
MAX_SERVED = 128
MAX_HEAD = 32768
"""Bytes of one request head."""

END_OF_HEAD = b'\r\n\r\n'
LOG_SECONDS = 60.0
LOGGERS = ('aiohttp.server', 'aiohttp.web', 'aiohttp.access', 'asyncio')


class Door:
    """Counts the connections of one server and lets in no more than it can serve."""

    def __init__(self, head_seconds: float = HEAD_SECONDS, max_waiting: int = MAX_WAITING,
                 max_served: int = MAX_SERVED) -> None:
        self.head_seconds, self.max_waiting = head_seconds, max_waiting
        self.max_served = max_served
        self.waiting: dict[Connection, None] = {}
        self.served: set[Connection] = set()
        self.refused = 0

    def enter(self, connection: Connection) -> bool:
        """Let a new connection wait for its request; False if too many are served already."""
        if len(self.served) >= self.max_served:
            self.refused += 1
            return False
        while len(self.waiting) >= self.max_waiting:
            next(iter(self.waiting)).drop()
        self.waiting[connection] = None
        return True

    def leave(self, connection: Connection) -> None:
        """Forget a connection."""
        self.waiting.pop(connection, None)
        self.served.discard(connection)

    def drop(self, connection: Connection) -> None:
        """Forget a connection that is closed for its slowness."""
        self.leave(connection)
        self.refused += 1


class Connection(asyncio.Protocol):
    """One connection in front of the server's own protocol."""

    def __init__(self, inner: Any, door: Door) -> None:
        self._inner, self._door = inner, door
        self._transport: Any = None
        self._timer: asyncio.TimerHandle | None = None
        self._head = 0
        self._tail = b''
        self._is_inside = False

    def connection_made(self, transport: Any) -> None:
        """Wait for the request, or close at once if too many are served."""
        self._transport = transport
        if not self._door.enter(self):
            transport.abort()
            return
        self._is_inside = True
        self._inner.connection_made(transport)
        self._start_timer()

    def data_received(self, data: bytes) -> None:
        """Pass on the received bytes; with a complete head the connection is served."""
        if not self._is_inside:
            return
        self._head += len(data)
        if END_OF_HEAD in self._tail + data:
            self._stop_timer()
            self._door.waiting.pop(self, None)
            self._door.served.add(self)
            self._head = 0
        elif self._timer is None:
            self._start_timer()
        self._tail = (self._tail + data)[-3:]
        if self._head > MAX_HEAD:
            self.drop()
            return
        self._inner.data_received(data)

    def eof_received(self) -> Any:
        """Pass on that the browser sends no more."""
        return self._inner.eof_received() if self._is_inside else None

    def pause_writing(self) -> None:
        """Pass on that the browser takes no more for now."""
        self._inner.pause_writing()

    def resume_writing(self) -> None:
        """Pass on that the browser takes more again."""
        self._inner.resume_writing()

    def connection_lost(self, problem: Exception | None) -> None:
        """Forget the connection."""
        self._stop_timer()
        self._door.leave(self)
        if self._is_inside:
            self._is_inside = False
            self._inner.connection_lost(problem)

    def drop(self) -> None:
        """Close without an answer."""
        self._stop_timer()
        self._door.drop(self)
        if self._transport is not None:
            self._transport.abort()

    def _start_timer(self) -> None:
        loop = asyncio.get_running_loop()
        self._timer = loop.call_later(self._door.head_seconds, self.drop)

    def _stop_timer(self) -> None:
        if self._timer is not None:
            self._timer.cancel()
            self._timer = None


class OneLineAMinute(logging.Filter):
    """Lets one record a minute pass, as one line without a traceback, and counts the others."""

    def __init__(self, clock: Callable[[], float] = time.monotonic) -> None:
        super().__init__()
        self._clock = clock
        self._next = 0.0
        self._hidden = 0

    def filter(self, record: logging.LogRecord) -> bool:
        """Whether this record is printed."""
        now = self._clock()
        if now < self._next:
            self._hidden += 1
            return False
        reason = '' if record.exc_info is None or record.exc_info[1] is None else (
            f' ({type(record.exc_info[1]).__name__})')
        hidden = f'; {self._hidden} more in the last minute' if self._hidden else ''
        record.msg = f'{" ".join(record.getMessage().split())[:200]}{reason}{hidden}'
        record.args, record.exc_info, record.exc_text, record.stack_info = (), None, None, None
        self._next, self._hidden = now + LOG_SECONDS, 0
        return True


def quiet_log() -> Callable[[], None]:
    """Limit the log of the server's libraries to a line a minute; the result ends the limit."""
    only = OneLineAMinute()
    for name in LOGGERS:
        logging.getLogger(name).addFilter(only)

    def end() -> None:
        for name in LOGGERS:
            logging.getLogger(name).removeFilter(only)
    return end
