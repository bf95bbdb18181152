"""A bag of any size, written block by block in the memory of one block.

NumPy encodes the messages of a block and puts them into the file, about thirty times as fast as
message by message.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from contextlib import ExitStack, suppress
from pathlib import Path
from types import TracebackType

import numpy as np
from numpy.typing import NDArray
from rosbags.interfaces import Connection
from rosbags.rosbag2 import CompressionMode, StoragePlugin
from rosbags.rosbag2 import Writer as Rosbag2Writer
from rosbags.typesys import get_typestore, Stores

from saddlering_ros.bags.cdr import encode
from saddlering_ros.bags.errors import BagError
from saddlering_ros.bags.facts import RECORD
from saddlering_ros.bags.mcap_blocks import McapBlockFile, MessageBlock
from saddlering_ros.bags.topics import RigTopic
from saddlering_ros.bags.writer import _check_target, _put_in_place, _RELIABLE
from saddlering_ros.writing import temporary_folder

CHUNK_MESSAGES = 1 << 14
"""Messages of one chunk: about 1.5 MB before compression."""


class BlockBagWriter:
    """A rosbag2 directory that is being written; a context manager, at whose end it is in place.

    topics: the rig's topics with the range [m] of their sensors (() for none); metadata: texts
    for custom_data and the record saddlering.test. An exception in the block leaves no file.
    """

    def __init__(
        self, path: Path | str, topics: Sequence[tuple[RigTopic, Sequence[float]]],
        metadata: Mapping[str, str], *, overwrite: bool = False,
    ) -> None:
        self.path = Path(path)
        self._topics = tuple(topics)
        self._overwrite = overwrite
        self._stack = ExitStack()
        _check_target(self.path, overwrite)
        try:
            self.path.parent.mkdir(parents=True, exist_ok=True)
            folder = self._stack.enter_context(
                temporary_folder(self.path.parent, f'.{self.path.name}.'))
        except OSError as problem:
            raise self._unwritable(problem) from problem
        self._written = folder / self.path.name
        self._writer = _Writer(self._written, metadata)
        self._connections: list[Connection] = []

    @property
    def messages(self) -> int:
        """Number of messages written."""
        return sum(self._writer.counts.values())

    def write(
        self, samples: Sequence[tuple[NDArray[np.int64], NDArray[np.float64]]],
    ) -> None:
        """Add stamps (N_i,) [ns] and readings (N_i,) [SI] of each topic, in order of the topics.

        Every stamp must be later than those of the block before.
        """
        try:
            for part in _parts(samples):
                self._writer.write_chunk([
                    (connection, stamps, self._encode(topic, span, stamps, values))
                    for connection, (topic, span), (stamps, values) in zip(
                        self._connections, self._topics, part, strict=True)])
        except OSError as problem:
            raise self._unwritable(problem) from problem

    def __enter__(self) -> BlockBagWriter:
        self._writer.open()
        store = get_typestore(Stores.ROS2_JAZZY)
        self._connections = [
            self._writer.add_connection(topic.name, topic.type, typestore=store,
                                        offered_qos_profiles=[_RELIABLE])
            for topic, _ in self._topics]
        return self

    def __exit__(self, kind: type[BaseException] | None, problem: BaseException | None,
                 trace: TracebackType | None) -> None:
        try:
            if kind is not None:
                self._writer.abort()
                return
            self._writer.close()
            _check_target(self.path, self._overwrite)
            _put_in_place(self._written, self.path)
        except OSError as fault:
            raise self._unwritable(fault) from fault
        finally:
            self._stack.close()

    def _encode(
        self, topic: RigTopic, span: Sequence[float], stamps: NDArray[np.int64],
        values: NDArray[np.float64],
    ) -> NDArray[np.uint8]:
        fields: dict[str, object] = {topic.field: values}
        if topic.low and span:
            fields |= {topic.low: span[0], topic.high: span[1]}
        return encode(topic.type, topic.frame_id, stamps, fields)  # type: ignore[arg-type]

    def _unwritable(self, problem: OSError) -> BagError:
        return BagError(f'{self.path}: cannot be written ({problem.strerror or problem}): '
                        'choose another place')


def _parts(
    samples: Sequence[tuple[NDArray[np.int64], NDArray[np.float64]]],
) -> list[list[tuple[NDArray[np.int64], NDArray[np.float64]]]]:
    """The samples, cut at common times into parts of about CHUNK_MESSAGES messages."""
    total = sum(len(stamps) for stamps, _ in samples)
    if not total:
        return []
    count = -(-total // CHUNK_MESSAGES)
    longest = max((stamps for stamps, _ in samples), key=len)
    inner = longest[np.linspace(0, len(longest), count + 1).astype(int)[1:-1]]
    cuts = [np.concatenate([[0], np.searchsorted(stamps, inner), [len(stamps)]])
            for stamps, _ in samples]
    return [[(stamps[cut[i]:cut[i + 1]], values[cut[i]:cut[i + 1]])
             for (stamps, values), cut in zip(samples, cuts, strict=True)]
            for i in range(count)]


class _Writer(Rosbag2Writer):
    """The writer of rosbags, which makes metadata.yaml, on top of a file of whole blocks."""

    def __init__(self, path: Path, metadata: Mapping[str, str]) -> None:
        super().__init__(path, version=9, storage_plugin=StoragePlugin.MCAP)
        for key, value in metadata.items():
            self.set_custom_data(key, value)

        self.first_stamp, self.last_stamp = 1 << 62, 0

        def storage(folder: Path, compression: CompressionMode) -> _Storage:
            return _Storage(folder, metadata)

        self.STORAGE_PLUGINS = {StoragePlugin.MCAP: storage}

    def write_chunk(
        self, parts: Sequence[tuple[Connection, NDArray[np.int64], NDArray[np.uint8]]],
    ) -> None:
        """Write messages of several topics as one chunk."""
        parts = [part for part in parts if len(part[1])]
        self.storage.write_chunk(parts)
        for connection, stamps, _ in parts:
            self.counts[connection.id] += len(stamps)
            self.first_stamp = min(self.first_stamp, int(stamps.min()))
            self.last_stamp = max(self.last_stamp, int(stamps.max()))

    def close(self) -> None:
        """Write metadata.yaml with the content of the chunks."""
        self.min_timestamp, self.max_timestamp = self.first_stamp, self.last_stamp
        super().close()


class _Storage:
    """One MCAP file of blocks, in the form of a storage of the rosbags writer."""

    def __init__(self, folder: Path, metadata: Mapping[str, str]) -> None:
        self.path = folder / f'{folder.name}_0.mcap'
        self._file = McapBlockFile(self.path, 'saddlering_ros')
        self._file.add_metadata(RECORD, metadata)  # First, so that a file that is cut off has it.
        self._schemas: dict[str, int] = {}
        self._channels: dict[int, int] = {}

    def add_msgtype(self, connection: Connection) -> None:
        self._schemas[connection.msgtype] = self._file.add_schema(
            connection.msgtype, 'ros2msg', connection.msgdef.data.encode())

    def add_connection(self, connection: Connection, offered_qos_profiles: str) -> None:
        self._channels[connection.id] = self._file.add_channel(
            connection.topic, self._schemas[connection.msgtype],
            {'offered_qos_profiles': offered_qos_profiles, 'topic_type_hash': connection.digest})

    def write_chunk(
        self, parts: Sequence[tuple[Connection, NDArray[np.int64], NDArray[np.uint8]]],
    ) -> None:
        self._file.add_chunk([
            MessageBlock(self._channels[connection.id], stamps, messages)
            for connection, stamps, messages in parts])

    def close(self, version: int, metadata: str) -> None:
        self._file.add_metadata('rosbag2', {'serialized_metadata': metadata})
        self._file.finish()

    def abort(self) -> None:
        with suppress(OSError):
            self._file.abort()
