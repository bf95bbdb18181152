"""Samples and ring displacements in batches, to and from the bytes of their messages."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
import struct

import numpy as np
from numpy.typing import NDArray

from saddlering_ros.bags.cdr import decode_list, encode_list, SECOND
from saddlering_ros.bags.layouts import DISPLACEMENT_TYPE
from saddlering_ros.record.guard import Samples as Samples
from saddlering_ros.record.topics import RigTopic

ANY_TIME = (0, 0)
"""In place of the first and last stamp of a recording: none is known."""

Stamps = NDArray[np.int64]
Floats = NDArray[np.float64]

CHANNEL_FIELDS = ('delta_x', 'delta_y', 'gamma', 'parity')
_OTHER_FIELDS = ('zero_stamp.sec', 'zero_stamp.nanosec', 'zero_load', 'elevation', 'validity',
                 'zero_duration')


def _not_given() -> Floats:
    return np.empty(0)


def _no_validity() -> NDArray[np.uint8]:
    return np.empty(0, np.uint8)


@dataclass(frozen=True)
class Displacements:
    """A batch of ring displacements.

    stamps (N,) [ns]; channels (4, N): delta_x, delta_y [m], gamma [rad], parity [m], NaN where not
    known; zero_stamps (N,) [ns] and zero_loads (N,) [N]: the zero they count from; elevations (N,)
    [rad], NaN where not known (also if not given); validity (N,): 0, or a sum of the constants of
    RingDisplacement.msg; zero_durations (N,) [s]: how long the zero's samples took.
    """

    stamps: Stamps
    channels: Floats
    zero_stamps: Stamps
    zero_loads: Floats
    elevations: Floats = field(default_factory=_not_given)
    validity: NDArray[np.uint8] = field(default_factory=_no_validity)
    zero_durations: Floats = field(default_factory=_not_given)

    def __post_init__(self) -> None:
        count = len(self.stamps)
        if len(self.elevations) != count:
            object.__setattr__(self, 'elevations', np.full(count, np.nan))
        if len(self.validity) != count:
            object.__setattr__(self, 'validity', np.zeros(count, np.uint8))
        if len(self.zero_durations) != count:
            object.__setattr__(self, 'zero_durations', np.zeros(count))

    def __len__(self) -> int:
        return len(self.stamps)


def is_pause(recording: tuple[int, int], before: int, after: int) -> bool:
    """Whether two stamps [ns] lie in one recording: the time between them is a pause of a test.

    recording: first and last stamp [ns], or ANY_TIME.
    """
    return recording[0] <= before and after <= recording[1]


def no_samples() -> Samples:
    """An empty batch of samples."""
    return Samples(np.empty(0, np.int64), np.empty(0))


def no_displacements() -> Displacements:
    """An empty batch of displacements."""
    return Displacements(np.empty(0, np.int64), np.empty((4, 0)), np.empty(0, np.int64),
                         np.empty(0))


def join(batches: Sequence[Displacements]) -> Displacements:
    """Several batches as one."""
    if len(batches) == 1:
        return batches[0]
    if not batches:
        return no_displacements()
    return Displacements(
        np.concatenate([batch.stamps for batch in batches]),
        np.concatenate([batch.channels for batch in batches], axis=1),
        np.concatenate([batch.zero_stamps for batch in batches]),
        np.concatenate([batch.zero_loads for batch in batches]),
        np.concatenate([batch.elevations for batch in batches]),
        np.concatenate([batch.validity for batch in batches]),
        np.concatenate([batch.zero_durations for batch in batches]))


def pick(batch: Displacements, rows: np.ndarray) -> Displacements:
    """The given rows of a batch."""
    return Displacements(batch.stamps[rows], batch.channels[:, rows], batch.zero_stamps[rows],
                         batch.zero_loads[rows], batch.elevations[rows], batch.validity[rows],
                         batch.zero_durations[rows])


def in_order(batch: Displacements) -> Displacements:
    """The same rows by stamp."""
    return pick(batch, np.argsort(batch.stamps, kind='stable'))


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
    fields: dict[str, Floats | float] = {topic.field: samples.values}
    if topic.low:
        fields |= {topic.low: samples.low, topic.high: samples.high}
    return encode_list(topic.type, topic.frame_id if frame_id is None else frame_id,
                       samples.stamps, fields)


def decode_displacements(messages: Sequence[bytes]) -> Displacements:
    """A batch from saddlering_interfaces/RingDisplacement messages."""
    if not messages:
        return no_displacements()
    found = decode_list(messages, DISPLACEMENT_TYPE, (*CHANNEL_FIELDS, *_OTHER_FIELDS))
    fields = found.fields
    zero = fields['zero_stamp.sec'].astype(np.int64) * SECOND + fields['zero_stamp.nanosec']
    return Displacements(
        found.stamps, np.stack([fields[name] for name in CHANNEL_FIELDS]).astype(np.float64),
        zero, fields['zero_load'].astype(np.float64), fields['elevation'].astype(np.float64),
        fields['validity'].astype(np.uint8), fields['zero_duration'].astype(np.float64))


def encode_displacements(batch: Displacements, frame_id: str) -> list[bytes]:
    """saddlering_interfaces/RingDisplacement messages of `batch`."""
    second, nanosecond = np.divmod(batch.zero_stamps, SECOND)
    channels = dict(zip(CHANNEL_FIELDS, batch.channels, strict=True))
    return encode_list(DISPLACEMENT_TYPE, frame_id, batch.stamps, {
        **channels, 'zero_stamp.sec': second, 'zero_stamp.nanosec': nanosecond,
        'zero_load': batch.zero_loads, 'elevation': batch.elevations,
        'validity': batch.validity, 'zero_duration': batch.zero_durations})


def decode_clock(message: bytes) -> int:
    """The time [ns] of a rosgraph_msgs/Clock message."""
    second, nanosecond = struct.unpack_from('<iI', message, 4)
    return int(second) * SECOND + int(nanosecond)


def encode_clock(now: int) -> bytes:
    """A rosgraph_msgs/Clock message of the time `now` [ns]."""
    return b'\x00\x01\x00\x00' + struct.pack('<iI', *divmod(now, SECOND))
