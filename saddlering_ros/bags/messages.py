"""Samples and ring displacements to and from the bytes of their messages."""

from __future__ import annotations

from collections.abc import Sequence
import struct

import numpy as np
from numpy.typing import NDArray

from saddlering_ros.bags.wire import decode_list, DISPLACEMENT_TYPE, encode_list, SECOND
from saddlering_ros.record.samples import Displacements, no_displacements, no_samples, Samples
from saddlering_ros.record.topics import RigTopic
from saddlering_ros.rig import CHANNELS

COVARIANCE_BYTES = 128

_OTHER_FIELDS = ('zero_stamp.sec', 'zero_stamp.nanosec', 'zero_load', 'elevation', 'validity',
                 'zero_duration')


def decode_samples(messages: Sequence[bytes], topic: RigTopic) -> Samples:
    """Readings of a topic of the rig, with the range that the last message states."""
    if not messages:
        return no_samples()
    found = decode_list(messages, topic.type, topic.fields)
    values = found.fields[topic.field].astype(np.float64)
    if not topic.low:
        return Samples(found.stamps, values)
    low, high = (float(found.fields[name][-1]) for name in (topic.low, topic.high))
    return Samples(found.stamps, values, low, high)


def encode_samples(samples: Samples, topic: RigTopic, frame_id: str | None = None) -> list[bytes]:
    """Messages of a topic of the rig; the frame id is the topic's own unless one is given."""
    fields: dict[str, NDArray[np.float64] | float] = {topic.field: samples.values}
    if topic.low:
        fields |= {topic.low: samples.low, topic.high: samples.high}
    return encode_list(topic.type, topic.frame_id if frame_id is None else frame_id,
                       samples.stamps, fields)


def decode_displacements(messages: Sequence[bytes]) -> Displacements:
    """A batch from saddlering_interfaces/RingDisplacement messages."""
    if not messages:
        return no_displacements()
    found = decode_list(messages, DISPLACEMENT_TYPE, (*CHANNELS, *_OTHER_FIELDS))
    fields = found.fields
    zero = fields['zero_stamp.sec'].astype(np.int64) * SECOND + fields['zero_stamp.nanosec']
    return Displacements(
        found.stamps, np.array([fields[name] for name in CHANNELS], np.float64),
        zero, fields['zero_load'].astype(np.float64), fields['elevation'].astype(np.float64),
        fields['validity'].astype(np.uint8), fields['zero_duration'].astype(np.float64))


def encode_displacements(batch: Displacements, frame_id: str,
                         covariance: NDArray[np.float64] | None = None) -> list[bytes]:
    """saddlering_interfaces/RingDisplacement messages of `batch`, all with one covariance (4, 4).

    Without one, all its numbers are 0, which stands for not known.
    """
    noise = {} if covariance is None else {
        f'covariance.{place}': value for place, value in enumerate(covariance.ravel().tolist())}
    second, nanosecond = np.divmod(batch.zero_stamps, SECOND)
    channels = dict(zip(CHANNELS, batch.channels, strict=True))
    return encode_list(DISPLACEMENT_TYPE, frame_id, batch.stamps, {
        **channels, 'zero_stamp.sec': second, 'zero_stamp.nanosec': nanosecond,
        'zero_load': batch.zero_loads, 'elevation': batch.elevations,
        'validity': batch.validity, 'zero_duration': batch.zero_durations, **noise})


def covariance_of(message: bytes) -> NDArray[np.float64]:
    """The covariance (4, 4) of a RingDisplacement message, which ends with it; 0: not known."""
    little_endian = len(message) > COVARIANCE_BYTES and message[1] & 1
    if not little_endian:
        return np.zeros((4, 4))
    return np.frombuffer(message, '<f8', 16, len(message) - COVARIANCE_BYTES).reshape(4, 4)


def decode_clock(message: bytes) -> int:
    """The time [ns] of a rosgraph_msgs/Clock message."""
    second, nanosecond = struct.unpack_from('<iI', message, 4)
    return int(second) * SECOND + int(nanosecond)


def encode_clock(now: int) -> bytes:
    """A rosgraph_msgs/Clock message of the time `now` [ns]."""
    return b'\x00\x01\x00\x00' + struct.pack('<iI', *divmod(now, SECOND))
