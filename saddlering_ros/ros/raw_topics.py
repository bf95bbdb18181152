"""Topics as raw CDR bytes: their QoS, subscriptions and publishers, and the loop over them.

A loop waits for data, works a batch off, and serves everything else in between. `listen` takes
what any driver of a rig publishes within some seconds.
"""

from collections import deque
from collections.abc import Callable
from contextlib import ExitStack, suppress
import importlib
import math
import time
from typing import Any, TYPE_CHECKING, TypeVar

import numpy as np
import rclpy
from rclpy import qos
from rclpy._rclpy_pybind11 import RMWError
from rclpy.callback_groups import ReentrantCallbackGroup
from rclpy.context import Context
from rclpy.duration import Duration
from rclpy.executors import ShutdownException, SingleThreadedExecutor, TimeoutException
from rclpy.impl.implementation_singleton import rclpy_implementation
from rclpy.node import Node
from rclpy.serialization import deserialize_message

from saddlering_ros.bags.wire import CdrError, decode_samples
from saddlering_ros.doubts.driver import HeardTopic
from saddlering_ros.record.batches import Displacements, no_samples, Samples
from saddlering_ros.record.topics import LOAD, PROBES, RigTopic
from saddlering_ros.ros.diagnostics import StreamTask

if TYPE_CHECKING:
    from saddlering_ros.ros.streaming_node import StreamingNode

DEPTH = 5000
"""Messages that may wait at either end of a stream: five seconds at 1 kHz."""

PORTION, LONGEST_WAIT = DEPTH // 5, Duration(seconds=0.1)
"""Messages that are sent at once; more wait this long at most until every reader has these."""

_STREAM: dict[str, Any] = {
    'history': qos.HistoryPolicy.KEEP_LAST, 'reliability': qos.ReliabilityPolicy.RELIABLE,
    'durability': qos.DurabilityPolicy.VOLATILE}
_KEPT = _STREAM | {'durability': qos.DurabilityPolicy.TRANSIENT_LOCAL}
_PROMISE: dict[str, Any] = {
    'deadline': Duration(seconds=0.2), 'liveliness': qos.LivelinessPolicy.AUTOMATIC,
    'liveliness_lease_duration': Duration(seconds=1)}
"""Offered on topics that an interlock or a controller reads: longest time between two messages,
and time within which a dead publisher is noticed. A reader may ask for as much, or for more time.
"""


def stream_qos(reliable: bool = True, depth: int = DEPTH) -> qos.QoSProfile:
    """The QoS of a measured or simulated stream: deep, so that a busy reader loses no message."""
    profile = qos.QoSProfile(depth=depth, **_STREAM)
    if not reliable:
        profile.reliability = qos.ReliabilityPolicy.BEST_EFFORT
    return profile


LATCHED = qos.QoSProfile(depth=1, **_KEPT)
"""The last message is kept for late joiners."""

LATCHED_BY_SEVERAL = qos.QoSProfile(depth=50, **_KEPT)
"""For a reader of a latched topic that several nodes publish, its own among them: each keeps its
last message, and in a queue of one a message would push out an unread message of another node."""

PROMISED_QOS = qos.QoSProfile(depth=DEPTH, **_STREAM, **_PROMISE)
"""Of a stream that a node of the suite computes."""

LIMIT_QOS = qos.QoSProfile(depth=1, **_KEPT, **_PROMISE)
PROGRESS_QOS = stream_qos(depth=200)
ZERO_QOS = stream_qos(depth=10)
CLOCK_QOS = stream_qos(depth=10)
OF_ANY_SENSOR = stream_qos(reliable=False, depth=5)

MANY_REQUESTS = stream_qos(depth=2000)
"""Requests that may wait: of 50 goals at once the default queue keeps 10, and drops the others."""

Batch = TypeVar('Batch', Samples, Displacements)
One = TypeVar('One')

RELIABILITIES = ('auto', 'reliable', 'best_effort')


def message_class(name: str) -> Any:
    """The class of a message type ('package/msg/Name')."""
    package, kind, message = name.split('/')
    return getattr(importlib.import_module(f'{package}.{kind}'), message)


def type_name(kind: Any) -> str:
    """'package/msg/Name' of a message class."""
    return f'{kind.__module__.split(".")[0]}/msg/{kind.__name__}'


