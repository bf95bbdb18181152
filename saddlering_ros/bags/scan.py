"""One pass over a bag that collects all properties and stops only at damage."""

from collections.abc import Callable, Collection
from contextlib import suppress
from dataclasses import dataclass, field, replace
import math
from pathlib import Path
import re

import numpy as np
from numpy.typing import NDArray
import zstandard

from saddlering_ros.bags import folder, wire
from saddlering_ros.bags.folder import BagDirectory
from saddlering_ros.bags.mcap_read import CutOffError, MAX_CHUNK, McapBlock, McapFile, MESSAGE_HEAD
from saddlering_ros.bags.wire import CdrError, McapChannel, Messages
from saddlering_ros.doubts import Finding
from saddlering_ros.doubts.readings import ELEVATION_TOLERANCE_DEG
from saddlering_ros.errors import BagError, counted
from saddlering_ros.quantities import first_of
from saddlering_ros.record.record import KEYS, METADATA_RECORD, same_text, TestMetadata
from saddlering_ros.record.scratch import extremes, GrowingArray
from saddlering_ros.record.topics import RIG_TOPICS, RigTopic, TOPICS, VECTOR_TYPE, WRENCH_TYPE

MAX_MESSAGE = 1 << 16
"""Largest stated size [bytes] of a single compressed message of the rig; a larger one is
damage."""

OnShare = Callable[[float], None]
"""A function that receives the read share of a bag, 0 to 1."""


@dataclass
class ScannedTopic:
    """All messages of one topic in file order (rig topics), or their number only (others)."""

    topic: str
    types: set[str] = field(default_factory=set)
    count: int = 0
    fault: str = ''  # why the messages cannot be read
    frame_id: str = ''
    stamps: GrowingArray = field(default_factory=lambda: GrowingArray(np.int64))  # [ns]
    values: GrowingArray = field(default_factory=lambda: GrowingArray(np.float64))
    log_times: GrowingArray = field(default_factory=lambda: GrowingArray(np.int64))  # [ns]
    spans: list[NDArray[np.float64]] = field(default_factory=list)  # ends of range (K, 2) [m]

    def add(self, records: wire.Records, log_times: NDArray[np.int64]) -> None:
        topic = TOPICS[self.topic]
        self.frame_id = self.frame_id or records.frame_id
        if topic.low:
            spans = np.stack([records.fields[name].astype(np.float64)
                              for name in (topic.low, topic.high)], axis=1)
            if len(spans) and (spans == spans[0]).all():
                spans = spans[:1]
            if not self.spans or not np.array_equal(spans[:1], self.spans[-1], equal_nan=True):
                self.spans.append(spans)
        self.stamps.append(records.stamps)
        self.values.append(records.fields[topic.field])
        self.log_times.append(log_times)


@dataclass
class Scan:
    """Result of one pass over a bag."""

    directory: BagDirectory
    topics: dict[str, ScannedTopic] = field(default_factory=dict)
    facts: TestMetadata = field(default_factory=TestMetadata)
    damage: BagError | None = None  # fault that ended the pass early
    cuts: list[CutOffError] = field(default_factory=list)  # files that end too early
    unpacked: int = 0
    compressions: set[str] = field(default_factory=set)
    schema_encodings: set[str] = field(default_factory=set)
    message_count: int = 0
    size: int = 0
    contradictions: list[str] = field(default_factory=list)
    elevations: dict[str, float] = field(default_factory=dict)
    """The last elevation [deg] that each topic of displacements of nodes states."""

    @property
    def path(self) -> Path:
        return self.directory.path

    @property
    def notes(self) -> tuple[str, ...]:
        """Faults of the bag as a whole that do not prevent its use."""
        notes: list[str] = [
            Finding(str(cut).rpartition(': ')[0] + f'; {self.readable_part}', is_cut=True)
            for cut in self.cuts]
        said, names = self.directory.message_count, self.directory.unlisted
        if not self.cuts and said not in (None, self.message_count):
            notes.append(f'metadata.yaml counts {counted(said, "message")} and the files hold '
                         f'{self.message_count}: "ros2 bag reindex" corrects the count')
        if names:
            notes.append(f'not read, because metadata.yaml does not list them: '
                         f'{first_of(names, ", ")}; "ros2 bag reindex" lists every file, if '
                         'they belong to this test')
        stated = math.nan if self.facts.elevation_deg is None else self.facts.elevation_deg
        apart = [f'{name} ({degrees:.2f} deg)' for name, degrees in sorted(self.elevations.items())
                 if abs(degrees - stated) > ELEVATION_TOLERANCE_DEG]
        if apart and 'recorder_note' not in self.facts.details:
            notes.append(f'the bag states {stated:g} deg, and nodes meanwhile had another: '
                         f'{", ".join(apart)}')
        return tuple(notes)

    @property
    def readable_part(self) -> str:
        """Readable part of a damaged bag, in words."""
        stamps = [topic.stamps.array() for name, topic in self.topics.items()
                  if name in RIG_TOPICS and len(topic.stamps)]
        if not stamps:
            return 'nothing before that is readable'
        ends = [extremes(of_topic) for of_topic in stamps]
        first, last = min(low for low, _ in ends), max(high for _, high in ends)
        count = sum(len(of_topic) for of_topic in stamps)
        said = self.directory.message_count
        whole = '' if said is None or said < self.message_count else (
            f' ({100.0 * self.message_count / max(said, 1):.1f} % of the count in metadata.yaml)')
        return (f'{count} messages over {(last - first) / 1e9:.3f} s before that are readable'
                f'{whole}')

    @property
    def fault(self) -> BagError | None:
        """The damage or the first cut, as one line with how much can still be read."""
        problem = self.damage or next(iter(self.cuts), None)
        if problem is None:
            return None
        words, _, advice = str(problem).rpartition(': ')
        return BagError(f'{words}; {self.readable_part}: {advice}')


