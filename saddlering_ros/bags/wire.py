"""Messages as bytes: the fields of each type, and the decoder and encoder of CDR.

Every such message begins with a std_msgs/Header and continues with numbers only, so that all
messages with the same frame id have one size. NumPy views of the bytes of all messages give stamps
and numbers without message objects, about a hundred times as fast as rosbags decodes them
(benchmarks/reading.py). Source of the layout: OMG DDS-XTypes 1.3, 7.4 (plain CDR, versions 1
and 2, both byte orders).
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
import functools
import struct
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, DTypeLike, NDArray

from saddlering_ros.record import batches
from saddlering_ros.record.batches import Displacements, Samples, SECOND
from saddlering_ros.record.topics import RANGE_TYPE, RigTopic, VECTOR_TYPE, WRENCH_TYPE
from saddlering_ros.rig import CHANNELS

DISPLACEMENT_TYPE = 'saddlering_interfaces/msg/RingDisplacement'

LAYOUTS: dict[str, tuple[tuple[str, str], ...]] = {
    WRENCH_TYPE: tuple((f'wrench.{vector}.{axis}', 'f8') for vector in ('force', 'torque')
                       for axis in 'xyz'),
    VECTOR_TYPE: tuple((f'vector.{axis}', 'f8') for axis in 'xyz'),
    RANGE_TYPE: (
        ('radiation_type', 'u1'), ('field_of_view', 'f4'), ('min_range', 'f4'),
        ('max_range', 'f4'), ('range', 'f4'), ('variance', 'f4')),
    DISPLACEMENT_TYPE: (
        ('delta_x', 'f8'), ('delta_y', 'f8'), ('gamma', 'f8'), ('parity', 'f8'),
        ('zero_stamp.sec', 'i4'), ('zero_stamp.nanosec', 'u4'), ('zero_load', 'f8'),
        ('elevation', 'f8'), ('validity', 'u1'), ('zero_duration', 'f8'),
        *((f'covariance.{place}', 'f8') for place in range(16)))}
"""Fields after the header by message type, in the order of the message's definition. The name of a
field is its path in the message; kinds are those of NumPy."""

DEFAULTS: dict[str, dict[str, float]] = {RANGE_TYPE: {'radiation_type': 1}}
"""Fields whose default is not 0: infrared, because the other type (ultrasound) fits less."""

ENCAPSULATION = 4
"""Bytes before the first field; alignment counts from their end."""

_TEXT = 12
"""Offset of the characters of the frame id, after seconds, nanoseconds and its length."""

_HEAD = ENCAPSULATION + _TEXT
_LITTLE_ENDIAN = 1
_BYTE_ORDER_AND_ALIGNMENT = {0: ('>', 8), 1: ('<', 8), 6: ('>', 4), 7: ('<', 4)}
"""Byte order and alignment of a double, by representation identifier."""

MAX_FRAME_IDS = 100
"""Largest number of different lengths of frame ids in a block; a topic of the rig has one."""

TOO_MANY_NANOSECONDS = 'a stamp has a second or more of nanoseconds'


class CdrError(ValueError):
    """The bytes are not the expected message; the text states the reason."""


class McapChannel(NamedTuple):
    """A topic as the file declares it; definition: of the message type, as the file holds it."""

    topic: str
    type: str
    encoding: str
    schema_encoding: str
    definition: bytes = b''


@dataclass(frozen=True)
class Messages:
    """Messages of one channel in a block: where each begins, its size, and its log time [ns]."""

    starts: NDArray[np.int64]
    sizes: NDArray[np.int64]
    log_times: NDArray[np.int64]

    def __len__(self) -> int:
        return len(self.starts)


@dataclass(frozen=True)
class Records:
    """Messages of one type: stamps (N,) [ns], the wanted fields (N,) by name, first frame id."""

    stamps: NDArray[np.int64]
    fields: dict[str, NDArray[Any]]
    frame_id: str

    def __len__(self) -> int:
        return len(self.stamps)


def take(data: NDArray[np.uint8], starts: NDArray[np.int64], dtype: DTypeLike) -> NDArray[Any]:
    """Numbers or records of `dtype` at each of `starts` (N,); IndexError beyond the data."""
    kind = np.dtype(dtype)
    anywhere: NDArray[Any] = np.ndarray(
        (max(len(data) - kind.itemsize + 1, 0),), kind, data, strides=(1,))
    return anywhere[starts]


def decode_list(messages: Sequence[bytes], message_type: str, names: Sequence[str]) -> Records:
    """Read messages that are separate in memory."""
    wanted, lengths, joined = tuple(names), set(map(len, messages)), b''.join(messages)
    if len(lengths) == 1 and (size := lengths.pop()) >= _HEAD:  # the usual case, without a copy
        layout = _layout(message_type, *_head_of(joined), wanted)
        if size >= layout.itemsize:
            view: NDArray[Any] = np.ndarray((len(messages),), layout, joined, strides=(size,))
            if records := _alike(view, joined, wanted):
                return records
    sizes = np.fromiter(map(len, messages), np.int64, len(messages))
    data = np.frombuffer(joined, np.uint8)
    return decode_records(data, np.cumsum(sizes) - sizes, sizes, message_type, wanted)


def decode_records(data: NDArray[np.uint8], starts: NDArray[np.int64], sizes: NDArray[np.int64],
                   message_type: str, names: tuple[str, ...]) -> Records:
    """The fields `names` of the messages of `message_type` at `starts` (N,) in `data`.

    Messages of one representation and frame id, the usual case, are read at once. CdrError for
    other bytes.
    """
    kinds = dict(LAYOUTS[message_type])
    if not len(starts):
        return Records(np.empty(0, np.int64), {
            name: np.empty(0, kinds[name]) for name in names}, '')
    if (sizes < _HEAD).any():
        raise CdrError('a message is shorter than its header')
    first = data[starts[0]:starts[0] + sizes[0]].tobytes()
    layout = _layout(message_type, *_head_of(first), names)
    is_whole = (sizes >= layout.itemsize).all()
    if is_whole and (records := _alike(take(data, starts, layout), first, names)):
        return records
    stamps = np.empty(len(starts), np.int64)
    fields = {name: np.empty(len(starts), kinds[name]) for name in names}
    kinds_there = np.unique(data[starts].astype(np.int64) << 8 | data[starts + 1]).tolist()
    if unknown := set(kinds_there) - set(_BYTE_ORDER_AND_ALIGNMENT):
        raise CdrError(f'CDR representation {min(unknown):#06x} is not supported')
    groups: dict[tuple[int, int], list[int]] = {}
    for row, start in enumerate(starts.tolist()):
        groups.setdefault(_head_of(data[start:start + _HEAD].tobytes()), []).append(row)
    if len(groups) > MAX_FRAME_IDS:
        raise CdrError('the frame id is another in every message')
    for (kind, length), which in groups.items():
        layout = _layout(message_type, kind, length, names)
        if (sizes[which] < layout.itemsize).any():
            raise CdrError(f'a message is shorter than a {message_type}')
        of_kind = take(data, starts[which], layout)
        stamps[which] = _stamps_of(of_kind)
        for name in names:
            fields[name][which] = of_kind[name]
    return Records(stamps, fields, _frame_id(first, _head_of(first)[1]))


def _alike(records: NDArray[Any], first: bytes, names: tuple[str, ...]) -> Records | None:
    """Records (N,) with the representation and frame id of the `first` message; None if not."""
    kind, length = _head_of(first)
    if (records['kind'] != kind).any() or (records['length'] != length).any():
        return None
    return Records(_stamps_of(records), {name: records[name] for name in names},
                   _frame_id(first, length))


def _frame_id(message: bytes, length: int) -> str:
    return message[_HEAD:_HEAD + length].rstrip(b'\0').decode('utf-8', 'replace')


def _head_of(message: bytes) -> tuple[int, int]:
    """Representation, and length of the frame id, of a message."""
    kind = message[0] << 8 | message[1]
    if kind not in _BYTE_ORDER_AND_ALIGNMENT:
        raise CdrError(f'CDR representation {kind:#06x} is not supported')
    order = _BYTE_ORDER_AND_ALIGNMENT[kind][0]
    return kind, struct.unpack_from(f'{order}I', message, ENCAPSULATION + 8)[0]


def _stamps_of(records: NDArray[Any]) -> NDArray[np.int64]:
    """Stamps (N,) [ns] of records."""
    if (records['nanosec'] >= SECOND).any():
        raise CdrError(TOO_MANY_NANOSECONDS)
    return np.asarray(records['sec'].astype(np.int64) * SECOND + records['nanosec'])


@functools.lru_cache(maxsize=256)
def _layout(message_type: str, kind: int, length: int, names: tuple[str, ...]) -> np.dtype[Any]:
    """The layout of a message with a frame id of `length` bytes, up to the last of `names`."""
    if length > 1 << 24:
        raise CdrError('the frame id is longer than any message')
    order, alignment = _BYTE_ORDER_AND_ALIGNMENT[kind]
    fields = {'kind': (0, '>u2'), 'sec': (ENCAPSULATION, f'{order}i4'),
              'nanosec': (ENCAPSULATION + 4, f'{order}u4'),
              'length': (ENCAPSULATION + 8, f'{order}u4')}
    place, size = _TEXT + length, _HEAD + length
    for name, number in LAYOUTS[message_type]:
        width = int(number[1])
        place += -place % min(width, alignment)
        if name in names:
            fields[name] = (ENCAPSULATION + place, f'{order}{number}')
            size = ENCAPSULATION + place + width
        place += width
    return np.dtype({'names': list(fields), 'formats': [kind for _, kind in fields.values()],
                     'offsets': [offset for offset, _ in fields.values()], 'itemsize': size})


def encode(message_type: str, frame_id: str, stamps: ArrayLike,
           fields: Mapping[str, ArrayLike]) -> NDArray[np.uint8]:
    """Messages of `message_type` as bytes, one row each (N, size)."""
    stamps = np.asarray(stamps, dtype=np.int64)
    text = frame_id.encode() + b'\0'
    names = tuple(name for name, _ in LAYOUTS[message_type])
    layout = _layout(message_type, _LITTLE_ENDIAN, len(text), names)
    raw = np.zeros((len(stamps), layout.itemsize), np.uint8)
    raw[:, _HEAD:_HEAD + len(text)] = np.frombuffer(text, np.uint8)
    records = raw.view(layout)[:, 0]
    records['kind'], records['length'] = _LITTLE_ENDIAN, len(text)
    records['sec'], records['nanosec'] = np.divmod(stamps, SECOND)
    for name, values in {**DEFAULTS.get(message_type, {}), **fields}.items():
        records[name] = values
    return raw


def encode_list(message_type: str, frame_id: str, stamps: ArrayLike,
                fields: Mapping[str, ArrayLike]) -> list[bytes]:
    """`encode` with each message separate."""
    raw = encode(message_type, frame_id, stamps, fields)
    size, data = raw.shape[1], raw.tobytes()
    return [data[start:start + size] for start in range(0, len(data), size)]


COVARIANCE_BYTES = 128  # 16 doubles, the last field


def decode_samples(messages: Sequence[bytes], topic: RigTopic) -> Samples:
    """Readings of a topic of the rig, with the range that the last message states."""
    if not messages:
        return batches.no_samples()
    records = decode_list(messages, topic.type, topic.fields)
    values = records.fields[topic.field].astype(np.float64)
    if not topic.low:
        return Samples(records.stamps, values)
    low, high = (float(records.fields[name][-1]) for name in (topic.low, topic.high))
    return Samples(records.stamps, values, low, high)


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
        return batches.no_displacements()
    records = decode_list(messages, DISPLACEMENT_TYPE, (
        *CHANNELS, 'zero_stamp.sec', 'zero_stamp.nanosec', 'zero_load', 'elevation', 'validity',
        'zero_duration'))
    fields = records.fields
    zero = fields['zero_stamp.sec'].astype(np.int64) * SECOND + fields['zero_stamp.nanosec']
    return Displacements(
        records.stamps, np.array([fields[name] for name in CHANNELS], np.float64),
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


def decode_time(message: bytes) -> int:
    """The time [ns] that a message begins with: a Clock, or one with a header."""
    if len(message) < 12:
        raise CdrError('a message is shorter than its time')
    second, nanosecond = struct.unpack_from('<iI', message, 4)
    return int(second) * SECOND + int(nanosecond)


def encode_clock(now: int) -> bytes:
    """A rosgraph_msgs/Clock message of the time `now` [ns]."""
    return b'\x00\x01\x00\x00' + struct.pack('<iI', *divmod(now, SECOND))
