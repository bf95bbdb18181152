"""Stamps and readings taken straight from the CDR bytes of the rig's two message types.

A numpy view: all messages of a block at once, no message object is ever made. Source of the
layout: OMG DDS-XTypes 1.3, 7.4 (plain CDR, versions 1 and 2, both byte orders) and the message
definitions of geometry_msgs and sensor_msgs.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from saddlering_ros.bags.mcap_file import Messages, take
from saddlering_ros.bags.topics import WRENCH_TYPE

ENCAPSULATION = 4
"""Bytes before the first field; alignment counts from behind them."""

_TEXT = 12
"""Where the frame id's characters begin, behind seconds, nanoseconds and its length."""

_BYTE_ORDER_AND_ALIGNMENT = {0: ('>', 8), 1: ('<', 8), 6: ('>', 4), 7: ('<', 4)}
"""By representation identifier: byte order, and the alignment of a double."""


MOST_FRAME_IDS = 100
"""Lengths of frame ids in one block; a topic of the rig has one."""


class CdrError(ValueError):
    """Bytes that are not the message they should be; the message says why."""


@dataclass(frozen=True)
class Readings:
    """What a run of messages of one topic says.

    stamps (N,) [ns]; values (N,): force.x [N] or range [m]; spans (N, 2): min_range and max_range
    [m] of a Range, empty (N, 0) of a WrenchStamped; frame_id of the first message.
    """

    stamps: NDArray[np.int64]
    values: NDArray[np.float64]
    spans: NDArray[np.float64]
    frame_id: str


def decode(data: NDArray[np.uint8], messages: Messages, message_type: str) -> Readings:
    """Read all `messages` of the rig's `message_type` that lie in `data`."""
    if not len(messages):
        width = 0 if message_type == WRENCH_TYPE else 2
        return Readings(np.empty(0, np.int64), np.empty(0), np.empty((0, width)), '')
    starts, sizes = messages.starts, messages.sizes
    if (sizes < ENCAPSULATION + _TEXT).any():
        raise CdrError('a message is shorter than its header')
    kinds = data[starts].astype(np.int64) << 8 | data[starts + 1]
    unknown = set(np.unique(kinds).tolist()) - set(_BYTE_ORDER_AND_ALIGNMENT)
    if unknown:
        raise CdrError(f'CDR representation {min(unknown):#06x} is not supported')
    orders = [kind for kind in _BYTE_ORDER_AND_ALIGNMENT if (kinds == kind).any()]
    return _merge(len(starts), [
        part for kind in orders
        for part in _decode_kind(data, starts, sizes, np.flatnonzero(kinds == kind), kind,
                                 message_type)
    ])


def _decode_kind(
    data: NDArray[np.uint8], starts: NDArray[np.int64], sizes: NDArray[np.int64],
    which: NDArray[np.int64], kind: int, message_type: str,
) -> list[tuple[NDArray[np.int64], Readings]]:
    """Decode the messages `which` of one representation, by the length of their frame id."""
    order, alignment = _BYTE_ORDER_AND_ALIGNMENT[kind]
    body = starts[which] + ENCAPSULATION
    lengths = take(data, body + 8, f'{order}u4').astype(np.int64)
    parts = []
    different = np.unique(lengths).tolist()
    if len(different) > MOST_FRAME_IDS:
        raise CdrError('the frame id is another in every message')
    for length in different:
        mine = lengths == length
        parts.append((which[mine], _decode_group(
            data, body[mine], sizes[which[mine]] - ENCAPSULATION, length, order, alignment,
            message_type)))
    return parts


def _decode_group(
    data: NDArray[np.uint8], body: NDArray[np.int64], sizes: NDArray[np.int64], length: int,
    order: str, alignment: int, message_type: str,
) -> Readings:
    end = _TEXT + length
    if message_type == WRENCH_TYPE:
        value = _aligned(end, alignment)
        needed, first_span = value + 8, None
    else:
        first_span = _aligned(end + 1, 4) + 4
        value = first_span + 8
        needed = value + 4
    if (sizes < needed).any():
        raise CdrError(f'a message is shorter than a {message_type}')
    nanoseconds = take(data, body + 4, f'{order}u4').astype(np.int64)
    if (nanoseconds >= 1_000_000_000).any():
        raise CdrError('a stamp has a second or more of nanoseconds')
    stamps = take(data, body, f'{order}i4').astype(np.int64) * 1_000_000_000 + nanoseconds
    if first_span is None:
        values = take(data, body + value, f'{order}f8').astype(np.float64)
        spans = np.empty((len(body), 0))
    else:
        values = take(data, body + value, f'{order}f4').astype(np.float64)
        spans = np.stack([
            take(data, body + first_span + offset, f'{order}f4').astype(np.float64)
            for offset in (0, 4)], axis=1)
    name = data[body[0] + _TEXT:body[0] + end].tobytes().rstrip(b'\0')
    return Readings(stamps, values, spans, name.decode('utf-8', 'replace'))


def _merge(count: int, parts: list[tuple[NDArray[np.int64], Readings]]) -> Readings:
    if len(parts) == 1:
        return parts[0][1]
    stamps, values = np.empty(count, np.int64), np.empty(count)
    spans = np.empty((count, parts[0][1].spans.shape[1]))
    for which, readings in parts:
        stamps[which], values[which] = readings.stamps, readings.values
        spans[which] = readings.spans
    first = min(parts, key=lambda part: int(part[0][0]))
    return Readings(stamps, values, spans, first[1].frame_id)


def _aligned(position: int, alignment: int) -> int:
    return -(-position // alignment) * alignment