def scan(directory: BagDirectory, topics: Collection[str],
         on_progress: OnShare = lambda share: None) -> Scan:
    """Read a bag, decoding the rig's `topics`; on_progress gets the share of bytes read so far."""
    result = Scan(directory)
    whole = max(1, directory.size)
    records: dict[str, str] = {}
    recorder: dict[str, str] = {}
    try:
        for file in directory.files:
            try:
                _scan_file(result, file, topics, records, recorder,
                           lambda so_far: on_progress(min(1.0, so_far / whole)))
            except CutOffError as cut:
                result.cuts.append(cut)
    except BagError as damage:
        result.damage = damage
    facts = folder.find_metadata(directory.custom_data, records, recorder)
    result.facts = replace(facts, conflicts=(*facts.conflicts, *result.contradictions))
    return result


def _scan_file(result: Scan, path: Path, topics: Collection[str], records: dict[str, str],
               recorder: dict[str, str], on_bytes: Callable[[float], None]) -> None:
    before, size = result.size, path.stat().st_size
    result.size += size
    with folder.plain_file(path) as plain:
        file = McapFile(plain, str(path))
        try:
            for block in file.blocks():
                _take_block(result, file, block, topics)
                on_bytes(before + size * file.share)
                most = max(folder.MESSAGES_ALLOWED, folder.MAX_EXPANSION * result.size)
                if result.unpacked > most:
                    raise BagError(
                        f'{path}: {result.size} bytes unpack to more than {folder.MAX_EXPANSION} '
                        'times as many: no recorder writes such a file; use another bag')
        finally:
            texts = file.metadata.get(METADATA_RECORD, {})
            result.contradictions += [
                f'{key} is {records[key]!r} in one file and {value!r} in {path.name}: these are '
                'two tests: give each test a folder of its own' for key, value in texts.items()
                if key in KEYS and not same_text(key, records.get(key, value), value)]
            records.update({key: value for key, value in texts.items() if key not in records})
            with suppress(BagError):
                text = file.metadata.get('rosbag2', {}).get('serialized_metadata', '')
                recorder.update(folder.custom_data_of(folder.parse_metadata(text, 'metadata')))
            result.message_count += file.message_count
            result.compressions |= file.compressions or {'none'}
            for channel in file.channels.values():
                topic = result.topics.setdefault(channel.topic, ScannedTopic(channel.topic))
                topic.types.add(channel.type)
                if channel.topic in RIG_TOPICS:
                    result.schema_encodings.add(channel.schema_encoding)


