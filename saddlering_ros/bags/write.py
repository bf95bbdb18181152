"""The one writer of bags: rosbag2 directories of one MCAP file, from blocks or single messages.

Source of the format: the MCAP specification (https://mcap.dev/spec). The mcap package writes the
records of which a file has few. Messages and their index, of which a file has millions, are
written here, because NumPy builds a chunk of equal messages about thirty times as fast. rosbags
knows the definitions of the messages and their hashes. metadata.yaml is formed here, because
rosbags forms every text of YAML by pure Python, several times a bag, which took half the time of a
short bag.
"""

from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager, ExitStack, suppress
from dataclasses import dataclass
import errno
import os
from pathlib import Path
import shutil
import struct
import tempfile
from types import TracebackType
from typing import Any, BinaryIO
import zlib

from mcap import records
from mcap.data_stream import RecordBuilder
from mcap.opcode import Opcode
import numpy as np
from numpy.typing import ArrayLike, NDArray
from rosbags.typesys import get_types_from_msg, get_typestore, Stores
import yaml
import zstandard

from saddlering_ros.bags.folder import INFORMATION, METADATA
from saddlering_ros.bags.mcap_read import INDEX_ENTRY, MAGIC, MESSAGE, MESSAGE_HEAD, RECORD_HEAD
from saddlering_ros.bags.wire import encode
from saddlering_ros.errors import BagError
from saddlering_ros.files import exchange, rename_without_replacing, settle, temporary_folder
from saddlering_ros.record.batches import SECOND
from saddlering_ros.record.record import METADATA_RECORD, TestMetadata
from saddlering_ros.record.topics import LOAD, PROBES, RigTopic, TOPICS
from saddlering_ros.rig.description import Probes

CHUNK_SIZE = 1 << 20
"""Bytes of messages of a chunk before compression."""

RECORDED_CHUNK_SIZE = 1 << 16
"""The same of a recording: its largest loss by a crash, 6 s at 10 Hz. Bags are 2 % larger."""

END_OF_STAMPS = 2 ** 31 * SECOND
"""Stamp [ns] from which on the 32-bit seconds of a header overflow: in January 2038."""

_FOREVER = {'sec': 9223372036, 'nsec': 854775807}
QOS = {'history': 'keep_last', 'depth': 1000, 'reliability': 'reliable', 'deadline': _FOREVER,
       'lifespan': _FOREVER, 'liveliness': 'automatic', 'liveliness_lease_duration': _FOREVER,
       'avoid_ros_namespace_conventions': False}
"""Quality of service of every topic, without its durability."""


class _WithoutAliases(getattr(yaml, 'CSafeDumper', yaml.SafeDumper)):  # type: ignore[misc]
    """libyaml's where PyYAML has it; readers refuse aliases (&id001) of equal parts."""

    def ignore_aliases(self, data: object) -> bool:
        return True


def _text(value: object) -> str:
    text: str = yaml.dump(value, Dumper=_WithoutAliases, default_flow_style=False,
                          allow_unicode=True)
    return text


def _is_bag(path: Path) -> bool:
    return path.is_dir() and all(
        file.name == METADATA or file.suffix == '.mcap' for file in path.iterdir())


def put_in_place(written: Path, path: Path, overwrite: bool) -> Path:
    """Move the finished bag to `path`, or beside it if that is taken by now; where it is.

    An earlier bag is removed at the same moment if `overwrite` is set.
    """
    for file in written.iterdir():
        settle(file)
    place, number = path, 1
    while True:
        try:
            rename_without_replacing(written, place)
            break
        except FileExistsError:
            if overwrite and place == path and _is_bag(path):
                exchange(written, path)
                break
            number += 1
            place = path.with_name(f'{path.name}.{number}')
    settle(path.parent)
    return place


