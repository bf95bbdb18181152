"""An MCAP file as blocks of raw messages, read once from front to back, with every fault named.

Source of the format: the MCAP specification (https://mcap.dev/spec). The file is mapped and not
loaded. One decompressed chunk at a time is in memory. Inside a chunk the message index is used if
the file has one that accounts for every byte of the chunk. Otherwise the records are read one by
one. Checksums are verified if the writer stored them. The mcap package reads every message as an
object, and takes a field that ends too early for a shorter one.
"""

from collections.abc import Iterator
from contextlib import suppress
from dataclasses import dataclass, field
from io import BytesIO
import mmap
from pathlib import Path
import struct
import zlib

import lz4.frame  # type: ignore[import-untyped]
from mcap import records
from mcap.data_stream import ReadDataStream
import numpy as np
from numpy.typing import NDArray
import zstandard

from saddlering_ros.bags.wire import McapChannel, Messages, take
from saddlering_ros.errors import BagError

MAGIC = b'\x89MCAP0\r\n'

HEADER, FOOTER, SCHEMA, CHANNEL, MESSAGE, CHUNK, MESSAGE_INDEX = range(1, 8)
STATISTICS, METADATA, DATA_END = 0x0B, 0x0C, 0x0F

RECORD_HEAD = 9
"""Bytes before a record's content: opcode and length."""

MESSAGE_HEAD = 22
"""Bytes of a message record's content before the message itself."""

MAX_CHUNK = 1 << 28
"""Largest stated size [bytes] of a chunk; a larger one is damage."""

MAX_DECLARATIONS = 200_000
"""Largest number of records in a chunk that are no messages; ids have 16 bits."""

BLOCK_MESSAGES = 1 << 16
"""Messages per block of a file without chunks."""

GIVEN_BACK = 1 << 24
"""Bytes of the mapped file that are read before their memory is released."""

_record_head = struct.Struct('<BQ')
_message_head = struct.Struct('<BQHIQ')
INDEX_ENTRY = np.dtype([('log_time', '<u8'), ('offset', '<u8')])


class DamageError(BagError):
    """An MCAP file is damaged at a byte. The data before it were readable."""


class CutOffError(DamageError):
    """The file ends too early. The data before are complete (by their checksums, if any)."""


@dataclass(frozen=True)
class McapBlock:
    """A stretch of the file: its bytes, and the messages in it by channel id, in file order."""

    data: NDArray[np.uint8]
    messages: dict[int, Messages]