class _Drained(ReentrantCallbackGroup):
    """A group that no executor serves: `RawSubscription.take` empties its subscriptions."""

    def can_execute(self, entity: Any) -> bool:
        return False


SEQUENCE = 'publication_sequence_number'

LEASE = 20.0
"""Time [s] after which the middleware forgets a publisher that was killed."""


class Senders:
    """Whether messages of several publishers come on a topic: a killed one is still counted.

    Each publisher numbers its messages. They fall once where one begins anew, and again and again
    where two are mixed. A middleware that does not tell the numbers tells nothing.
    """

    def __init__(self) -> None:
        self._newest = 0
        self._falls: deque[float] = deque(maxlen=2)

    def note(self, number: int | None) -> None:
        """A message with this number has come."""
        if number is None or number <= self._newest:
            self._falls.append(time.monotonic())
        self._newest = number or 0

    @property
    def are_mixed(self) -> bool:
        """Whether the numbers fell twice within the last LEASE."""
        return len(self._falls) == 2 and time.monotonic() - self._falls[0] < LEASE


class RawSubscription:
    """One topic a node reads, as raw CDR bytes, taken in batches.

    A reader that asks for reliable delivery gets nothing from a best-effort publisher, which
    is what hardware drivers often are; one that asks for best effort loses messages of a replay.
    With reliability 'auto' it is therefore reliable while every publisher is, and best effort
    otherwise; `review` looks at the publishers there are and switches over.

    unheard: why nothing comes of a publisher, in words, or ''. The middleware's own line about it
    needs an executor, which no RawSubscription has.
    """

    def __init__(self, node: Node, topic: str, message_type: Any, *, reliability: str = 'auto',
                 depth: int = DEPTH, task: StreamTask | None = None) -> None:
        self._node, self._type, self._depth = node, message_type, depth
        self._automatic, self._task = reliability == 'auto', task
        self._group = _Drained()
        self.topic = node.resolve_topic_name(topic)
        if task is not None:
            task.source = self.topic
        self.reliable = reliability != 'best_effort'
        self.received = self.malformed = self.last_stamp = 0
        self.heard = -math.inf  # when the last message was taken [s, monotonic]
        self.newest = b''
        self.senders = Senders()
        self.unheard = ''
        self._open()

    def _open(self) -> None:
        self.subscription = self._node.create_subscription(
            self._type, self.topic, lambda _: None, stream_qos(self.reliable, self._depth),
            callback_group=self._group, raw=True)
        self.handle = self.subscription.handle

    def review(self) -> bool:
        """Fit the reliability to the publishers there are; True when the subscription changed."""
        infos = self._node.get_publishers_info_by_topic(self.topic)
        wanted = type_name(self._type)
        others = sorted({info.topic_type for info in infos} - {wanted})
        kinds = {info.qos_profile.reliability for info in infos if info.topic_type == wanted}
        reliable = qos.ReliabilityPolicy.BEST_EFFORT not in kinds
        if others:
            self._tell(f'is published as {others[0]}: publish {wanted}')
        elif self.reliable and not reliable and not self._automatic:
            self._tell('a publisher offers best effort only, of which a subscription with '
                       'input_reliability reliable gets nothing: set input_reliability to auto')
        else:
            self.unheard = ''
        if not self._automatic or not kinds or reliable == self.reliable:
            return False
        self._node.get_logger().info(
            f'{self.topic}: '
            + ('all publishers are reliable, subscribing reliably' if reliable else
               'a publisher offers best effort only, subscribing with best effort'))
        self.reliable = reliable
        self.close()
        self._open()
        return True

    def _tell(self, words: str) -> None:
        before, self.unheard = self.unheard, f'{self.topic}: {words}'
        if self.unheard != before:
            self._node.get_logger().warning(self.unheard)

    def take(self) -> list[bytes]:
        """Everything that has arrived since the last call."""
        messages: list[bytes] = []
        handle, kind, note = self.handle, self._type, self.senders.note
        while True:
            taken = handle.take_message(kind, True)
            if taken is None:
                if messages:
                    self.received += len(messages)
                    self.newest, self.heard = messages[-1], time.monotonic()
                return messages
            messages.append(taken[0])
            note(taken[1][SEQUENCE])

    def take_as(self, decode: Callable[[list[bytes]], Batch]) -> Batch:
        """Arrived messages, decoded; undecodable ones are counted. The task judges the stamps."""
        messages = self.take()
        try:
            batch = decode(messages)
        except CdrError:
            batch = decode(self._sound(messages, lambda message: (decode([message]), message)[1]))
        if len(batch):
            self.last_stamp = int(batch.stamps[-1])
            if self._task is not None:
                self._task.push(batch.stamps)
        return batch

    def take_each(self, decode: Callable[[bytes], One]) -> list[One]:
        """Everything that has arrived, decoded one by one; undecodable ones are counted."""
        return self._sound(self.take(), decode)

    def _sound(self, messages: list[bytes], decode: Callable[[bytes], One]) -> list[One]:
        found = []
        for message in messages:
            try:
                found.append(decode(message))
            except (CdrError, RMWError) as problem:
                self.malformed += 1
                self._node.get_logger().error(
                    f'{self.topic}: malformed messages are dropped: {problem}',
                    throttle_duration_sec=1.0)
        return found

    def take_samples(self, topic: RigTopic) -> Samples:
        """Everything that has arrived on a topic of the rig."""
        return self.take_as(lambda messages: decode_samples(messages, topic))

    def publishers(self) -> int:
        return int(self.subscription.get_publisher_count())

    def close(self) -> None:
        self._node.destroy_subscription(self.subscription)


