"""Listens to the topics of a rig for some seconds, from any publisher."""

from contextlib import suppress
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


def listen(domain: int | None, namespace: str, seconds: float) -> dict[str, HeardTopic]:
    """The five topics of the rig in `namespace`, by name, over `seconds` from the first sample."""
    context = rclpy.Context()
    rclpy.init(context=context, args=[], domain_id=domain)
    node = rclpy.create_node(NAME, namespace=namespace, context=context)
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