@dataclass
class McapFile:
    """One MCAP file, called `name` in messages; `blocks` completes the other fields."""

    path: Path
    name: str
    channels: dict[int, McapChannel] = field(default_factory=dict)
    metadata: dict[str, dict[str, str]] = field(default_factory=dict)
    compressions: set[str] = field(default_factory=set)
    message_count: int = 0
    share: float = 0.0  # of the file's bytes that `blocks` has passed, 0 to 1
    _schemas: dict[int, records.Schema] = field(default_factory=dict)

    def blocks(self) -> Iterator[McapBlock]:
        """Yield blocks of messages; DamageError or CutOffError behind the last good one."""
        try:
            with self.path.open('rb') as file:
                buffer = mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ)
        except ValueError as problem:
            raise DamageError(
                f'{self.name}: the file is empty: record or copy it again') from problem
        except OSError as problem:
            raise BagError(
                f'{self.name}: cannot be read ({problem.strerror}): check the path') from problem
        try:
            for block in self._blocks(buffer):
                self.message_count += sum(map(len, block.messages.values()))
                yield block
        except (struct.error, IndexError, UnicodeDecodeError) as problem:
            raise DamageError(
                f'{self.name}: a record is damaged: copy the file again') from problem
        finally:
            with suppress(BufferError):  # views that outlive the file keep the mapping alive
                buffer.close()

    def _blocks(self, buffer: mmap.mmap) -> Iterator[McapBlock]:
        if buffer[:len(MAGIC)] != MAGIC:
            raise DamageError(
                f'{self.name}: is not an MCAP file: give a bag recorded with storage mcap')
        loose = _Collector()
        position, seen = len(MAGIC), 0
        while True:
            try:
                opcode, start, stop = self._record(buffer, position)
            except DamageError:
                yield loose.block(buffer)
                raise
            self.share = stop / len(buffer)
            if opcode == MESSAGE:
                loose.add(buffer, position, stop, self)
            elif opcode == CHUNK:
                yield self._chunk(buffer, start, stop)
                seen = _give_back(buffer, seen, stop)
            elif opcode == DATA_END:
                break
            else:
                self._declaration(opcode, buffer, start, stop)
            if loose.count >= BLOCK_MESSAGES:
                yield loose.block(buffer)
                loose = _Collector()
                seen = _give_back(buffer, seen, stop)
            position = stop
        yield loose.block(buffer)
        # Check the data against the statements at the end of the file.
        (stated,) = struct.unpack_from('<I', buffer, start)
        crc = seen = 0
        for begin in range(0, position if stated else 0, 1 << 20):
            crc = zlib.crc32(buffer[begin:min(begin + (1 << 20), position)], crc)
            seen = _give_back(buffer, seen, begin)
        if crc != stated:
            raise self._damaged(position, 'the data (their checksum differs)')
        opcode = DATA_END
        while opcode != FOOTER:
            opcode, start, stop = self._record(buffer, stop)
            if opcode == STATISTICS:
                (count,) = struct.unpack_from('<Q', buffer, start)
                if count != self.message_count:
                    raise DamageError(
                        f'{self.name}: {self.message_count} of {count} messages are readable, a '
                        'record between them is damaged: copy the file again')
        end = stop + len(MAGIC)
        if buffer[stop:end] != MAGIC:
            raise self._cut_off(len(buffer))
        if buffer[end:end + len(MAGIC)] == MAGIC:
            raise DamageError(f'{self.name}: is two files joined, and the second begins at byte '
                              f'{end}: make a bag of each (head -c {end}; tail -c +{end + 1})')

    def _record(self, buffer: mmap.mmap, position: int) -> tuple[int, int, int]:
        """Opcode, first and past-the-last byte of the content of the record at `position`."""
        size, start = len(buffer), position + RECORD_HEAD
        if start > size:
            raise self._cut_off(size)
        opcode, length = _record_head.unpack_from(buffer, position)
        if opcode == 0 and not np.frombuffer(buffer, np.uint8, offset=position).any():
            raise self._cut_off(position)  # Rest of a growing file after a loss of power.
        if start + length > size and buffer[size - len(MAGIC):] != MAGIC:
            raise self._cut_off(size)
        if start + length > size or opcode == 0:
            raise self._damaged(position, 'a record')
        return opcode, start, start + length

    def _declaration(self, opcode: int, buffer: bytes | mmap.mmap, start: int, stop: int) -> None:
        """Read a schema, channel or metadata record; skip any other."""
        if opcode == SCHEMA:
            schema = records.Schema.read(_Fields(buffer, start, stop))
            self._schemas[schema.id] = schema
        elif opcode == CHANNEL:
            fields = _Fields(buffer, start, stop)
            number, of = fields.read2(), fields.read2()
            schema = self._schemas.get(of, records.Schema(of, b'', '', ''))
            self.channels[number] = McapChannel(
                fields.read_prefixed_string(), schema.name, fields.read_prefixed_string(),
                schema.encoding, schema.data)
        elif opcode == METADATA:
            stated = records.Metadata.read(_Fields(buffer, start, stop))
            self.metadata[stated.name] = stated.metadata

    # -- a chunk -------------------------------------------------------------------------------

    def _chunk(self, buffer: mmap.mmap, start: int, stop: int) -> McapBlock:
        damage = self._damaged(start, 'a chunk')
        try:
            chunk = records.Chunk.read(_Fields(buffer, start, stop))
        except IndexError:
            raise damage from None
        compression, data, size = chunk.compression, chunk.data, chunk.uncompressed_size
        if size > MAX_CHUNK:
            raise damage
        self.compressions.add(compression)
        if compression not in ('', 'zstd', 'lz4'):
            raise BagError(
                f'{self.name}: chunks are compressed with {compression!r}, which is not '
                'supported: convert the bag to zstd, lz4 or no compression')
        try:
            if compression == 'zstd':
                stated = zstandard.get_frame_parameters(data).content_size
                if stated not in (zstandard.CONTENTSIZE_UNKNOWN, size):
                    raise damage
                data = zstandard.ZstdDecompressor().decompress(data, max_output_size=size)
            elif compression == 'lz4':
                data = lz4.frame.LZ4FrameDecompressor().decompress(data, max_length=size)
        except (zstandard.ZstdError, RuntimeError, EOFError, MemoryError) as problem:
            raise damage from problem
        crc = chunk.uncompressed_crc
        if len(data) != size or (crc and crc != zlib.crc32(data)):
            raise damage
        with suppress(struct.error, IndexError, UnicodeDecodeError):
            block = self._indexed(data, _message_index(buffer, stop))
            if block is None:
                messages = _Collector()
                self._walk(data, 0, size, messages)
                block = messages.block(data)
            return block
        raise damage

    def _walk(self, data: bytes, position: int, stop: int, messages: '_Collector | None' = None,
              ) -> None:
        """Read the records from `position` to `stop`; IndexError for others than there may be."""
        others = 0
        while position < stop:
            opcode, length = _record_head.unpack_from(data, position)
            after = position + RECORD_HEAD + length
            if after > stop:
                raise IndexError
            if opcode == MESSAGE and messages is not None:
                messages.add(data, position, after, self)
            else:
                others += 1
                if opcode in (0, MESSAGE) or others > MAX_DECLARATIONS:
                    raise IndexError
                self._declaration(opcode, data, position + RECORD_HEAD, after)
            position = after

    def _indexed(self, data: bytes, index: dict[int, NDArray[np.void]]) -> McapBlock | None:
        """Find the messages of a chunk by its message index; None unless it accounts for all."""
        array = np.frombuffer(data, dtype=np.uint8)
        entries = np.concatenate([np.empty(0, INDEX_ENTRY), *index.values()])
        offsets = entries['offset'].astype(np.int64)
        if not len(offsets) or offsets.min() < 0 or (
                offsets.max() + RECORD_HEAD + MESSAGE_HEAD > len(array)):
            return None
        order = np.argsort(offsets)
        offsets = offsets[order]
        sizes = take(array, offsets + 1, '<u8').astype(np.int64)
        channels = np.repeat(list(index), [len(entry) for entry in index.values()])[order]
        edges = np.concatenate([[0], offsets + RECORD_HEAD + sizes])
        following = np.append(offsets, len(data))
        if not (
                (array[offsets] == MESSAGE).all()
                and (take(array, offsets + RECORD_HEAD, '<u2') == channels).all()
                and (sizes >= MESSAGE_HEAD).all() and (sizes <= len(array)).all()
                and (following >= edges).all()):
            return None
        try:
            for hole in np.flatnonzero(following > edges).tolist():
                self._walk(data, int(edges[hole]), int(following[hole]))
        except IndexError:
            return None
        if not set(index) <= set(self.channels):
            return None
        log_times = entries['log_time'].astype(np.int64)[order]
        messages = {}
        for channel in np.unique(channels).tolist():
            mine = np.flatnonzero(channels == channel)
            messages[channel] = Messages(
                offsets[mine] + RECORD_HEAD + MESSAGE_HEAD, sizes[mine] - MESSAGE_HEAD,
                log_times[mine])
        return McapBlock(array, messages)

    # -- faults --------------------------------------------------------------------------------

    def _cut_off(self, size: int) -> CutOffError:
        return CutOffError(
            f'{self.name}: the file is cut off at byte {size}: copy it again, or recover its '
            'content with "mcap recover"')

    def _damaged(self, position: int, what: str) -> DamageError:
        return DamageError(
            f'{self.name}: {what} at byte {position} of {self.path.stat().st_size} is damaged: '
            'copy the file again')