class RawPublisher:
    """One topic that a node writes. It takes serialized messages and counts them."""

    def __init__(self, node: Node, topic: str, message_type: Any,
                 profile: qos.QoSProfile | None = None) -> None:
        self._node = node
        self.publisher = node.create_publisher(message_type, topic, profile or PROMISED_QOS)
        self.topic = node.resolve_topic_name(topic)
        self.published = self.last_stamp = 0
        self._send = self.publisher.handle.publish_raw

    def send(self, messages: list[bytes], last_stamp: int) -> None:
        """Publish serialized messages in order; `last_stamp` [ns] is that of the last one."""
        send = self._send
        for start in range(0, len(messages), PORTION):
            if start:  # as when the zero of a fast record releases what waited for it
                self.publisher.wait_for_all_acked(LONGEST_WAIT)
            for message in messages[start:start + PORTION]:
                send(message)
        if messages:
            self.published += len(messages)
            self.last_stamp = last_stamp

    def subscriptions(self) -> int:
        return int(self.publisher.get_subscription_count())

    def close(self) -> None:
        self._node.destroy_publisher(self.publisher)


IDLE_WAIT = 0.01
"""Longest wait for data [s]; also how long a service call may wait while data flows."""

ASLEEP_AFTER = 0.1
"""A node that has had no data for this long [s] waits for data and for callers at once."""

ASLEEP_WAIT = 0.05
"""Longest wait of a node asleep [s]."""

SERVE_ALL = 0.25
"""The executor looks this often [s] for what `DataWait` does not see: events of the middleware.
It is asked seldom, because its look costs as much as ten messages."""

PERIOD = 0.0007
"""Shortest mean time from one batch to the next [s]: a wake-up costs as much as several messages.
Up to 1 kHz each message is worked off when it comes; above that they wait for one another."""

PATIENCE = 0.005
"""Longest wait for the awaited subscriptions alone [s]; then any message begins a batch."""


class DataWait:
    """Waits for any of some subscriptions, without the cost of an executor."""

    def __init__(self, context: Context) -> None:
        self._context = context
        self._sets: dict[tuple[int, int], Any] = {}

    def wait(self, subscriptions: list[RawSubscription], seconds: float,
             node: Node | None = None) -> tuple[bool, bool]:
        """Wait until one of `subscriptions` has data, at most `seconds`: whether one has.

        With `node`, what its executor is to serve ends the wait too: the second answer.
        """
        streams = [flow.handle for flow in subscriptions]
        services = [] if node is None else [service.handle for service in node.services]
        others = [] if node is None else [
            flow.handle for flow in node.subscriptions if flow.callback_group.can_execute(flow)]
        if not streams and not services and not others:
            time.sleep(seconds)
            return False, False
        sizes = len(streams) + len(others), len(services)
        if sizes not in self._sets:
            with self._context.handle:
                self._sets[sizes] = rclpy_implementation.WaitSet(
                    sizes[0], 0, 0, 0, sizes[1], 0, self._context.handle)
        ready = self._sets[sizes]
        ready.clear_entities()
        with ExitStack() as held:
            for handle in (*streams, *others):
                held.enter_context(handle)
                ready.add_subscription(handle)
            for handle in services:
                held.enter_context(handle)
                ready.add_service(handle)
            ready.wait(max(0, int(seconds * 1e9)))
            come = ready.get_ready_entities('subscription')
            return (any(handle.pointer in come for handle in streams),
                    any(handle.pointer in come for handle in others)
                    or bool(services and ready.get_ready_entities('service')))


