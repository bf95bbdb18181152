"""Quality of service of the topics, each kind written once."""

from __future__ import annotations

from rclpy.qos import DurabilityPolicy, HistoryPolicy, QoSProfile, ReliabilityPolicy

DEPTH = 5000
"""Messages that may wait at either end of a stream: five seconds at 1 kHz."""


def stream_qos(reliable: bool = True, depth: int = DEPTH) -> QoSProfile:
    """The QoS of a measured or simulated stream: deep, so that a busy reader loses no message."""
    kind = ReliabilityPolicy.RELIABLE if reliable else ReliabilityPolicy.BEST_EFFORT
    return QoSProfile(history=HistoryPolicy.KEEP_LAST, depth=depth, reliability=kind,
                      durability=DurabilityPolicy.VOLATILE)


def _latched(depth: int) -> QoSProfile:
    return QoSProfile(depth=depth, reliability=ReliabilityPolicy.RELIABLE,
                      durability=DurabilityPolicy.TRANSIENT_LOCAL)


LATCHED = _latched(1)
"""The last message is kept for late joiners."""

LATCHED_BY_SEVERAL = _latched(50)
"""For a reader of a latched topic that several nodes publish, its own among them: each keeps its
last message, and in a queue of one a message would push out an unread message of another node."""

PROGRESS_QOS = stream_qos(depth=200)
ZERO_QOS = stream_qos(depth=10)
CLOCK_QOS = stream_qos(depth=10)
OF_ANY_SENSOR = stream_qos(reliable=False, depth=5)

MANY_REQUESTS = stream_qos(depth=2000)
"""Requests that may wait: of 50 goals at once the default queue keeps 10, and drops the others."""
