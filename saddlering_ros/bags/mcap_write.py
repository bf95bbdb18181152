"""MCAP files as they are written: chunks compressed with zstd, checksums, indices, a summary.

Source of the format: the MCAP specification (https://mcap.dev/spec). The mcap package writes the
records of which a file has few. Messages and their index, of which a file has millions, are
written here, because NumPy builds a chunk of equal messages about thirty times as fast.
"""

from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
import struct
from typing import BinaryIO
import zlib

from mcap import records
from mcap.data_stream import RecordBuilder
from mcap.opcode import Opcode
import numpy as np
from numpy.typing import NDArray
import zstandard

from saddlering_ros.bags.mcap_read import INDEX_ENTRY, MAGIC, MESSAGE, MESSAGE_HEAD, RECORD_HEAD

_MESSAGE_HEAD = struct.Struct('<BQHIQQ')
_INDEX_HEAD = struct.Struct('<BQHI')
_MESSAGE_RECORD = np.dtype([
    ('opcode', 'u1'), ('length', '<u8'), ('channel', '<u2'), ('sequence', '<u4'),
    ('log_time', '<u8'), ('publish_time', '<u8')])


@dataclass(frozen=True)
class MessageBlock:
    """Messages of one topic: log times (N,) int64 [ns], their bytes, one row each (N, size)."""

    topic: str
    log_times: NDArray[np.int64]
    messages: NDArray[np.uint8]

    def __len__(self) -> int:
        return len(self.log_times)


