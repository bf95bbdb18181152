"""MCAP files written from blocks of equal messages; NumPy builds each chunk.

Source of the format: the MCAP specification (https://mcap.dev/spec). The mcap package writes the
records of which a file has few. This module writes messages and their index, of which a file has
millions. The files have chunks compressed with zstd, checksums, message indices and a summary.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
import struct
from typing import BinaryIO
import zlib

from mcap.data_stream import RecordBuilder
from mcap.opcode import Opcode
from mcap.records import (
    Channel,
    ChunkIndex,
    DataEnd,
    Footer,
    Header,
    McapRecord,
    Metadata,
    MetadataIndex,
    Schema,
    Statistics,
    SummaryOffset,
)
import numpy as np
from numpy.typing import NDArray
import zstandard

from saddlering_ros.bags.mcap_file import MAGIC, MESSAGE, MESSAGE_HEAD, RECORD_HEAD

_INDEX_ENTRY = np.dtype([('log_time', '<u8'), ('offset', '<u8')])
_MESSAGE_RECORD = np.dtype([
    ('opcode', 'u1'), ('length', '<u8'), ('channel', '<u2'), ('sequence', '<u4'),
    ('log_time', '<u8'), ('publish_time', '<u8')])


@dataclass(frozen=True)
class MessageBlock:
    """Messages of one channel: log times (N,) int64 [ns], their bytes, one row each (N, size)."""

    channel: int
    log_times: NDArray[np.int64]
    messages: NDArray[np.uint8]

    def __len__(self) -> int:
        return len(self.log_times)


def record_size(messages: NDArray[np.uint8]) -> int:
    """Bytes of the record of each of `messages` (N, size) in a chunk."""
    return RECORD_HEAD + MESSAGE_HEAD + int(messages.shape[1])


class McapBlockFile:
    """One MCAP file that is being written: schemas, channels, metadata, blocks, then a summary."""

    def __init__(self, path: Path, library: str) -> None:
        self._file: BinaryIO = path.open('xb')
        self._compressor = zstandard.ZstdCompressor()
        self._schemas: list[Schema] = []
        self._channels: list[Channel] = []
        self._metadata: list[MetadataIndex] = []
        self._chunks: list[ChunkIndex] = []
        self._counts: dict[int, int] = {}
        self._first, self._last = 1 << 63, 0
        self._file.write(MAGIC)
        self._write(Header(profile='ros2', library=library))

    def add_schema(self, name: str, encoding: str, data: bytes) -> int:
        """Declare a message type; returns its id."""
        self._schemas.append(Schema(
            id=len(self._schemas) + 1, name=name, encoding=encoding, data=data))
        self._write(self._schemas[-1])
        return len(self._schemas)

    def add_channel(self, topic: str, schema: int, metadata: Mapping[str, str]) -> int:
        """Declare a topic; returns its id."""
        self._channels.append(Channel(
            id=len(self._channels) + 1, topic=topic, message_encoding='cdr',
            metadata=dict(metadata), schema_id=schema))
        self._write(self._channels[-1])
        return len(self._channels)

    def add_metadata(self, name: str, data: Mapping[str, str]) -> None:
        """Write a metadata record."""
        offset = self._file.tell()
        length = self._write(Metadata(name=name, metadata=dict(data)))
        self._metadata.append(MetadataIndex(offset=offset, length=length, name=name))

    def add_chunk(self, blocks: Sequence[MessageBlock]) -> None:
        """Write the messages of all blocks, in order of their log times, as one chunk."""
        blocks = [block for block in blocks if len(block)]
        if not blocks:
            return
        data, offsets = _interleave(blocks)
        for block in blocks:
            self._counts[block.channel] = self._counts.get(block.channel, 0) + len(block)
        first = min(int(block.log_times.min()) for block in blocks)
        last = max(int(block.log_times.max()) for block in blocks)
        packed = self._compressor.compress(data)
        start = self._file.tell()
        head = struct.pack('<QQQI', first, last, len(data), zlib.crc32(data))
        content = head + _text('zstd') + struct.pack('<Q', len(packed))
        self._raw(Opcode.CHUNK, content, packed)
        length = self._file.tell() - start
        places = {}
        for block, offset in zip(blocks, offsets, strict=True):
            places[block.channel] = self._file.tell()
            self._raw(Opcode.MESSAGE_INDEX, _index(block, offset))
        self._chunks.append(ChunkIndex(
            message_start_time=first, message_end_time=last, chunk_start_offset=start,
            chunk_length=length, message_index_offsets=places,
            message_index_length=self._file.tell() - start - length, compression='zstd',
            compressed_size=len(packed), uncompressed_size=len(data)))
        self._first, self._last = min(self._first, first), max(self._last, last)

    def finish(self) -> None:
        """Write the summary and close the file."""
        self._write(DataEnd(0))
        start = self._file.tell()
        statistics = Statistics(
            attachment_count=0, channel_count=len(self._channels),
            channel_message_counts=self._counts, chunk_count=len(self._chunks),
            message_count=sum(self._counts.values()), metadata_count=len(self._metadata),
            message_start_time=self._first if self._chunks else 0, message_end_time=self._last,
            schema_count=len(self._schemas))
        groups: list[tuple[Opcode, Sequence[McapRecord]]] = [
            (Opcode.SCHEMA, self._schemas), (Opcode.CHANNEL, self._channels),
            (Opcode.STATISTICS, [statistics]), (Opcode.CHUNK_INDEX, self._chunks),
            (Opcode.METADATA_INDEX, self._metadata)]
        summary = RecordBuilder()
        places = []
        for opcode, records in groups:
            begin = summary.count
            for record in records:
                record.write(summary)
            places.append(SummaryOffset(group_opcode=opcode, group_start=start + begin,
                                        group_length=summary.count - begin))
        offsets_start = start + summary.count
        for place in places:
            place.write(summary)
        data = bytes(summary.end())
        foot = struct.pack('<BQQQ', Opcode.FOOTER, 20, start, offsets_start)
        self._file.write(data)
        self._write(Footer(summary_start=start, summary_offset_start=offsets_start,
                           summary_crc=zlib.crc32(foot, zlib.crc32(data))))
        self._file.write(MAGIC)
        self._file.close()

    def abort(self) -> None:
        """Close the file without a summary."""
        self._file.close()

    def _write(self, record: McapRecord) -> int:
        builder = RecordBuilder()
        record.write(builder)
        return self._file.write(builder.end())

    def _raw(self, opcode: int, *parts: bytes) -> None:
        self._file.write(struct.pack('<BQ', opcode, sum(map(len, parts))))
        for part in parts:
            self._file.write(part)


def _text(text: str) -> bytes:
    return struct.pack('<I', len(text)) + text.encode()


def _index(block: MessageBlock, offsets: NDArray[np.int64]) -> bytes:
    entries = np.empty(len(block), dtype=_INDEX_ENTRY)
    entries['log_time'], entries['offset'] = block.log_times, offsets
    return struct.pack('<HI', block.channel, entries.nbytes) + entries.tobytes()


def _interleave(
    blocks: Sequence[MessageBlock],
) -> tuple[bytes, list[NDArray[np.int64]]]:
    """The message records of all blocks by log time, and the start of each block's records."""
    times = np.concatenate([block.log_times for block in blocks])
    sizes = np.concatenate([
        np.full(len(block), record_size(block.messages)) for block in blocks])
    order = np.argsort(times, kind='stable')
    ends = np.cumsum(sizes[order])
    starts = np.empty(len(times), dtype=np.int64)
    starts[order] = ends - sizes[order]
    records = [record for block in blocks for record in _records(block)]
    limits = np.cumsum([len(block) for block in blocks])[:-1]
    return b''.join([records[place] for place in order.tolist()]), np.split(starts, limits)


def _records(block: MessageBlock) -> list[bytes]:
    """The block's message records, each as bytes; without sequence numbers."""
    head = np.zeros(len(block), dtype=_MESSAGE_RECORD)
    head['opcode'] = MESSAGE
    head['length'] = MESSAGE_HEAD + block.messages.shape[1]
    head['channel'] = block.channel
    head['log_time'] = head['publish_time'] = block.log_times
    rows = np.hstack([head.view(np.uint8).reshape(len(block), -1), block.messages])
    size, data = rows.shape[1], rows.tobytes()
    return [data[start:start + size] for start in range(0, len(data), size)]
