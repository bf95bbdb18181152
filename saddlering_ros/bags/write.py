"""The one writer of bags: rosbag2 directories of one MCAP file, from blocks or single messages.

rosbags knows the definitions of the messages and their hashes. metadata.yaml is formed here,
because rosbags forms every text of YAML by pure Python, several times a bag, which took half the
time of a short bag.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager, ExitStack
from dataclasses import dataclass
from pathlib import Path
import shutil
import tempfile
from types import TracebackType
from typing import Any

import numpy as np
from numpy.typing import ArrayLike
from rosbags.typesys import get_types_from_msg, get_typestore, Stores
import yaml

from saddlering_ros.bags.folder import INFORMATION, METADATA
from saddlering_ros.bags.mcap_write import McapWriter, MessageBlock
from saddlering_ros.bags.wire import encode
from saddlering_ros.errors import BagError
from saddlering_ros.files import exchange, rename_without_replacing, settle, temporary_folder
from saddlering_ros.record.batches import SECOND
from saddlering_ros.record.record import METADATA_RECORD, TestMetadata
from saddlering_ros.record.topics import LOAD, PROBES, RigTopic, TOPICS
from saddlering_ros.rig import Probes

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
"""Quality of service of every topic, less its durability."""


@dataclass
class BagTopic:
    """A topic of a bag, and the number and log times [ns] of its messages so far."""

    name: str
    type: str
    definition: str
    type_hash: str
    qos: dict[str, Any]
    count: int = 0
    first: int = 2 ** 63 - 1
    last: int = 0


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
    texts of .msg files of types that ROS 2 itself does not define, by type; latched: topics whose
    last message stays there for late joiners; chunk_size: bytes of messages of one chunk before
    compression.

    The bag is written beside its place, in a folder whose name begins with a dot. An exception in
    the block leaves no file. A bag that is `recorded` cannot be written again: an exception
    only ends it, and after a crash or on a full disk the folder stays, readable up to its last
    whole chunk.
    """

    def __init__(
        self, path: Path | str, topics: Mapping[str, str], metadata: Mapping[str, str], *,
        definitions: Mapping[str, str] | None = None, latched: frozenset[str] = frozenset(),
        overwrite: bool = False, chunk_size: int = CHUNK_SIZE, recorded: bool = False,
    ) -> None:
        self.path = Path(path)
        store = get_typestore(Stores.ROS2_JAZZY)
        for kind, text in (definitions or {}).items():
            store.register(get_types_from_msg(text, kind))
        self._topics = {name: BagTopic(
            name, kind, store.generate_msgdef(kind, ros_version=2)[0], store.hash_rihs01(kind),
            {**QOS, 'durability': 'transient_local' if name in latched else 'volatile'})
            for name, kind in topics.items()}
        self.metadata = dict(metadata)
        self._overwrite, self._chunk_size, self._recorded = overwrite, chunk_size, recorded
        self._failed = False
        self._stack = ExitStack()

    @property
    def messages(self) -> int:
        """Number of messages written."""
        return sum(topic.count for topic in self._topics.values())

    def __enter__(self) -> BagWriter:
        if self.path.exists() and not self._overwrite:
            raise BagError(f'{self.path}: exists already: choose another name, or give '
                           'overwrite=True')
        if self.path.exists() and not _is_bag(self.path):
            raise BagError(f'{self.path}: exists and is not a bag, so that it is not replaced: '
                           'choose another name')
        try:
            self.path.parent.mkdir(parents=True, exist_ok=True)
            if self._recorded:
                self._folder = Path(tempfile.mkdtemp(
                    prefix=f'.{self.path.name}.recording.', dir=self.path.parent))
            else:
                self._folder = self._stack.enter_context(
                    temporary_folder(self.path.parent, f'.{self.path.name}.'))
            self._written = self._folder / self.path.name
            self._written.mkdir(mode=0o755)
            self._file = McapWriter(self._written / f'{self.path.name}_0.mcap', 'saddlering_ros',
                                    self._chunk_size)
            self._file.add_metadata(METADATA_RECORD, self.metadata)
        except OSError as problem:
            raise BagError(self._complaint(problem)) from problem
        for topic in self._topics.values():
            self._file.add_topic(topic.name, topic.type, topic.definition, {
                'offered_qos_profiles': _text([topic.qos]).strip(),
                'topic_type_hash': topic.type_hash})
        return self

    def write(self, blocks: Sequence[MessageBlock]) -> None:
        """Add messages of some topics, in order of their log times, chunk by chunk."""
        filled = [block for block in blocks if len(block)]
        if not filled:
            return
        with self._or_refused():
            self._file.add_blocks(filled)
        for block in filled:
            self._count(block.topic, len(block), int(block.log_times.min()),
                        int(block.log_times.max()))

    def write_message(self, topic: str, log_time: int, message: bytes) -> None:
        """Add one serialized message that was received at `log_time` [ns]."""
        with self._or_refused():
            self._file.add_message(topic, log_time, message)
        self._count(topic, 1, log_time, log_time)

    def _count(self, name: str, count: int, first: int, last: int) -> None:
        """Count further messages, of log times `first` to `last` [ns]."""
        topic = self._topics[name]
        topic.count += count
        topic.first, topic.last = min(topic.first, first), max(topic.last, last)

    def __exit__(self, kind: type[BaseException] | None, problem: BaseException | None,
                 trace: TracebackType | None) -> None:
        # After a failure the damaged chunk would lie in the middle if there is room again by now.
        try:
            if self._failed or (kind is not None and not self._recorded):
                return
            with self._or_refused():
                information = self._information()
                self._file.finish({'rosbag2': {
                    'serialized_metadata': _text(information).strip()}})
                (self._written / METADATA).write_text(_text({INFORMATION: information}), 'utf-8')
                place = put_in_place(self._written, self.path, self._overwrite)
            self._stack.callback(shutil.rmtree, self._folder, ignore_errors=True)
            if place != self.path:
                raise BagError(f'{self.path}: appeared while this bag was written, and is not '
                               f'replaced: this bag is at {place}')
        finally:
            self._file.abort()
            self._stack.close()

    def _information(self) -> dict[str, Any]:
        """The content of metadata.yaml."""
        file, topics = f'{self.path.name}_0.mcap', self._topics.values()
        start = min((topic.first for topic in topics), default=2 ** 63 - 1)
        last = max((topic.last for topic in topics), default=0)
        times = {'starting_time': {'nanoseconds_since_epoch': start},
                 'duration': {'nanoseconds': max(0, last - start)}, 'message_count': self.messages}
        return {
            'version': 9,  # that of Jazzy
            'storage_identifier': 'mcap', 'relative_file_paths': [file], **times,
            'topics_with_message_count': [
                {'topic_metadata': {
                    'name': topic.name, 'type': topic.type, 'serialization_format': 'cdr',
                    'offered_qos_profiles': [topic.qos],
                    'type_description_hash': topic.type_hash},
                 'message_count': topic.count} for topic in topics],
            'compression_format': '', 'compression_mode': '',
            'files': [{'path': file, **times}],
            'custom_data': self.metadata or None, 'ros_distro': 'rosbags'}

    @contextmanager
    def _or_refused(self) -> Iterator[None]:
        """A fault of the file system as one line."""
        try:
            yield
        except OSError as problem:
            self._failed = True
            kept = (f'; the recording until then is readable in {self._written}'
                    if self._recorded else '')
            raise BagError(f'{self._complaint(problem)}{kept}') from problem

    def _complaint(self, problem: OSError) -> str:
        return (f'{self.path}: cannot be written ({problem.strerror or problem}): '
                'choose another place')


def messages_of(
    topic: RigTopic, stamps: ArrayLike, values: ArrayLike, span: Sequence[float] = (),
    log_delay: int = 0,
) -> MessageBlock:
    """Messages of `topic` with `values` as its readings, logged `log_delay` [ns] after the stamps.

    span: the ends of the sensor's range, for a topic that has them.
    """
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


def write_bag(
    path: Path | str,
    metadata: TestMetadata,
    load_stamps: ArrayLike,
    load: ArrayLike,
    probe_stamps: Sequence[ArrayLike],
    gaps: Sequence[ArrayLike],
    probes: Probes,
    *,
    others: Mapping[str, tuple[ArrayLike, ArrayLike]] | None = None,
    log_delay: int = 0,
    chunk_size: int = CHUNK_SIZE,
    overwrite: bool = False,
) -> Path:
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
