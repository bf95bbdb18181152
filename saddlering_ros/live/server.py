"""The page's web server: one page, one stream of events, one way to cancel.

Who may look: on the loopback interface any program of this machine; on any other, whoever has the
token. A web site open in the same browser may not: hosts are checked (DNS rebinding), and what
changes something needs a header that no other site can send (cross-site requests).

A connection that has not sent its whole request head gets HEAD_SECONDS. While MAX_WAITING of them
wait, each new one replaces the oldest, so that half-open requests cannot keep a browser out.
"""

import asyncio
from collections.abc import Awaitable, Callable, Mapping
from contextlib import AsyncExitStack, suppress
from dataclasses import dataclass, field
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

from aiohttp import web
from aiohttp.web_protocol import RequestHandler

from saddlering_ros.errors import LiveError
from saddlering_ros.live.commands import ACTIONS, SERVICES
from saddlering_ros.live.watcher import Watcher

PAGE = Path(__file__).parent / 'page'
FILES = {'/': ('page.html', 'text/html'), '/live.js': ('live.js', 'text/javascript'),
         '/plots.js': ('plots.js', 'text/javascript'),
         '/live.css': ('live.css', 'text/css')}
FRESH = {'Cache-Control': 'no-cache'}
PERIOD = 0.25
"""Period at which browsers receive new data [s]."""

COOKIE = 'saddlering_token'
HEADER = 'X-Saddlering'
LOOPBACK = ('localhost', '127.0.0.1', '[::1]')
POLICY = ("default-src 'none'; script-src 'self'; style-src 'self' 'unsafe-inline'; "
          "img-src 'self' data: blob:; connect-src 'self'; base-uri 'none'; form-action 'none'; "
          "frame-ancestors 'none'")

KEEP_ALIVE = 15.0
"""How long a connection may idle between two requests [s]."""

Handler = Callable[[web.Request], Awaitable[web.StreamResponse]]


@dataclass(frozen=True)
class Address:
    """Where the page is served; beyond the loopback interface a token is made if none is given."""

    host: str = '127.0.0.1'
    port: int = 8765
    token: str = ''

    def __post_init__(self) -> None:
        if not (self.token or self.is_loopback):
            object.__setattr__(self, 'token', secrets.token_urlsafe(18))

    @property
    def is_loopback(self) -> bool:
        """Whether only programs of this machine can reach it."""
        try:
            return self.host == 'localhost' or ipaddress.ip_address(self.host).is_loopback
        except ValueError:
            return False

    @property
    def url(self) -> str:
        host = f'[{self.host}]' if ':' in self.host else self.host
        return f'http://{host}:{self.port}/' + (f'?token={self.token}' if self.token else '')


def application(watcher: Watcher, where: Address) -> web.Application:
    """The web application."""
    from saddlering_ros.rig.drawing import drawing_svg

    app = web.Application(middlewares=[web.middleware(partial(_guard, where))])
    for path, (name, kind) in FILES.items():
        app.router.add_get(path, partial(_content, (PAGE / name).read_bytes, kind, FRESH))
    app.router.add_get('/plotly.js', partial(_content, _zipped_library, 'text/javascript', {
        'Content-Encoding': 'gzip', 'Cache-Control': 'max-age=86400'}))
    app.router.add_get('/rig.svg', partial(
        _content, lambda: drawing_svg(watcher.rig).encode(), 'image/svg+xml', FRESH))
    app.router.add_get('/events', partial(_events, watcher, secrets.token_hex(4)))
    app.router.add_get(r'/tests/{number:\d{1,9}}', partial(_test, watcher))
    app.router.add_get(r'/bags/{number:\d{1,9}}', partial(_bag, watcher))
    app.router.add_post(f'/cancel/{{action:{"|".join(ACTIONS)}}}', partial(
        _command, lambda request: watcher.actions[request.match_info['action']].cancel()))
    app.router.add_post('/clear', partial(_command, lambda request: watcher.clear()))
    for name in SERVICES:
        app.router.add_post(f'/{name}', partial(
            _command, lambda request: watcher.commands.ask(request.path[1:])))
    return app


