"""A bag written message by message, of any types with known definitions."""

from __future__ import annotations

from collections.abc import Mapping
from contextlib import suppress
from pathlib import Path
import shutil
import tempfile
from types import TracebackType
from typing import BinaryIO

from mcap.writer import CompressionType
from mcap.writer import Writer as McapWriter
from rosbags.interfaces import Qos, QosDurability, QosReliability
from rosbags.typesys import get_types_from_msg, get_typestore, Stores
from rosbags.typesys.store import Typestore

from saddlering_ros.bags.bag_folder import (
    BagFolder,
    BagTopic,
    check_target,
    FOLDER_RECORD,
    LIBRARY,
    put_in_place,
    RELIABLE,
)
from saddlering_ros.record.errors import BagError
from saddlering_ros.record.metadata import METADATA_RECORD

CHUNK_SIZE = 1 << 16
"""Largest loss by a crash [bytes]: 6 s at 10 Hz. Bags are 2 % larger than by chunks of 1 MB."""


class BagRecording:
    """A rosbag2 directory in the making; a context manager, after which it is at its place.

    topics: message type ('package/msg/Name') by topic; definitions: the text of .msg files of
    types that ROS 2 itself does not define, by type; latched: topics whose last message stays
    there for late joiners; facts: strings for the bag's custom data. While it is being written it
    is beside its place, in a folder whose name begins with a dot; there a crash or a full disk
    leaves it, readable up to its last whole chunk.
    """

    def __init__(
        self, path: Path | str, topics: Mapping[str, str], *,
        definitions: Mapping[str, str] | None = None, latched: frozenset[str] = frozenset(),
        facts: Mapping[str, str] | None = None, overwrite: bool = False,
    ) -> None:
        self.path = Path(path)
        self.messages = 0
        self._failed = False
        check_target(self.path, overwrite)
        try:
            self.path.parent.mkdir(parents=True, exist_ok=True)
            self._folder = Path(tempfile.mkdtemp(prefix=f'.{self.path.name}.recording.',
                                                 dir=self.path.parent))
        except OSError as problem:
            raise BagError(self._complaint(problem)) from problem
        self._written = self._folder / self.path.name
        folder = BagFolder(self._written, facts or {})
        store = _store(definitions or {})
        qos = {topic: _latched() if topic in latched else RELIABLE for topic in topics}
        self._bag = _MessageBag(folder, facts or {})
        for topic, kind in topics.items():
            self._bag.add_topic(folder.add_topic(topic, kind, store, qos[topic]))

    def write(self, topic: str, log_time: int, message: bytes) -> None:
        """Add one serialized message that was received at `log_time` [ns]."""
        try:
            self._bag.write(topic, log_time, message)
        except OSError as problem:
            self._failed = True
            raise self._unwritable(problem) from problem
        self.messages += 1

    def __enter__(self) -> BagRecording:
        return self

    def __exit__(self, kind: type[BaseException] | None, problem: BaseException | None,
                 trace: TracebackType | None) -> None:
        if self._failed:  # The failed part lies in the middle if there is room again by now.
            self._bag.abort()
            return
        try:
            self._bag.close()
            put_in_place(self._written, self.path)
        except OSError as fault:
            self._bag.abort()
            raise self._unwritable(fault) from fault
        shutil.rmtree(self._folder, ignore_errors=True)

    def _unwritable(self, problem: OSError) -> BagError:
        return BagError(f'{self._complaint(problem)}; the recording until then is readable in '
                        f'{self._written}')

    def _complaint(self, problem: OSError) -> str:
        return (f'{self.path}: cannot be written ({problem.strerror or problem}): '
                'choose another place')


class _MessageBag:
    """The files of a bag that is being written message by message, with checksums.

    The metadata record of the facts comes first, so that a file that is cut off has it.
    """

    def __init__(self, folder: BagFolder, facts: Mapping[str, str]) -> None:
        self._folder = folder
        self._file: BinaryIO = folder.file.open('xb')
        self._writer = McapWriter(
            self._file, chunk_size=CHUNK_SIZE, compression=CompressionType.ZSTD, enable_crcs=True)
        self._writer.start(profile='ros2', library=LIBRARY)
        self._writer.add_metadata(METADATA_RECORD, dict(facts))
        self._schemas: dict[str, int] = {}
        self._channels: dict[str, tuple[BagTopic, int]] = {}

    def add_topic(self, topic: BagTopic) -> None:
        if topic.type not in self._schemas:
            self._schemas[topic.type] = self._writer.register_schema(
                name=topic.type, encoding='ros2msg', data=topic.definition.encode())
        self._channels[topic.name] = topic, self._writer.register_channel(
            topic=topic.name, message_encoding='cdr', schema_id=self._schemas[topic.type],
            metadata=topic.channel_metadata())

    def write(self, name: str, log_time: int, message: bytes) -> None:
        topic, channel = self._channels[name]
        self._writer.add_message(channel, log_time=log_time, publish_time=log_time, data=message)
        topic.add(1, log_time, log_time)

    def close(self) -> None:
        self._writer.add_metadata(FOLDER_RECORD, self._folder.record())
        self._writer.finish()
        self._file.close()
        self._folder.describe()

    def abort(self) -> None:
        with suppress(OSError):
            self._file.close()


def _latched() -> Qos:
    return RELIABLE._replace(durability=QosDurability.TRANSIENT_LOCAL,
                              reliability=QosReliability.RELIABLE)


def _store(definitions: Mapping[str, str]) -> Typestore:
    store = get_typestore(Stores.ROS2_JAZZY)
    for kind, text in definitions.items():
        store.register(get_types_from_msg(text, kind))
    return store
