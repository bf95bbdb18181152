"""Messages of the five raw topics and of ring displacements, to and from CDR bytes, in batches.

At 1 kHz per topic a Python message object per sample costs more than all the mechanics. A batch of
messages of one layout is one numpy view here. Source of the layout: OMG DDS-XTypes 1.3, 7.4
(plain CDR version 1, little endian, what every ROS 2 middleware writes on such machines).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
import struct
from typing import Any

import numpy as np
from numpy.typing import NDArray

Stamps = NDArray[np.int64]
Floats = NDArray[np.float64]

LITTLE_ENDIAN = b'\x00\x01\x00\x00'
SECOND = 1_000_000_000
_HEADER = struct.Struct('<4siII')


class WireError(ValueError):
    """Bytes that are not the message they should be."""


@dataclass(frozen=True)
class Samples:
    """Readings of one topic: stamps (N,) [ns], values (N,), the ends of its range (or NaN)."""

    stamps: Stamps
    values: Floats
    low: float = float('nan')
    high: float = float('nan')

    def __len__(self) -> int:
        return len(self.stamps)


@dataclass(frozen=True)
class Displacements:
    """A batch of ring displacements.

    stamps (N,) [ns]; channels (4, N): delta_x, delta_y [m], gamma [rad], parity [m];
    zero_stamps (N,) [ns] and zero_loads (N,) [N] say from which zero they count.
    """

    stamps: Stamps
    channels: Floats
    zero_stamps: Stamps
    zero_loads: Floats

    def __len__(self) -> int:
        return len(self.stamps)


def no_displacements() -> Displacements:
    """An empty batch."""
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
        np.concatenate([batch.zero_loads for batch in batches]))


def _align(position: int, size: int) -> int:
    return -(-position // size) * size


def _layout(frame_length: int, fields: Sequence[tuple[str, str]]) -> np.dtype[Any]:
    """The dtype of a message: encapsulation, stamp, frame id of `frame_length` bytes, `fields`."""
    names, formats, offsets = ['sec', 'nanosec', 'length'], ['<i4', '<u4', '<u4'], [4, 8, 12]
    place = 12 + frame_length
    for name, kind in fields:
        size = np.dtype(kind).itemsize
        place = _align(place, size)
        names.append(name)
        formats.append(kind)
        offsets.append(4 + place)
        place += size
    return np.dtype({'names': names, 'formats': formats, 'offsets': offsets,
                     'itemsize': 4 + place})


_WRENCH = [(name, '<f8') for name in ('value', 'fy', 'fz', 'tx', 'ty', 'tz')]
_RANGE = [('kind', 'u1'), ('view', '<f4'), ('low', '<f4'), ('high', '<f4'), ('value', '<f4')]
_RANGE_WITH_VARIANCE = [*_RANGE, ('variance', '<f4')]
_DISPLACEMENT = [
    ('delta_x', '<f8'), ('delta_y', '<f8'), ('gamma', '<f8'), ('parity', '<f8'),
    ('zero_sec', '<i4'), ('zero_nanosec', '<u4'), ('zero_load', '<f8')]

_layouts: dict[tuple[str, int], np.dtype[Any]] = {}
_FIELDS = {'wrench': _WRENCH, 'range': _RANGE, 'range+': _RANGE_WITH_VARIANCE,
           'displacement': _DISPLACEMENT}


def layout(kind: str, frame_length: int) -> np.dtype[Any]:
    """The (cached) layout of a `kind` of message whose frame id takes `frame_length` bytes."""
    key = (kind, frame_length)
    if key not in _layouts:
        _layouts[key] = _layout(frame_length, _FIELDS[kind])
    return _layouts[key]


def _records(messages: Sequence[bytes], kind: str) -> list[NDArray[Any]]:
    """Runs of messages of equal layout, in order, as structured arrays.

    Raises WireError for bytes of another type or byte order.
    """
    runs: list[NDArray[Any]] = []
    start = 0
    while start < len(messages):
        first = messages[start]
        size = len(first)
        stop = start + 1
        while stop < len(messages) and len(messages[stop]) == size:
            stop += 1
        runs.append(_run(messages[start:stop], first, kind))
        start = stop
    return runs


def _run(messages: Sequence[bytes], first: bytes, kind: str) -> NDArray[Any]:
    if len(first) < _HEADER.size:
        raise WireError('shorter than a message header')
    start, _, _, length = _HEADER.unpack_from(first)
    if start[:2] != LITTLE_ENDIAN[:2]:
        raise WireError(f'CDR representation {start[:2].hex()} is not supported')
    if length > len(first):
        raise WireError('frame id longer than the message')
    shape = layout(kind, length)
    size = len(first)
    if size < shape.itemsize:
        raise WireError(f'{size} bytes, too short for a {kind}')
    raw = np.frombuffer(b''.join(messages), np.uint8).reshape(len(messages), size)
    records = np.ascontiguousarray(raw[:, :shape.itemsize]).view(shape)[:, 0]
    if (records['length'] != length).any():
        return np.concatenate([_run([message], message, kind) for message in messages])
    return records


def _stamps_of(records: NDArray[Any]) -> Stamps:
    stamps: Stamps = records['sec'].astype(np.int64) * SECOND + records['nanosec']
    return stamps


def _one(parts: list[NDArray[Any]]) -> NDArray[Any]:
    return parts[0] if len(parts) == 1 else np.concatenate(parts)


def decode_loads(messages: Sequence[bytes]) -> Samples:
    """Cylinder loads from geometry_msgs/WrenchStamped messages."""
    if not messages:
        return Samples(np.empty(0, np.int64), np.empty(0))
    runs = _records(messages, 'wrench')
    return Samples(_one([_stamps_of(run) for run in runs]),
                   _one([run['value'].astype(np.float64) for run in runs]))


def decode_gaps(messages: Sequence[bytes]) -> Samples:
    """Probe gaps from sensor_msgs/Range messages, with the range the last of them states."""
    if not messages:
        return Samples(np.empty(0, np.int64), np.empty(0))
    runs = _records(messages, 'range')
    last = runs[-1][-1]
    return Samples(_one([_stamps_of(run) for run in runs]),
                   _one([run['value'].astype(np.float64) for run in runs]),
                   float(last['low']), float(last['high']))


def decode_displacements(messages: Sequence[bytes]) -> Displacements:
    """A batch from saddlering_interfaces/RingDisplacement messages."""
    if not messages:
        return no_displacements()
    runs = _records(messages, 'displacement')
    batches = []
    for run in runs:
        channels = np.stack([run[name] for name in ('delta_x', 'delta_y', 'gamma', 'parity')])
        zero = run['zero_sec'].astype(np.int64) * SECOND + run['zero_nanosec']
        batches.append(Displacements(_stamps_of(run), channels.astype(np.float64), zero,
                                     run['zero_load'].astype(np.float64)))
    return join(batches)


def decode_clock(message: bytes) -> int:
    """The time [ns] of a rosgraph_msgs/Clock message."""
    second, nanosecond = struct.unpack_from('<iI', message, 4)
    return int(second) * SECOND + int(nanosecond)


def _blank(kind: str, frame_id: str, stamps: Stamps) -> NDArray[Any]:
    """Records of `kind` with encapsulation, stamps and frame id filled in."""
    text = frame_id.encode() + b'\0'
    shape = layout(kind, len(text))
    raw = np.zeros((len(stamps), shape.itemsize), np.uint8)
    raw[:, :4] = np.frombuffer(LITTLE_ENDIAN, np.uint8)
    raw[:, 16:16 + len(text)] = np.frombuffer(text, np.uint8)
    records = raw.view(shape)[:, 0]
    records['sec'], records['nanosec'] = np.divmod(stamps, SECOND)
    records['length'] = len(text)
    return records


def _messages(records: NDArray[Any]) -> list[bytes]:
    size = records.dtype.itemsize
    data = records.tobytes()
    return [data[start:start + size] for start in range(0, len(data), size)]


def encode_loads(samples: Samples, frame_id: str) -> list[bytes]:
    """geometry_msgs/WrenchStamped messages with force.x of `samples`."""
    records = _blank('wrench', frame_id, samples.stamps)
    records['value'] = samples.values
    return _messages(records)


def encode_gaps(samples: Samples, frame_id: str) -> list[bytes]:
    """sensor_msgs/Range messages (with `variance`, as in Jazzy) with range of `samples`."""
    records = _blank('range+', frame_id, samples.stamps)
    records['value'], records['low'], records['high'] = samples.values, samples.low, samples.high
    return _messages(records)


def encode_displacements(batch: Displacements, frame_id: str) -> list[bytes]:
    """saddlering_interfaces/RingDisplacement messages of `batch`."""
    records = _blank('displacement', frame_id, batch.stamps)
    for name, channel in zip(('delta_x', 'delta_y', 'gamma', 'parity'), batch.channels,
                             strict=True):
        records[name] = channel
    records['zero_sec'], records['zero_nanosec'] = np.divmod(batch.zero_stamps, SECOND)
    records['zero_load'] = batch.zero_loads
    return _messages(records)
