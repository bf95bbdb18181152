"""The loop of a streaming node: wait for data, work off a batch, serve the rest in between."""

from __future__ import annotations

from contextlib import ExitStack
import time
from typing import Any, NamedTuple, Protocol

from rclpy.context import Context
from rclpy.executors import ShutdownException, SingleThreadedExecutor, TimeoutException
from rclpy.impl.implementation_singleton import rclpy_implementation
from rclpy.node import Node

from saddlering_ros.ros.raw_topics import RawSubscription

IDLE_WAIT = 0.01
"""Longest wait for data [s]; also how long a service call may wait while data flows."""

ASLEEP_AFTER = 0.1
"""A node that has had no data for this long [s] waits for data and for callers at once."""

ASLEEP_WAIT = 0.05
"""Longest wait of a node asleep [s]."""

SERVE_ALL = 0.25
"""The executor looks this often [s] for what `DataWait` does not see: events of the middleware.
It is asked seldom, because its look costs as much as ten messages."""

PERIOD = 0.0015
"""Shortest mean time from one batch to the next [s]: a wake-up costs as much as several messages.
At 1 kHz messages are worked off by fives and tens, for a millisecond of delay."""

PATIENCE = 0.005
"""Longest wait for the awaited subscriptions alone [s]; then any message begins a batch."""


class Streaming(Protocol):
    """Methods of a node that the loop calls."""

    def raw_subscriptions(self) -> list[RawSubscription]:
        """The subscriptions to wait for (they may change from call to call)."""

    def awaited(self) -> list[RawSubscription]:
        """Those of them without whose next message a batch would give no result."""

    def work(self) -> None:
        """Take and process the messages that have arrived."""

    def tick(self, now: float) -> float:
        """Do the work due at `now` (monotonic) [s]; returns the next longest wait [s]."""

    def finished(self) -> bool:
        """Whether the node wants to leave."""


class Ready(NamedTuple):
    """What ended a wait: data of a stream, or a message or call that the executor serves."""

    data: bool
    call: bool


NOTHING = Ready(False, False)


class DataWait:
    """Waits for any of some subscriptions, without the cost of an executor."""

    def __init__(self, context: Context) -> None:
        self._context = context
        self._sets: dict[tuple[int, int], Any] = {}

    def wait(self, subscriptions: list[RawSubscription], seconds: float,
             node: Node | None = None) -> Ready:
        """Wait until one of `subscriptions` has data, at most `seconds`.

        With `node`, a message or a call that its executor is to serve ends the wait too.
        """
        streams = [flow.handle for flow in subscriptions]
        services = [] if node is None else [service.handle for service in node.services]
        others = [] if node is None else [
            flow.handle for flow in node.subscriptions if flow.callback_group.can_execute(flow)]
        if not streams and not services and not others:
            time.sleep(seconds)
            return NOTHING
        with ExitStack() as held:
            ready = self._wait_set(len(streams) + len(others), len(services))
            for handle in (*streams, *others):
                held.enter_context(handle)
                ready.add_subscription(handle)
            for handle in services:
                held.enter_context(handle)
                ready.add_service(handle)
            ready.wait(max(0, int(seconds * 1e9)))
            come = ready.get_ready_entities('subscription')
            return Ready(
                any(handle.pointer in come for handle in streams),
                any(handle.pointer in come for handle in others)
                or bool(services and ready.get_ready_entities('service')))

    def _wait_set(self, subscriptions: int, services: int) -> Any:
        """An empty set with these sizes, made once."""
        sizes = subscriptions, services
        if sizes not in self._sets:
            with self._context.handle:
                self._sets[sizes] = rclpy_implementation.WaitSet(
                    subscriptions, 0, 0, 0, services, 0, self._context.handle)
        found = self._sets[sizes]
        found.clear_entities()
        return found


def spin_streaming(node: Node, streaming: Streaming) -> None:
    """Run `streaming` until it is finished or its context is shut down.

    Everything but the drained subscriptions (services, parameters, lifecycle) is served by an
    ordinary executor: within IDLE_WAIT while data flow, as soon as it comes while none do.
    """
    executor = SingleThreadedExecutor(context=node.context)
    executor.add_node(node)
    data, calls = DataWait(node.context), DataWait(node.context)
    looked = served = due = limit = 0.0
    heard = time.monotonic()
    try:
        while node.context.ok() and not streaming.finished():
            silent = time.monotonic() - heard
            asleep = silent >= ASLEEP_AFTER
            if silent < PATIENCE:
                ready = data.wait(streaming.awaited(), min(limit, PATIENCE))
            else:
                ready = data.wait(streaming.raw_subscriptions(), limit, node if asleep else None)
            woke = time.monotonic()
            if ready.data:
                due = max(due + PERIOD, woke - PERIOD)  # after a late one, the next may be early
                time.sleep(max(0.0, due - woke))
                heard = time.monotonic()
                streaming.work()
            called = ready.call
            if not asleep and woke - looked >= IDLE_WAIT:
                looked, called = woke, calls.wait([], 0.0, node).call
            if called or woke - served >= SERVE_ALL:
                _serve(executor)
                served = time.monotonic()
            limit = min(ASLEEP_WAIT if asleep else IDLE_WAIT, streaming.tick(time.monotonic()))
    finally:
        executor.remove_node(node)
        executor.shutdown(timeout_sec=0.0)


def _serve(executor: SingleThreadedExecutor) -> None:
    """Run the callbacks that are due, a bounded number of them."""
    for _ in range(16):
        try:
            handler, _entity, _node = executor.wait_for_ready_callbacks(timeout_sec=0.0)
        except (TimeoutException, ShutdownException):
            return
        handler()
        handler.result()
