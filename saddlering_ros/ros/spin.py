"""The loop of a streaming node: wait for data, work off a batch, serve the rest in between."""

from __future__ import annotations

from contextlib import ExitStack
import time
from typing import Any, Protocol

from rclpy.context import Context
from rclpy.executors import ShutdownException, SingleThreadedExecutor, TimeoutException
from rclpy.impl.implementation_singleton import rclpy_implementation
from rclpy.node import Node

from saddlering_ros.ros.raw_topics import RawSubscription

IDLE_WAIT = 0.01
"""Longest wait for data [s]; also how long a service call may wait while data flows."""

COALESCE = 0.001
"""Shortest time from one batch to the next [s]: at 1 kHz messages are then worked off by fives and
tens, each wake-up costing as much as several messages, for a millisecond of delay."""


class Streaming(Protocol):
    """What the loop asks of a node."""

    def raw_subscriptions(self) -> list[RawSubscription]:
        """The subscriptions to wait for (they may change from call to call)."""

    def work(self) -> None:
        """Take what has arrived and deal with it."""

    def tick(self, now: float) -> float:
        """What is due at `now` (monotonic) [s]; returns how long it may wait next [s]."""

    def finished(self) -> bool:
        """Whether the node wants to leave."""


class DataWait:
    """Waits for any of some subscriptions, without the cost of an executor."""

    def __init__(self, context: Context) -> None:
        self._context = context
        self._size = -1
        self._set: Any = None

    def wait(self, subscriptions: list[RawSubscription], seconds: float) -> bool:
        """Wait until one of `subscriptions` has data, at most `seconds`; whether one has."""
        if not subscriptions:
            time.sleep(seconds)
            return False
        if self._size != len(subscriptions):
            self._size = len(subscriptions)
            with self._context.handle:
                self._set = rclpy_implementation.WaitSet(
                    self._size, 0, 0, 0, 0, 0, self._context.handle)
        ready = self._set
        with ExitStack() as held:
            ready.clear_entities()
            for subscription in subscriptions:
                held.enter_context(subscription.handle)
                ready.add_subscription(subscription.handle)
            ready.wait(max(0, int(seconds * 1e9)))
            return bool(ready.get_ready_entities('subscription'))


def spin_streaming(node: Node, streaming: Streaming) -> None:
    """Run `streaming` until it is finished or its context is shut down.

    Everything but the drained subscriptions (services, parameters, lifecycle, timers) is served
    by an ordinary executor every IDLE_WAIT.
    """
    executor = SingleThreadedExecutor(context=node.context)
    executor.add_node(node)
    data = DataWait(node.context)
    served = 0.0
    limit = 0.0
    try:
        while node.context.ok() and not streaming.finished():
            ready = data.wait(streaming.raw_subscriptions(), limit)
            woke = time.monotonic()
            if ready:
                streaming.work()
            if woke - served >= IDLE_WAIT:
                _serve(executor)
                served = time.monotonic()
            limit = min(IDLE_WAIT, streaming.tick(time.monotonic()))
            if ready:
                rest = COALESCE - (time.monotonic() - woke)
                if rest > 0.0:
                    time.sleep(rest)
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
