"""The page's web server: one page, one stream of events, one way to cancel.

Who may look: on the loopback interface any program of this machine; on any other, whoever has the
token. A web site open in the same browser may not: hosts are checked (DNS rebinding), and what
changes something needs a header that no other site can send (cross-site requests).

A connection that has not sent its whole request head gets HEAD_SECONDS. While MAX_WAITING of them
wait, each new one replaces the oldest, so that half-open requests cannot keep a browser out.
"""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Callable
from contextlib import suppress
from dataclasses import dataclass
from functools import lru_cache, partial
import gzip
import hmac
import ipaddress
import json
import logging
from pathlib import Path
import re
import secrets
import threading
import time
from typing import Any

from aiohttp import web

from saddlering_ros.errors import LiveError
from saddlering_ros.live.commands import ACTIONS
from saddlering_ros.live.watcher import Watcher
from saddlering_ros.rig import default_rig, Rig

PAGE = Path(__file__).parent / 'page'
FILES = {'/': ('page.html', 'text/html'), '/live.js': ('live.js', 'text/javascript'),
         '/plots.js': ('plots.js', 'text/javascript'),
         '/live.css': ('live.css', 'text/css')}
PERIOD = 0.25
"""Period at which browsers receive new data [s]."""

COOKIE = 'saddlering_token'
HEADER = 'X-Saddlering'
LOOPBACK = ('localhost', '127.0.0.1', '[::1]')
POLICY = ("default-src 'none'; script-src 'self'; style-src 'self' 'unsafe-inline'; "
          "img-src 'self' data: blob:; connect-src 'self'; base-uri 'none'; form-action 'none'; "
          "frame-ancestors 'none'")

COMMANDS = ('zero', 'start', 'pause')
KEEP_ALIVE = 15.0
"""How long a connection may idle between two requests [s]."""

Handler = Callable[[web.Request], Awaitable[web.StreamResponse]]


@dataclass(frozen=True)
class Address:
    """Where the page is served; a token is needed beyond the loopback interface."""

    host: str = '127.0.0.1'
    port: int = 8765
    token: str = ''

    @property
    def is_loopback(self) -> bool:
        """Whether only programs of this machine can reach it."""
        try:
            return self.host == 'localhost' or ipaddress.ip_address(self.host).is_loopback
        except ValueError:
            return False

    @property
    def url(self) -> str:
        """The address to open in the browser."""
        host = f'[{self.host}]' if ':' in self.host else self.host
        return f'http://{host}:{self.port}/' + (f'?token={self.token}' if self.token else '')


def address(host: str, port: int, token: str = '') -> Address:
    """The address asked for, with a token made where one is needed and none is given."""
    found = Address(host, port, token)
    return found if token or found.is_loopback else Address(host, port, secrets.token_urlsafe(18))


def application(watcher: Watcher, where: Address, rig: Rig | None = None) -> web.Application:
    """The web application; `rig` (default: the shipped one) is the ring that it draws."""
    app = web.Application(middlewares=[_guard(where)])
    for path, (name, kind) in FILES.items():
        app.router.add_get(path, partial(_file, (PAGE / name).read_bytes(), kind))
    app.router.add_get('/plotly.js', _library)
    app.router.add_get('/rig.svg', partial(_drawing, rig or default_rig()))
    app.router.add_get('/events', partial(_events, watcher, secrets.token_hex(4)))
    app.router.add_get(r'/tests/{number:\d{1,9}}', partial(_test, watcher))
    app.router.add_get(r'/bags/{number:\d{1,9}}', partial(_bag, watcher))
    app.router.add_post('/cancel/{action}', partial(_cancel, watcher))
    app.router.add_post('/clear', partial(_clear, watcher))
    for command in COMMANDS:
        app.router.add_post(f'/{command}', partial(_ask, watcher, command))
    return app


def serve(watcher: Watcher, where: Address, on_ready: Callable[[Address], None],
          until: threading.Event | None = None, rig: Rig | None = None) -> None:
    """Serve until interrupted, or until the event is set; LiveError if it cannot be served.

    Port 0 takes a free one; `on_ready` is called with the address.
    """
    asyncio.run(_serve(watcher, where, on_ready, until, rig))


async def _serve(watcher: Watcher, where: Address, on_ready: Callable[[Address], None],
                 until: threading.Event | None, rig: Rig | None) -> None:
    runner = web.AppRunner(application(watcher, where, rig), access_log=None, shutdown_timeout=0.5,
                           keepalive_timeout=KEEP_ALIVE, lingering_time=0.0)
    loud_again = quiet_log()
    await runner.setup()
    door = Door()
    server: asyncio.Server | None = None
    try:
        try:
            server = await asyncio.get_running_loop().create_server(
                lambda: Connection(_protocol(runner), door), where.host, where.port, backlog=256)
        except OSError as problem:
            raise LiveError(f'{where.host}:{where.port}: cannot be served ({problem.strerror}): '
                            'choose another --host or --port') from problem
        on_ready(Address(where.host, server.sockets[0].getsockname()[1], where.token))
        while until is None or not until.is_set():
            await asyncio.sleep(0.2)
    finally:
        if server is not None:
            server.close()
        await runner.cleanup()
        loud_again()


def _protocol(runner: web.AppRunner) -> Any:
    """The HTTP protocol of one connection."""
    assert runner.server is not None
    return runner.server()