def spin_streaming(node: 'StreamingNode') -> None:
    """Run a node until it is finished or its context is shut down.

    Everything but the drained subscriptions (services, parameters, lifecycle) is served by an
    ordinary executor: within IDLE_WAIT while data flow, as soon as it comes while none do.
    """
    executor = SingleThreadedExecutor(context=node.context)
    executor.add_node(node)
    data, calls = DataWait(node.context), DataWait(node.context)
    looked = served = due = limit = 0.0
    heard = time.monotonic()
    try:
        while node.context.ok() and not node.done:
            silent = time.monotonic() - heard
            asleep = silent >= ASLEEP_AFTER
            if silent < PATIENCE:
                has_data, called = data.wait(node.awaited(), min(limit, PATIENCE))
            else:
                has_data, called = data.wait(node.inputs, limit, node if asleep else None)
            woke = time.monotonic()
            if has_data:
                due = max(due + PERIOD, woke - PERIOD)  # after a late one, the next may be early
                time.sleep(max(0.0, due - woke))
                heard = time.monotonic()
                node.work()
            if not asleep and woke - looked >= IDLE_WAIT:
                looked, (_, called) = woke, calls.wait([], 0.0, node)
            if called or woke - served >= SERVE_ALL:
                with suppress(TimeoutException, ShutdownException):
                    for _ in range(16):  # of the callbacks that are due, a bounded number
                        handler, _entity, _node = executor.wait_for_ready_callbacks(0.0)
                        handler()
                        handler.result()
                served = time.monotonic()
            limit = min(ASLEEP_WAIT if asleep else IDLE_WAIT, node.tick(time.monotonic()))
    finally:
        executor.remove_node(node)
        executor.shutdown(timeout_sec=0.0)


LISTENER = 'saddlering_check_driver'
FIRST_SAMPLE = 5.0
"""Longest wait [s] for the first sample; the time of listening begins with it."""

POLL = 0.002
"""Between two looks at what came [s]: two samples of a driver with 1 kHz."""


def listen(domain: int | None, namespace: str, seconds: float) -> dict[str, HeardTopic]:
    """The five topics of the rig in `namespace`, by name, over `seconds` from the first sample."""
    context = rclpy.Context()
    rclpy.init(context=context, args=[], domain_id=domain)
    node = rclpy.create_node(LISTENER, namespace=namespace, context=context)
    try:
        flows = {topic: RawSubscription(node, topic.relative, message_class(topic.type))
                 for topic in (LOAD, *PROBES)}
        came: dict[RigTopic, list[tuple[int, bytes]]] = {topic: [] for topic in flows}
        wait, reviewed, is_silent = DataWait(context), -math.inf, True
        end = time.monotonic() + FIRST_SAMPLE + seconds
        while (now := time.monotonic()) < end:
            if now - reviewed > 0.2:
                reviewed = now
                for flow in flows.values():
                    flow.review()
            wait.wait([*flows.values()], POLL)
            for topic, flow in flows.items():
                came[topic] += [(time.time_ns(), message) for message in flow.take()]
            if is_silent and any(came.values()):
                end, is_silent = time.monotonic() + seconds, False
            time.sleep(POLL)
        return {topic.name: _heard(node, topic, came[topic]) for topic in flows}
    finally:
        node.destroy_node()
        rclpy.try_shutdown(context=context)


def _heard(node: Node, topic: RigTopic, came: list[tuple[int, bytes]]) -> HeardTopic:
    infos = node.get_publishers_info_by_topic(topic.relative)
    samples, frame_id = no_samples(), ''
    with suppress(CdrError):
        samples = decode_samples([message for _, message in came], topic)
    if len(samples):
        first: Any = deserialize_message(came[0][1], message_class(topic.type))
        frame_id = first.header.frame_id
    return HeardTopic(
        **vars(samples), frame_id=frame_id, publishers=len(infos),
        arrivals=np.array([arrival for arrival, _ in came[:len(samples)]], np.int64),
        types=tuple(sorted({info.topic_type for info in infos})))
