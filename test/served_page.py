"""The live page served by this process, for tests."""

import contextlib
import threading

from saddlering_ros.live.server import Address, serve


@contextlib.contextmanager
def served_page(watcher, port=0):
    """The page of a watcher on this machine; its address."""
    ready, until, found = threading.Event(), threading.Event(), []
    thread = threading.Thread(target=serve, daemon=True, args=(
        watcher, Address('127.0.0.1', port), lambda where: (found.append(where), ready.set()),
        until))
    thread.start()
    try:
        assert ready.wait(60.0)
        yield found[0]
    finally:
        until.set()
        thread.join(60.0)
    assert not thread.is_alive()