class BagWriter:
    """A rosbag2 directory that is being written; a context manager, at whose end it is in place.

    topics: message type ('package/msg/Name') by topic; metadata: texts for custom_data and the
    record saddlering.test, which comes first, so that a file that is cut off has it; definitions:
    texts of .msg files of types that ROS 2 does not define, by type; latched: topics whose last
    message stays for late joiners; chunk_size: bytes of messages of a chunk before compression.

    The bag is written beside its place, in a folder whose name begins with a dot. An exception in
    the block leaves no file, but only ends a bag that is `recorded`. After a crash or on a full
    disk the folder of a recording stays, readable up to its last whole chunk.
    """

    def __init__(self, path: Path | str, topics: Mapping[str, str], metadata: Mapping[str, str],
                 *, definitions: Mapping[str, str] | None = None,
                 latched: frozenset[str] = frozenset(), overwrite: bool = False,
                 chunk_size: int = CHUNK_SIZE, recorded: bool = False) -> None:
        self.path = Path(path)
        store = get_typestore(Stores.ROS2_JAZZY)
        for kind, text in (definitions or {}).items():
            store.register(get_types_from_msg(text, kind))
        self._definitions = {
            kind: store.generate_msgdef(kind, ros_version=2)[0] for kind in topics.values()}
        self._topics: dict[str, dict[str, Any]] = {name: {
            'name': name, 'type': kind, 'serialization_format': 'cdr', 'offered_qos_profiles': [
                {**QOS, 'durability': 'transient_local' if name in latched else 'volatile'}],
            'type_description_hash': store.hash_rihs01(kind)} for name, kind in topics.items()}
        self.metadata = dict(metadata)
        self._overwrite, self._chunk_size, self._recorded = overwrite, chunk_size, recorded
        self._failed, self._kept = False, ''
        self._stack = ExitStack()

    def __enter__(self) -> 'BagWriter':
        if self.path.exists() and not self._overwrite:
            raise BagError(f'{self.path}: exists already: choose another name, or give '
                           'overwrite=True')
        if self.path.exists() and not _is_bag(self.path):
            raise BagError(f'{self.path}: exists and is not a bag, so that it is not replaced: '
                           'choose another name')
        with self._or_refused():
            self.path.parent.mkdir(parents=True, exist_ok=True)
            if self._recorded:
                self._folder = Path(tempfile.mkdtemp(
                    prefix=f'.{self.path.name}.recording.', dir=self.path.parent))
            else:
                self._folder = self._stack.enter_context(
                    temporary_folder(self.path.parent, f'.{self.path.name}.'))
            self._written = self._folder / self.path.name
            self._written.mkdir(mode=0o755)
            self._name = f'{self.path.name}_0.mcap'  # the bag may be put elsewhere at its end
            self._file = McapWriter(
                self._written / self._name, 'saddlering_ros', self._chunk_size)
            self._file.add_metadata(METADATA_RECORD, self.metadata)
            for name, topic in self._topics.items():
                self._file.add_topic(name, topic['type'], self._definitions[topic['type']], {
                    'offered_qos_profiles': _text(topic['offered_qos_profiles']).strip(),
                    'topic_type_hash': topic['type_description_hash']})
            if self._recorded:
                self._kept = f'; the recording until then is readable in {self._written}'
        return self

    def write(self, blocks: Sequence['MessageBlock']) -> None:
        """Add messages of some topics, in order of their log times, chunk by chunk."""
        with self._or_refused():
            self._file.add_blocks([block for block in blocks if len(block)])

    def write_message(self, topic: str, log_time: int, message: bytes) -> None:
        """Add one serialized message that was received at `log_time` [ns]."""
        with self._or_refused():
            self._file.add_message(topic, log_time, message)

    def __exit__(self, kind: type[BaseException] | None, problem: BaseException | None,
                 trace: TracebackType | None) -> None:
        # After a failure the damaged chunk would lie in the middle if there is room again by now.
        try:
            if self._failed or (kind is not None and not self._recorded):
                return
            with self._or_refused():
                information = self._information(*self._file.written())
                self._file.finish({'rosbag2': {'serialized_metadata': _text(information).strip()}})
                (self._written / METADATA).write_text(_text({INFORMATION: information}), 'utf-8')
                place = put_in_place(self._written, self.path, self._overwrite)
            self._stack.callback(shutil.rmtree, self._folder, ignore_errors=True)
            if place != self.path:
                raise BagError(f'{self.path}: appeared while this bag was written, and is not '
                               f'replaced: this bag is at {place}')
        finally:
            self._file.abort()
            self._stack.close()

    def _information(self, first: int, last: int, counts: Mapping[str, int]) -> dict[str, Any]:
        """The content of metadata.yaml; first, last: log times [ns]; counts: by topic."""
        times = {'starting_time': {'nanoseconds_since_epoch': first},
                 'duration': {'nanoseconds': max(0, last - first)},
                 'message_count': sum(counts.values())}
        return {
            'version': 9,  # that of Jazzy
            'storage_identifier': 'mcap', 'relative_file_paths': [self._name], **times,
            'topics_with_message_count': [
                {'topic_metadata': topic, 'message_count': counts.get(name, 0)}
                for name, topic in self._topics.items()],
            'compression_format': '', 'compression_mode': '',
            'files': [{'path': self._name, **times}],
            'custom_data': self.metadata or None, 'ros_distro': 'rosbags'}

    @contextmanager
    def _or_refused(self) -> Iterator[None]:
        """A fault of the file system as one line."""
        try:
            yield
        except OSError as problem:
            self._failed = True
            kept = self._kept if self._kept and self._written.exists() else ''
            raise BagError(f'{self.path}: cannot be written ({problem.strerror or problem}): '
                           f'choose another place{kept}') from problem


