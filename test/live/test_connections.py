"""Claims about half-open requests: they are closed, bounded, and keep no browser out."""

import contextlib
from functools import partial
import logging
import socket
import time
from types import SimpleNamespace
import urllib.request

import pytest
from served_page import served_page

from saddlering_ros.live import server
from saddlering_ros.live.server import OneLineAMinute

HALF = b'GET / HTTP/1.1\r\nHost: localhost\r\n'


@contextlib.contextmanager
def served():
    """The port of a page with nothing behind it."""
    watcher = SimpleNamespace(state=dict, now=dict, rows=lambda version, turn: None)
    with served_page(watcher) as where:
        yield where.port


def half_open(stack, port):
    """A connection that has sent half of its request."""
    one = stack.enter_context(socket.create_connection(('127.0.0.1', port), 60.0))
    one.sendall(HALF)
    return one


def is_closed(one, seconds):
    one.settimeout(seconds)
    try:
        return one.recv(1) == b''
    except ConnectionError:
        return True
    except TimeoutError:
        return False


def test_a_browser_is_served_at_once_beside_three_hundred_half_open_requests(monkeypatch):
    monkeypatch.setattr(server, 'Door', partial(server.Door, 600.0, 64, 128))
    with served() as port, contextlib.ExitStack() as stack:
        opened = [half_open(stack, port) for _ in range(300)]
        with urllib.request.urlopen(f'http://127.0.0.1:{port}/', timeout=60.0) as page:
            assert b'<html' in page.read()
        assert all(is_closed(one, 60.0) for one in opened[:300 - server.MAX_WAITING])


def test_requests_whose_bodies_do_not_come_keep_no_browser_out():
    head = b'POST /clear HTTP/1.1\r\nHost: localhost\r\nContent-Length: 1000000\r\n\r\n'
    with served() as port, contextlib.ExitStack() as stack:
        for _ in range(server.MAX_SERVED + 20):
            one = stack.enter_context(socket.create_connection(('127.0.0.1', port), 60.0))
            one.sendall(head)
            assert one.recv(8) == b'HTTP/1.1'
            while one.recv(4096):  # the end of the answer is the end of the connection
                pass


def test_a_half_open_request_is_closed_after_its_time(monkeypatch):
    monkeypatch.setattr(server, 'Door', partial(server.Door, 0.2, 64, 128))
    with served() as port, contextlib.ExitStack() as stack:
        assert is_closed(half_open(stack, port), 60.0)


def test_a_stream_of_events_stays_open_beyond_the_time_for_a_head(monkeypatch):
    monkeypatch.setattr(server, 'Door', partial(server.Door, 1.0, 64, 128))
    with served() as port, contextlib.ExitStack() as stack:
        one = half_open(stack, port)
        one.sendall(b'X: y\r\n\r\n')
        assert b'200 OK' in one.recv(100)
        events = stack.enter_context(socket.create_connection(('127.0.0.1', port), 60.0))
        events.sendall(HALF.replace(b'GET /', b'GET /events') + b'\r\n')
        time.sleep(1.2)
        assert b'200 OK' in events.recv(4096)
        assert not is_closed(events, 0.5)


def test_no_more_are_served_than_the_bound(monkeypatch):
    monkeypatch.setattr(server, 'Door', partial(server.Door, 600.0, 64, 2))
    with served() as port, contextlib.ExitStack() as stack:
        for _ in range(2):
            one = half_open(stack, port)
            one.sendall(b'\r\n')
            assert one.recv(10)
        assert is_closed(half_open(stack, port), 60.0)


def test_the_log_gets_one_line_a_minute_without_a_traceback():
    only = OneLineAMinute()
    try:
        raise ValueError('bad request')
    except ValueError as problem:
        record = [logging.LogRecord('aiohttp.server', logging.ERROR, '', 1, 'Error %s', ('x',),
                                    (type(problem), problem, None)) for _ in range(100)]
    assert [only.filter(item) for item in record[:99]] == [True] + 98 * [False]
    assert record[0].getMessage() == 'Error x (ValueError)'
    assert record[0].exc_info is None
    record[99].created += 61.0
    assert only.filter(record[99])
    assert '98 more' in record[99].getMessage()


@pytest.fixture(autouse=True)
def _no_filters_left():
    yield
    assert not logging.getLogger('aiohttp.server').filters
