"""Messages of the rig's topics as bytes, written field by field and not by the package."""

import struct

from saddlering_ros.record.topics import LOAD_TOPIC, TOPICS

SPAN = (0.0, 2e-3)


def cdr(topic: str, stamp: int, value: float, *, big: bool = False, version: int = 1,
        frame: str | None = None, span: tuple[float, float] = SPAN) -> bytes:
    """One message of a rig topic, written field by field."""
    order = '>' if big else '<'
    frame_id = (TOPICS[topic].frame_id if frame is None else frame).encode() + b'\0'
    body = struct.pack(f'{order}iII', stamp // 10 ** 9, stamp % 10 ** 9, len(frame_id)) + frame_id
    if topic == LOAD_TOPIC:
        body += bytes(-len(body) % (8 if version == 1 else 4))
        body += struct.pack(f'{order}6d', value, 0, 0, 0, 0, 0)
    else:
        body += b'\1'
        body += bytes(-len(body) % 4) + struct.pack(f'{order}5f', 0, *span, value, 0)
    kind = {1: 0, 2: 6}[version] + (0 if big else 1)
    return bytes([0, kind, 0, 0]) + body
