"""Topics as raw CDR bytes: subscriptions drained per wake-up, publishers that count."""

from __future__ import annotations

from collections.abc import Callable
import importlib
from typing import Any, TypeVar

from rclpy.callback_groups import CallbackGroup
from rclpy.node import Node
from rclpy.qos import QoSProfile, ReliabilityPolicy

from saddlering_ros.bags.cdr import CdrError
from saddlering_ros.record.topics import RigTopic
from saddlering_ros.ros.errors import NodeError
from saddlering_ros.ros.qos import DEPTH, stream_qos
from saddlering_ros.streams.batches import decode_samples, Samples

Batch = TypeVar('Batch')

RELIABILITIES = ('auto', 'reliable', 'best_effort')


def message_class(name: str) -> Any:
    """The class of a message type ('package/msg/Name')."""
    package, kind, message = name.split('/')
    return getattr(importlib.import_module(f'{package}.{kind}'), message)


class _Drained(CallbackGroup):
    """A group that no executor serves: `RawSubscription.take` empties its subscriptions."""

    def can_execute(self, entity: Any) -> bool:
        return False

    def beginning_execution(self, entity: Any) -> bool:
        return False

    def ending_execution(self, entity: Any) -> None:
        return None


class RawSubscription:
    """One topic a node reads, as raw CDR bytes, taken in batches.

    A reader that asks for reliable delivery gets nothing from a best-effort publisher, which
    is what hardware drivers often are; one that asks for best effort loses messages of a replay.
    With reliability 'auto' it is therefore reliable while every publisher is, and best effort
    otherwise; `review` looks at the publishers there are and switches over.
    """

    def __init__(self, node: Node, topic: str, message_type: Any, *, reliability: str = 'auto',
                 depth: int = DEPTH) -> None:
        if reliability not in RELIABILITIES:
            raise NodeError(f'reliability is {reliability!r}: give one of '
                            f'{", ".join(RELIABILITIES)}')
        self._node, self._type, self._depth = node, message_type, depth
        self._automatic = reliability == 'auto'
        self._group = _Drained()
        self.topic = node.resolve_topic_name(topic)
        self.reliable = reliability != 'best_effort'
        self.received = 0
        self.malformed = 0
        self.last_stamp = 0
        self._open()

    def _open(self) -> None:
        self.subscription = self._node.create_subscription(
            self._type, self.topic, _never_called, stream_qos(self.reliable, self._depth),
            callback_group=self._group, raw=True)
        self.handle = self.subscription.handle

    def review(self) -> bool:
        """Fit the reliability to the publishers there are; True when the subscription changed."""
        if not self._automatic:
            return False
        kinds = {info.qos_profile.reliability
                 for info in self._node.get_publishers_info_by_topic(self.topic)}
        if not kinds:
            return False
        reliable = ReliabilityPolicy.BEST_EFFORT not in kinds
        if reliable == self.reliable:
            return False
        self._node.get_logger().info(
            f'{self.topic}: '
            + ('all publishers are reliable, subscribing reliably' if reliable else
               'a publisher offers best effort only, subscribing with best effort'))
        self.reliable = reliable
        self.close()
        self._open()
        return True

    def take(self) -> list[bytes]:
        """Everything that has arrived since the last call."""
        messages: list[bytes] = []
        handle, kind = self.handle, self._type
        while True:
            taken = handle.take_message(kind, True)
            if taken is None:
                self.received += len(messages)
                return messages
            messages.append(taken[0])

    def take_as(self, decode: Callable[[list[bytes]], Batch]) -> Batch:
        """Messages that have arrived, decoded; undecodable ones are counted and dropped."""
        messages = self.take()
        try:
            return decode(messages)
        except CdrError as problem:
            sound = [message for message in messages if _can_be(decode, message)]
            self.malformed += len(messages) - len(sound)
            self._node.get_logger().error(
                f'{self.topic}: malformed messages are dropped: {problem}',
                throttle_duration_sec=1.0)
            return decode(sound)

    def take_samples(self, topic: RigTopic) -> Samples:
        """Everything that has arrived on a topic of the rig."""
        return self.take_as(lambda messages: decode_samples(messages, topic))

    def publishers(self) -> int:
        """How many publishers it is matched with."""
        return int(self.subscription.get_publisher_count())

    def close(self) -> None:
        """Unsubscribe."""
        self._node.destroy_subscription(self.subscription)


class RawPublisher:
    """One topic that a node writes. It takes serialized messages and counts them."""

    def __init__(self, node: Node, topic: str, message_type: Any, qos: QoSProfile | None = None,
                 ) -> None:
        self._node = node
        self.publisher = node.create_publisher(message_type, topic, qos or stream_qos())
        self.topic = node.resolve_topic_name(topic)
        self.published = 0
        self.last_stamp = 0
        self._send = self.publisher.handle.publish_raw

    def send(self, messages: list[bytes], last_stamp: int) -> None:
        """Publish serialized messages in order; `last_stamp` [ns] is that of the last one."""
        send = self._send
        for message in messages:
            send(message)
        if messages:
            self.published += len(messages)
            self.last_stamp = last_stamp

    def subscriptions(self) -> int:
        """How many subscriptions it is matched with."""
        return int(self.publisher.get_subscription_count())

    def close(self) -> None:
        """Stop publishing."""
        self._node.destroy_publisher(self.publisher)


def _can_be(decode: Callable[[list[bytes]], Any], message: bytes) -> bool:
    try:
        decode([message])
    except CdrError:
        return False
    return True


def _never_called(message: bytes) -> None:
    raise AssertionError('drained subscriptions have no callback')
