"""Listens to the topics of a rig for some seconds, from any publisher."""

from contextlib import suppress
from dataclasses import dataclass, field
import math
import time
from typing import Any

import numpy as np
import rclpy
from rclpy.node import Node
from rclpy.serialization import deserialize_message

from saddlering_ros.bags.wire import CdrError, decode_samples
from saddlering_ros.doubts.driver import HeardTopic
from saddlering_ros.record.batches import no_samples
from saddlering_ros.record.topics import LOAD, PROBES, RigTopic
from saddlering_ros.ros.raw_topics import DataWait, message_class, RawSubscription

NAME = 'saddlering_check_driver'
FIRST_SAMPLE = 5.0
"""Longest wait [s] for the first sample; the time of listening begins with it."""

POLL = 0.002
"""Between two looks at what came [s]: two samples of a driver with 1 kHz."""


@dataclass
class _Flow:
    topic: RigTopic
    subscription: RawSubscription
    messages: list[bytes] = field(default_factory=list)
    arrivals: list[int] = field(default_factory=list)

    def take(self) -> int:
        messages = self.subscription.take()
        self.messages += messages
        self.arrivals += [time.time_ns()] * len(messages)
        return len(messages)

    def heard(self, node: Node) -> HeardTopic:
        infos = node.get_publishers_info_by_topic(self.subscription.topic)
        samples, frame_id = no_samples(), ''
        with suppress(CdrError):
            samples = decode_samples(self.messages, self.topic)
        if len(samples):
            first: Any = deserialize_message(self.messages[0], message_class(self.topic.type))
            frame_id = first.header.frame_id
        return HeardTopic(
            **vars(samples), arrivals=np.array(self.arrivals[:len(samples)], np.int64),
            frame_id=frame_id, publishers=len(infos),
            types=tuple(sorted({info.topic_type for info in infos})))


def listen(domain: int | None, namespace: str, seconds: float) -> dict[str, HeardTopic]:
    """The five topics of the rig in `namespace`, by name, over `seconds` from the first sample."""
    context = rclpy.Context()
    rclpy.init(context=context, args=[], domain_id=domain)
    node = rclpy.create_node(NAME, namespace=namespace, context=context)
    try:
        flows = [_Flow(topic, RawSubscription(node, topic.relative, message_class(topic.type)))
                 for topic in (LOAD, *PROBES)]
        wait, reviewed, is_silent = DataWait(context), -math.inf, True
        end = time.monotonic() + FIRST_SAMPLE + seconds
        while (now := time.monotonic()) < end:
            if now - reviewed > 0.2:
                reviewed = now
                for flow in flows:
                    flow.subscription.review()
            wait.wait([flow.subscription for flow in flows], POLL)
            if sum(flow.take() for flow in flows) and is_silent:
                end, is_silent = time.monotonic() + seconds, False
            time.sleep(POLL)
        return {flow.topic.name: flow.heard(node) for flow in flows}
    finally:
        node.destroy_node()
        rclpy.try_shutdown(context=context)