def messages_of(topic: RigTopic, stamps: ArrayLike, values: ArrayLike, span: Sequence[float] = (),
                log_delay: int = 0) -> 'MessageBlock':
    """Messages of `topic`, logged `log_delay` [ns] after the stamps; span: ends of the range."""
    stamps = np.asarray(stamps, dtype=np.int64)
    values = np.asarray(values, dtype=np.float64)
    if stamps.ndim != 1 or stamps.shape != values.shape:
        raise BagError(f'{topic.name}: {stamps.shape} stamps and {values.shape} readings were '
                       'given to write: give one array of each, of equal length')
    if stamps.size and not 0 <= stamps.min() <= stamps.max() < END_OF_STAMPS:
        wrong = int(stamps.min() if stamps.min() < 0 else stamps.max())
        raise BagError(f'{topic.name}: the stamp {wrong} ns is not from 1970 to 2038, the times '
                       'that the header of a message holds: correct the date of the recording')
    fields: dict[str, ArrayLike] = {topic.field: values}
    if topic.low and span:
        fields |= {topic.low: span[0], topic.high: span[1]}
    return MessageBlock(
        topic.name, stamps + log_delay, encode(topic.type, topic.frame_id, stamps, fields))


def write_bag(path: Path | str, metadata: TestMetadata, load_stamps: ArrayLike, load: ArrayLike,
              probe_stamps: Sequence[ArrayLike], gaps: Sequence[ArrayLike], probes: Probes, *,
              others: Mapping[str, tuple[ArrayLike, ArrayLike]] | None = None, log_delay: int = 0,
              chunk_size: int = CHUNK_SIZE, overwrite: bool = False) -> Path:
    """Write a rosbag2 directory at `path`, complete or not at all; return the path.

    load_stamps (N,) int64 [ns], load (N,) [N]; probe_stamps and gaps: four arrays each, (M_i,)
    int64 [ns] and (M_i,) [m] (kept as float32, the message's type); others: stamps and readings
    of optional topics by name. The probe that is absent has no topic. `log_delay` [ns] is put
    between a stamp and its log time. An existing bag is replaced only if `overwrite` is
    set, and anything else at `path` never.
    """
    span = (probes.min_range, probes.max_range)
    absent = PROBES[probes.absent - 1] if probes.absent else None
    blocks = [messages_of(LOAD, load_stamps, load, log_delay=log_delay)]
    blocks += [messages_of(topic, stamps, gap, span, log_delay)
               for topic, stamps, gap in zip(PROBES, probe_stamps, gaps, strict=True)
               if topic is not absent]
    blocks += [messages_of(TOPICS[name], *samples, log_delay=log_delay)
               for name, samples in (others or {}).items()]
    topics = {block.topic: TOPICS[block.topic].type for block in blocks}
    with BagWriter(path, topics, metadata.as_text(), overwrite=overwrite,
                   chunk_size=chunk_size) as writer:
        writer.write(blocks)
    return Path(path)


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
    """One MCAP file that is being written, in chunks of `chunk_size` bytes; then its summary."""

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

    def add_topic(self, topic: str, kind: str, definition: str,
                  metadata: Mapping[str, str]) -> None:
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
            if not os.fstat(self._file.fileno()).st_nlink:
                raise FileNotFoundError(errno.ENOENT, 'it was removed meanwhile')
            self._write_chunk(bytes(self._gathered), {
                channel: np.array(entries, dtype=INDEX_ENTRY)
                for channel, entries in self._gathered_index.items()})
            self._file.flush()
        self._gathered.clear()
        self._gathered_index.clear()

    def add_blocks(self, blocks: Sequence[MessageBlock]) -> None:
        """Write the messages of blocks, none of them empty, by log time, chunk by chunk."""
        if not blocks:
            return
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

    def written(self) -> tuple[int, int, dict[str, int]]:
        """First and last log time [ns] of all messages, and their number by topic."""
        self._write_gathered()
        return (min((one.message_start_time for one in self._chunks), default=2 ** 63 - 1),
                max((one.message_end_time for one in self._chunks), default=0),
                {topic: self._counts.get(channel.id, 0)
                 for topic, channel in self._channels.items()})

    def finish(self, metadata: Mapping[str, Mapping[str, str]]) -> None:
        """Write what was gathered, records of metadata by name, and the summary."""
        first, last, counts = self.written()
        for name, texts in metadata.items():
            self.add_metadata(name, texts)
        self._write(records.DataEnd(0))
        start = self._file.tell()
        statistics = records.Statistics(
            attachment_count=0, channel_count=len(self._channels),
            channel_message_counts=self._counts, chunk_count=len(self._chunks),
            message_count=sum(counts.values()), metadata_count=len(self._metadata),
            message_start_time=first if self._chunks else 0, message_end_time=last,
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