def _take_block(result: Scan, file: McapFile, block: McapBlock, topics: Collection[str]) -> None:
    for number, messages in block.messages.items():
        channel = file.channels[number]
        topic = result.topics.setdefault(channel.topic, ScannedTopic(channel.topic))
        topic.types.add(channel.type)
        topic.count += len(messages)
        result.unpacked += len(messages) * MESSAGE_HEAD
        if channel.type == wire.DISPLACEMENT_TYPE and len(messages) and not (
                result.directory.message_compression):
            with suppress(CdrError):
                last = wire.decode_records(block.data, messages.starts[-1:], messages.sizes[-1:],
                                           channel.type, ('elevation',))
                result.elevations[channel.topic] = math.degrees(last.fields['elevation'][0])
        if channel.topic not in topics:
            continue
        result.unpacked += int(messages.sizes.sum())
        rig_topic, data = TOPICS[channel.topic], block.data
        topic.fault = topic.fault or fault_of(channel, rig_topic)
        if topic.fault:
            continue
        try:
            if result.directory.message_compression:
                data, messages = _decompressed(data, messages)
            topic.add(wire.decode_records(data, messages.starts, messages.sizes, rig_topic.type,
                                          rig_topic.fields), messages.log_times)
        except CdrError as problem:
            topic.fault = f'{problem}: record or copy the bag again'


_WORDS = {'f8': 'float64', 'f4': 'float32', 'u1': 'uint8'}
_NESTED = {(WRENCH_TYPE, 'wrench'): 'Wrench', (VECTOR_TYPE, 'vector'): 'Vector3'}
"""Types of the fields that are messages themselves."""

_FIELD = re.compile(r'^\s*([A-Za-z][\w/]*(?:\[[^\]]*\])?)\s+([A-Za-z]\w*)\s*(?![\w=\s])', re.M)


def fault_of(channel: McapChannel, topic: RigTopic) -> str:
    """Reason why messages of `channel` cannot be read as `topic`, with its remedy, or ''.

    Only definitions of encoding ros2msg that name any field are judged. The part after the
    last field that is read may differ between releases of ROS. A nested message is one field:
    'Wrench wrench' for wrench.force.x.
    """
    # Names of some recorders leave the middle part out.
    package, _, rest = channel.type.partition('/')
    if (channel.type if '/' in rest else f'{package}/msg/{rest}') != topic.type:
        return (f'its type is {channel.type or "not said"} and should be {topic.type}: '
                'record the topic of the rig, or remap it')
    if channel.encoding != 'cdr':
        return (f'its messages are encoded as {channel.encoding!r}: record with ROS 2, '
                'which encodes as cdr')
    if channel.schema_encoding != 'ros2msg':
        return ''
    expected = ['Header header']
    for path, kind in wire.LAYOUTS[topic.type]:
        name, dot, _ = path.partition('.')
        line = f'{_NESTED[topic.type, name]} {name}' if dot else f'{_WORDS[kind]} {name}'
        if expected[-1] != line:
            expected.append(line)
        if path == topic.field:
            break
    definition = channel.definition.decode('utf-8', 'replace').partition('=====')[0]
    fields = [' '.join((match[1].rpartition('/')[2], match[2]))
              for line in definition.splitlines() if (match := _FIELD.match(line))]
    if not fields or fields[:len(expected)] == expected:
        return ''
    pairs = zip(expected, [*fields, *['nothing'] * len(expected)], strict=False)
    wanted, there = next(pair for pair in pairs if pair[0] != pair[1])
    return (f'its definition of {channel.type} has {there!r} where {wanted!r} should be: record '
            'with the messages of ROS 2 Jazzy')


def _decompressed(data: NDArray[np.uint8],
                  messages: Messages) -> tuple[NDArray[np.uint8], Messages]:
    """The same messages, each without its own zstd frame."""
    decompressor = zstandard.ZstdDecompressor()
    plain: list[bytes] = []
    size_so_far = 0
    for start, size in zip(messages.starts.tolist(), messages.sizes.tolist(), strict=True):
        frame = data[start:start + size].tobytes()
        try:
            if zstandard.get_frame_parameters(frame).content_size == 0 or (
                    zstandard.frame_content_size(frame) > MAX_MESSAGE):
                raise CdrError('a compressed message is damaged')
            plain.append(decompressor.decompress(frame, max_output_size=MAX_MESSAGE))
        except (zstandard.ZstdError, MemoryError) as problem:
            raise CdrError('a compressed message is damaged') from problem
        size_so_far += len(plain[-1])
        if size_so_far > MAX_CHUNK:
            raise CdrError('compressed messages are too large for topics of the rig')
    sizes = np.array(list(map(len, plain)), dtype=np.int64)
    return (np.frombuffer(b''.join(plain), dtype=np.uint8),
            Messages(np.cumsum(sizes) - sizes, sizes, messages.log_times))