def _message_index(buffer: mmap.mmap, position: int) -> dict[int, NDArray[np.void]]:
    """The entries (N,) of the message index at `position`, by channel; none if it is damaged."""
    index: dict[int, NDArray[np.void]] = {}
    while position + RECORD_HEAD <= len(buffer):
        opcode, length = _record_head.unpack_from(buffer, position)
        start, position = position + RECORD_HEAD, position + RECORD_HEAD + length
        if opcode != MESSAGE_INDEX or length < 6 or position > len(buffer):
            break
        channel, size = struct.unpack_from('<HI', buffer, start)
        if size != length - 6 or size % INDEX_ENTRY.itemsize or channel in index:
            return {}
        index[channel] = np.frombuffer(buffer[start + 6:position], dtype=INDEX_ENTRY)
    return index


class _Collector:
    """Messages that were found one by one, collected into a block."""

    def __init__(self) -> None:
        self._found: dict[int, list[tuple[int, int, int]]] = {}
        self.count = 0

    def add(self, data: bytes | mmap.mmap, position: int, stop: int, file: McapFile) -> None:
        _, length, channel, _, log_time = _message_head.unpack_from(data, position)
        if length < MESSAGE_HEAD or channel not in file.channels:
            raise IndexError
        start = position + RECORD_HEAD + MESSAGE_HEAD
        self._found.setdefault(channel, []).append((start, stop - start, log_time))
        self.count += 1

    def block(self, data: bytes | mmap.mmap) -> McapBlock:
        messages = {channel: Messages(*np.array(entries, dtype=np.uint64).astype(np.int64).T)
                    for channel, entries in self._found.items()}
        return McapBlock(np.frombuffer(data, dtype=np.uint8), messages)


class _Fields(ReadDataStream):
    """The fields of a record, for mcap's own readers of records; IndexError behind its end."""

    def __init__(self, data: bytes | mmap.mmap, start: int, stop: int) -> None:
        super().__init__(BytesIO())
        self._data, self._start, self._stop = data, start, stop

    def read(self, length: int) -> bytes:
        start = self._start + self._count
        self._count += length
        if start + length > self._stop:
            raise IndexError
        return bytes(self._data[start:start + length])


def _give_back(buffer: mmap.mmap, start: int, stop: int) -> int:
    """Release the memory of a stretch that was read; the start of the next one."""
    if stop - start < GIVEN_BACK:
        return start
    first = start // mmap.PAGESIZE * mmap.PAGESIZE
    buffer.madvise(mmap.MADV_DONTNEED, first, stop - first)
    return stop