class McapWriter:
    """One MCAP file that is being written: topics, metadata, messages, then a summary.

    Single messages are gathered into chunks of `chunk_size` bytes.
    """

    def __init__(self, path: Path, library: str, chunk_size: int) -> None:
        self._file: BinaryIO = path.open('xb')
        self._chunk_size = chunk_size
        self._compressor = zstandard.ZstdCompressor()
        self._schemas: dict[str, records.Schema] = {}
        self._channels: dict[str, records.Channel] = {}
        self._metadata: list[records.MetadataIndex] = []
        self._chunks: list[records.ChunkIndex] = []
        self._counts: dict[int, int] = {}
        self._gathered = bytearray()
        self._gathered_index: dict[int, list[tuple[int, int]]] = {}
        self._file.write(MAGIC)
        self._write(records.Header(profile='ros2', library=library))

    def add_topic(
        self, topic: str, kind: str, definition: str, metadata: Mapping[str, str],
    ) -> None:
        """Declare a topic of messages of type `kind` ('package/msg/Name')."""
        if kind not in self._schemas:
            self._schemas[kind] = records.Schema(id=len(self._schemas) + 1, name=kind,
                                                 encoding='ros2msg', data=definition.encode())
            self._write(self._schemas[kind])
        self._channels[topic] = records.Channel(
            id=len(self._channels) + 1, topic=topic, message_encoding='cdr',
            metadata=dict(metadata), schema_id=self._schemas[kind].id)
        self._write(self._channels[topic])

    def add_metadata(self, name: str, data: Mapping[str, str]) -> None:
        """Write a metadata record."""
        offset = self._file.tell()
        length = self._write(records.Metadata(name=name, metadata=dict(data)))
        self._metadata.append(records.MetadataIndex(offset=offset, length=length, name=name))

    def add_message(self, topic: str, log_time: int, message: bytes) -> None:
        """Add one message to the chunk that is being gathered; write the chunk if it is full."""
        channel = self._channels[topic].id
        self._gathered_index.setdefault(channel, []).append((log_time, len(self._gathered)))
        self._gathered += _MESSAGE_HEAD.pack(
            MESSAGE, MESSAGE_HEAD + len(message), channel, 0, log_time, log_time)
        self._gathered += message
        if len(self._gathered) >= self._chunk_size:
            self._write_gathered()

    def _write_gathered(self) -> None:
        if self._gathered:
            self._write_chunk(bytes(self._gathered), {
                channel: np.array(entries, dtype=INDEX_ENTRY)
                for channel, entries in self._gathered_index.items()})
            self._file.flush()
        self._gathered.clear()
        self._gathered_index.clear()

    def add_blocks(self, blocks: Sequence[MessageBlock]) -> None:
        """Write the messages of blocks, none of them empty, by log time, chunk by chunk."""
        which = np.repeat(np.arange(len(blocks)), [len(block) for block in blocks])
        rows = np.concatenate([np.arange(len(block)) for block in blocks])
        order = np.argsort(np.concatenate([block.log_times for block in blocks]), kind='stable')
        sizes = np.array([RECORD_HEAD + MESSAGE_HEAD + block.messages.shape[1]
                          for block in blocks])[which]
        chunk_of = (np.cumsum(sizes[order]) - 1) // self._chunk_size
        for chunk in np.split(order, np.flatnonzero(np.diff(chunk_of)) + 1):
            starts = np.cumsum(sizes[chunk]) - sizes[chunk]
            data, index = np.empty(sizes[chunk].sum(), np.uint8), {}
            for number in np.unique(which[chunk]).tolist():
                block, places = blocks[number], np.flatnonzero(which[chunk] == number)
                mine, channel = rows[chunk[places]], self._channels[block.topic].id
                head = np.zeros(len(mine), dtype=_MESSAGE_RECORD)
                head['opcode'], head['channel'] = MESSAGE, channel
                head['length'] = MESSAGE_HEAD + block.messages.shape[1]
                head['log_time'] = head['publish_time'] = block.log_times[mine]
                whole = np.hstack([head.view(np.uint8).reshape(len(mine), -1),
                                      block.messages[mine]])
                kind = np.dtype(f'V{whole.shape[1]}')
                anywhere = np.ndarray((len(data) - kind.itemsize + 1,), kind, data, strides=(1,))
                anywhere[starts[places]] = whole.view(kind)[:, 0]
                index[channel] = np.empty(len(mine), dtype=INDEX_ENTRY)
                index[channel]['log_time'] = block.log_times[mine]
                index[channel]['offset'] = starts[places]
            self._write_chunk(data.tobytes(), index)

    def _write_chunk(self, data: bytes, index: Mapping[int, NDArray[np.void]]) -> None:
        """Write message records and their places: entries (N,) of INDEX_ENTRY by channel."""
        first = min(int(entries['log_time'].min()) for entries in index.values())
        last = max(int(entries['log_time'].max()) for entries in index.values())
        packed = self._compressor.compress(data)
        start = self._file.tell()
        length = self._write(
            records.Chunk('zstd', packed, last, first, zlib.crc32(data), len(data)))
        places = {}
        for channel, entries in index.items():
            self._counts[channel] = self._counts.get(channel, 0) + len(entries)
            places[channel] = self._file.tell()
            self._file.write(_INDEX_HEAD.pack(
                Opcode.MESSAGE_INDEX, 6 + entries.nbytes, channel, entries.nbytes))
            self._file.write(entries.tobytes())
        self._chunks.append(records.ChunkIndex(
            message_start_time=first, message_end_time=last, chunk_start_offset=start,
            chunk_length=length, message_index_offsets=places,
            message_index_length=self._file.tell() - start - length, compression='zstd',
            compressed_size=len(packed), uncompressed_size=len(data)))

    def finish(self, metadata: Mapping[str, Mapping[str, str]]) -> None:
        """Write what was gathered, records of metadata by name, and the summary."""
        self._write_gathered()
        for name, texts in metadata.items():
            self.add_metadata(name, texts)
        self._write(records.DataEnd(0))
        start = self._file.tell()
        statistics = records.Statistics(
            attachment_count=0, channel_count=len(self._channels),
            channel_message_counts=self._counts, chunk_count=len(self._chunks),
            message_count=sum(self._counts.values()), metadata_count=len(self._metadata),
            message_start_time=min((one.message_start_time for one in self._chunks), default=0),
            message_end_time=max((one.message_end_time for one in self._chunks), default=0),
            schema_count=len(self._schemas))
        groups: dict[Opcode, Sequence[records.McapRecord]] = {
            Opcode.SCHEMA: list(self._schemas.values()),
            Opcode.CHANNEL: list(self._channels.values()), Opcode.STATISTICS: [statistics],
            Opcode.CHUNK_INDEX: self._chunks, Opcode.METADATA_INDEX: self._metadata}
        summary = RecordBuilder()
        places = []
        for opcode, group in groups.items():
            begin = summary.count
            for record in group:
                record.write(summary)
            places.append(records.SummaryOffset(group_opcode=opcode, group_start=start + begin,
                                                group_length=summary.count - begin))
        offsets_start = start + summary.count
        for place in places:
            place.write(summary)
        data = bytes(summary.end())
        foot = struct.pack('<BQQQ', Opcode.FOOTER, 20, start, offsets_start)
        self._file.write(data)
        self._write(records.Footer(summary_start=start, summary_offset_start=offsets_start,
                                   summary_crc=zlib.crc32(foot, zlib.crc32(data))))
        self._file.write(MAGIC)
        self._file.close()

    def abort(self) -> None:
        """Close the file without a summary, if it is not closed yet."""
        with suppress(OSError):
            self._file.close()

    def _write(self, record: records.McapRecord) -> int:
        builder = RecordBuilder()
        record.write(builder)
        return self._file.write(builder.end())