def serve(watcher: Watcher, where: Address, on_ready: Callable[[Address], None],
          until: threading.Event | None = None) -> None:
    """Serve until interrupted, or until the event is set; LiveError if it cannot be served.

    Port 0 takes a free one; `on_ready` is called with the address.
    """
    async def run() -> None:
        runner = web.AppRunner(application(watcher, where), access_log=None, shutdown_timeout=0.5)
        async with AsyncExitStack() as stack:
            stack.push_async_callback(runner.cleanup)
            await runner.setup()
            assert runner.server is not None
            try:
                server = await asyncio.get_running_loop().create_server(
                    partial(Connection, runner.server, Door()), where.host, where.port,
                    backlog=256)
            except OSError as problem:
                raise LiveError(f'{where.host}:{where.port}: cannot be served '
                                f'({problem.strerror}): choose another --host or --port'
                                ) from problem
            stack.callback(server.close)
            on_ready(Address(where.host, server.sockets[0].getsockname()[1], where.token))
            while until is None or not until.is_set():
                await asyncio.sleep(0.2)

    only = OneLineAMinute()
    for name in LOGGERS:
        logging.getLogger(name).addFilter(only)
    try:
        asyncio.run(run())
    finally:
        for name in LOGGERS:
            logging.getLogger(name).removeFilter(only)


async def _guard(where: Address, request: web.Request, handler: Handler) -> web.StreamResponse:
    """Middleware: tells who may look, and keeps other sites from commands."""
    token = where.token.encode()
    host = re.fullmatch(r'(\[[0-9A-Fa-f:.]+\]|[\w.-]+)(:\d+)?', request.host)
    if where.is_loopback and (host is None or host[1] not in (*LOOPBACK, where.host)):
        raise web.HTTPForbidden(text='this page answers to localhost only\n')
    if token:
        if hmac.compare_digest(request.query.get('token', '').encode(), token):
            answer = web.HTTPFound(request.path)
            answer.set_cookie(COOKIE, where.token, httponly=True, samesite='Strict')
            raise answer
        if not hmac.compare_digest(request.cookies.get(COOKIE, '').encode(), token):
            raise web.HTTPForbidden(text='open the address with the token that saddlering live '
                                         'printed\n')
    if request.method == 'POST' and HEADER not in request.headers:
        raise web.HTTPForbidden(text=f'the header {HEADER} is missing\n')
    response = await handler(request)
    if not response.prepared:
        response.headers.update({
            'Content-Security-Policy': POLICY, 'X-Content-Type-Options': 'nosniff',
            'Referrer-Policy': 'no-referrer'})
    return response


async def _content(make: Callable[[], bytes], kind: str, headers: Mapping[str, str],
                   request: web.Request) -> web.Response:
    data = await asyncio.get_running_loop().run_in_executor(None, make)
    return web.Response(body=data, content_type=kind, charset='utf-8', headers=headers)


@lru_cache(maxsize=1)
def _zipped_library() -> bytes:
    from plotly.offline import get_plotlyjs

    return gzip.compress(get_plotlyjs().encode(), 6)


async def _events(watcher: Watcher, boot: str, request: web.Request) -> web.StreamResponse:
    """Server-sent events: `state` and `now` when they change, `rows` when there are new ones.

    Data that a slow browser has not taken are never queued: the next event holds all new data.
    """
    response = web.StreamResponse(headers={
        'Content-Type': 'text/event-stream', 'Cache-Control': 'no-store'})
    await response.prepare(request)
    said, version, turn, silent = {'state': '', 'now': ''}, -1, -1, 0
    await response.write(b'retry: 1000\n\n')
    with suppress(ConnectionError):  # the browser has left
        while True:
            events = {'state': json.dumps(watcher.state()), 'now': json.dumps(watcher.now())}
            events = {event: data for event, data in events.items() if data != said[event]}
            said |= events
            rows = watcher.rows(version, turn)
            if rows is not None:
                version, turn = rows['version'], rows['turn']
                events['rows'] = json.dumps({'boot': boot, **rows})
            for event, data in events.items():
                await response.write(f'event: {event}\ndata: {data}\n\n'.encode())
            silent = 0 if rows is not None else silent + 1
            if silent % 20 == 19:
                await response.write(b': still here\n\n')
            await asyncio.sleep(PERIOD)
    return response