def _guard(where: Address) -> Any:
    """Middleware that lets in whom the module's first lines name, and keeps the page to itself."""

    @web.middleware
    async def guard(request: web.Request, handler: Handler) -> web.StreamResponse:
        if where.is_loopback and _name_of(request.host) not in LOOPBACK:
            raise web.HTTPForbidden(text='this page answers to localhost only\n')
        if where.token:
            if _same(request.query.get('token', ''), where.token):
                answer = web.HTTPFound(request.path)
                answer.set_cookie(COOKIE, where.token, httponly=True, samesite='Strict')
                raise answer
            if not _same(request.cookies.get(COOKIE, ''), where.token):
                raise web.HTTPForbidden(text='open the address with the token that saddlering '
                                             'live printed\n')
        if request.method == 'POST' and HEADER not in request.headers:
            raise web.HTTPForbidden(text=f'the header {HEADER} is missing\n')
        response = await handler(request)
        if not response.prepared:
            response.headers.update({
                'Content-Security-Policy': POLICY, 'X-Content-Type-Options': 'nosniff',
                'Referrer-Policy': 'no-referrer'})
        return response

    return guard


def _same(given: str, token: str) -> bool:
    return hmac.compare_digest(given.encode(), token.encode())


def _name_of(host: str) -> str:
    """The name of a Host header, with or without a port; '' for another form."""
    found = re.fullmatch(r'(\[[0-9A-Fa-f:.]+\]|[\w.-]+)(:\d+)?', host)
    return found[1] if found else ''


async def _file(data: bytes, kind: str, request: web.Request) -> web.Response:
    return web.Response(body=data, content_type=kind, charset='utf-8',
                        headers={'Cache-Control': 'no-cache'})


async def _library(request: web.Request) -> web.Response:
    data = await asyncio.get_running_loop().run_in_executor(None, _zipped_library)
    return web.Response(body=data, content_type='text/javascript', charset='utf-8',
                        headers={'Content-Encoding': 'gzip', 'Cache-Control': 'max-age=86400'})


@lru_cache(maxsize=1)
def _zipped_library() -> bytes:
    from plotly.offline import get_plotlyjs

    return gzip.compress(get_plotlyjs().encode(), 6)


async def _drawing(rig: Rig, request: web.Request) -> web.Response:
    text = await asyncio.get_running_loop().run_in_executor(None, _drawn, rig)
    return web.Response(text=text, content_type='image/svg+xml', charset='utf-8',
                        headers={'Cache-Control': 'no-cache'})


def _drawn(rig: Rig) -> str:
    from saddlering_ros.rig.drawing import drawing_svg

    return drawing_svg(rig)


async def _events(watcher: Watcher, boot: str, request: web.Request) -> web.StreamResponse:
    """Server-sent events: `state` and `now` when they change, `rows` when there are new ones.

    Data that a slow browser has not taken are never queued: the next event holds all new data.
    """
    response = web.StreamResponse(headers={
        'Content-Type': 'text/event-stream', 'Cache-Control': 'no-store'})
    await response.prepare(request)
    said, shown, version, turn, silent = '', '', -1, -1, 0
    await response.write(b'retry: 1000\n\n')
    with suppress(ConnectionError):  # the browser has left
        while True:
            state = json.dumps(watcher.state())
            if state != said:
                said = state
                await _send(response, 'state', state)
            now = json.dumps(watcher.now())
            if now != shown:
                shown = now
                await _send(response, 'now', now)
            rows = watcher.rows(version, turn)
            if rows is not None:
                version, turn = rows['version'], rows['turn']
                await _send(response, 'rows', json.dumps({'boot': boot, **rows}))
            silent = 0 if rows is not None else silent + 1
            if silent % 20 == 19:
                await response.write(b': still here\n\n')
            await asyncio.sleep(PERIOD)
    return response


async def _send(response: web.StreamResponse, event: str, data: str) -> None:
    await response.write(f'event: {event}\ndata: {data}\n\n'.encode())


async def _test(watcher: Watcher, request: web.Request) -> web.Response:
    found = watcher.test(int(request.match_info['number']))
    if found is None:
        raise web.HTTPNotFound(text='this test is no longer kept\n')
    return web.json_response(found)


async def _bag(watcher: Watcher, request: web.Request) -> web.Response:
    """The messages of a test to save."""
    number = int(request.match_info['number'])
    try:
        data = await asyncio.get_running_loop().run_in_executor(None, watcher.bag, number)
    except LiveError as problem:
        raise web.HTTPGone(text=f'{problem}\n') from problem
    if data is None:
        raise web.HTTPNotFound(text='this test is no longer kept\n')
    return web.Response(body=data, content_type='application/octet-stream', headers={
        'Content-Disposition': f'attachment; filename="test_{number}.mcap"'})


async def _cancel(watcher: Watcher, request: web.Request) -> web.Response:
    action = request.match_info['action']
    if action not in ACTIONS:
        raise web.HTTPNotFound
    return web.json_response({'asked': watcher.cancel(action)})


async def _ask(watcher: Watcher, command: str, request: web.Request) -> web.Response:
    return web.json_response({'asked': watcher.ask(command)})


async def _clear(watcher: Watcher, request: web.Request) -> web.Response:
    watcher.clear()
    return web.json_response({})


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