async def _test(watcher: Watcher, request: web.Request) -> web.Response:
    curves = watcher.test(int(request.match_info['number']))
    if curves is None:
        raise web.HTTPNotFound(text='this test is no longer kept\n')
    return web.json_response(curves)


async def _bag(watcher: Watcher, request: web.Request) -> web.Response:
    number = int(request.match_info['number'])
    try:
        data = await asyncio.get_running_loop().run_in_executor(None, watcher.bag, number)
    except LiveError as problem:
        raise web.HTTPGone(text=f'{problem}\n') from problem
    if data is None:
        raise web.HTTPNotFound(text='this test is no longer kept\n')
    return web.Response(body=data, content_type='application/octet-stream', headers={
        'Content-Disposition': f'attachment; filename="test_{number}.mcap"'})


async def _command(act: Callable[[web.Request], bool | None],
                   request: web.Request) -> web.Response:
    return web.json_response({'asked': act(request)})


HEAD_SECONDS = 5.0
MAX_WAITING = 64
MAX_SERVED = 128
"""A head comes at once; 192 connections stay far below the usual 1 024 open files of a process."""
MAX_HEAD = 32768
"""Bytes of one request head."""

END_OF_HEAD = b'\r\n\r\n'
LOG_SECONDS = 60.0
"""Between two lines on failures [s]: a client that fails at every request fills no disk."""
LOGGERS = ('aiohttp.server', 'aiohttp.web', 'aiohttp.access', 'asyncio')


@dataclass
class Door:
    """The connections of one server: those that wait for their request, and those served."""

    head_seconds: float = HEAD_SECONDS
    max_waiting: int = MAX_WAITING
    max_served: int = MAX_SERVED
    waiting: dict['Connection', None] = field(default_factory=dict)
    served: set['Connection'] = field(default_factory=set)


class Connection(RequestHandler):
    """A connection of the server that is closed if the head of its request takes too long."""

    def __init__(self, server: web.Server, door: Door) -> None:
        loop = asyncio.get_running_loop()
        super().__init__(server, loop=loop, keepalive_timeout=KEEP_ALIVE, lingering_time=0.0)
        self._call_later, self._door = loop.call_later, door
        self._timer: asyncio.TimerHandle | None = None
        self._head = 0
        self._tail = b''

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        """Wait for the request in place of the oldest; close at once if too many are served."""
        super().connection_made(transport)
        if len(self._door.served) >= self._door.max_served:
            self.drop()
            return
        while len(self._door.waiting) >= self._door.max_waiting:
            next(iter(self._door.waiting)).drop()
        self._door.waiting[self] = None
        self._timer = self._call_later(self._door.head_seconds, self.drop)

    def data_received(self, data: bytes) -> None:
        """Pass on the received bytes; with a complete head the connection is served."""
        self._head += len(data)
        if END_OF_HEAD in self._tail + data:
            self._leave()
            self._door.served.add(self)
            self._head = 0
        elif self._timer is None:
            self._timer = self._call_later(self._door.head_seconds, self.drop)
        self._tail = (self._tail + data)[-3:]
        if self._head > MAX_HEAD:
            self.drop()
        else:
            super().data_received(data)

    def connection_lost(self, exc: BaseException | None) -> None:
        self._leave()
        super().connection_lost(exc)

    def drop(self) -> None:
        self._leave()
        if self.transport is not None:
            self.transport.abort()

    def _leave(self) -> None:
        self._door.waiting.pop(self, None)
        self._door.served.discard(self)
        if self._timer is not None:
            self._timer.cancel()
            self._timer = None


class OneLineAMinute(logging.Filter):
    """Lets one record a minute pass, as one line without a traceback, and counts the others."""

    def __init__(self) -> None:
        super().__init__()
        self._next = 0.0
        self._hidden = 0

    def filter(self, record: logging.LogRecord) -> bool:
        if record.created < self._next:
            self._hidden += 1
            return False
        reason = '' if record.exc_info is None or record.exc_info[1] is None else (
            f' ({type(record.exc_info[1]).__name__})')
        hidden = f'; {self._hidden} more in the last minute' if self._hidden else ''
        record.msg = f'{" ".join(record.getMessage().split())[:200]}{reason}{hidden}'
        record.args, record.exc_info, record.exc_text, record.stack_info = (), None, None, None
        self._next, self._hidden = record.created + LOG_SECONDS, 0
        return True
