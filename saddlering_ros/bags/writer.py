"""Bags in the form of a recorder: rosbag2 directories with one zstd-chunked MCAP file.

rosbags writes metadata.yaml (quality of service, type hashes, custom data). The mcap package
writes the MCAP file, because its files have checksums and metadata records.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import BinaryIO

from mcap.writer import CompressionType
from mcap.writer import Writer as McapWriter
import numpy as np
from numpy.typing import ArrayLike, NDArray
from rosbags.interfaces import (
    Connection,
    Qos,
    QosDurability,
    QosHistory,
    QosLiveliness,
    QosReliability,
    QosTime,
)
from rosbags.rosbag2 import CompressionMode, StoragePlugin
from rosbags.rosbag2 import Writer as Rosbag2Writer
from rosbags.typesys import get_typestore, Stores

from saddlering_ros.bags.cdr import encode
from saddlering_ros.bags.errors import BagError
from saddlering_ros.bags.facts import RECORD, TestFacts
from saddlering_ros.bags.topics import LOAD, PROBES, RigTopic, TOPICS
from saddlering_ros.rig import Probes
from saddlering_ros.writing import exchange, settle, temporary_folder

CHUNK_SIZE = 1 << 20
"""Bytes of messages per chunk before compression."""

_FOREVER = QosTime(9223372036, 854775807)
_RELIABLE = Qos(
    QosHistory.KEEP_LAST, 1000, QosReliability.RELIABLE, QosDurability.VOLATILE,
    _FOREVER, _FOREVER, QosLiveliness.AUTOMATIC, _FOREVER, False)


def write_bag(
    path: Path | str,
    facts: TestFacts,
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
    of optional topics by name. `log_delay` [ns] is put
    between a stamp and its log time. An existing bag is replaced only if `overwrite` is
    set, and anything else at `path` never.
    """
    path = Path(path)
    span = {'min_range': probes.min_range, 'max_range': probes.max_range}
    channels = [messages_of(LOAD, load_stamps, load)]
    channels += [messages_of(topic, stamps, gap, **span)
                 for topic, stamps, gap in zip(PROBES, probe_stamps, gaps, strict=True)]
    channels += [messages_of(TOPICS[name], *samples) for name, samples in (others or {}).items()]
    _check_target(path, overwrite)
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        with temporary_folder(path.parent, f'.{path.name}.') as temporary:
            _write_directory(temporary / path.name, facts, channels, log_delay, chunk_size)
            _put_in_place(temporary / path.name, path)
    except OSError as problem:
        raise BagError(
            f'{path}: cannot be written ({problem.strerror}): choose another place') from problem
    return path


@dataclass(frozen=True)
class TopicMessages:
    """All messages of one topic: stamps (N,) [ns], and their CDR bytes, one row each (N, size)."""

    topic: str
    stamps: NDArray[np.int64]
    messages: NDArray[np.uint8]


def messages_of(topic: RigTopic, stamps: ArrayLike, values: ArrayLike,
                **span: float) -> TopicMessages:
    """Messages of `topic` with `values` as its readings, and the ends of the sensor's range."""
    stamps = np.asarray(stamps, dtype=np.int64)
    values = np.asarray(values, dtype=np.float64)
    if stamps.ndim != 1 or stamps.shape != values.shape:
        raise BagError(f'{topic.name}: {stamps.shape} stamps and {values.shape} readings were '
                       'given to write: give one array of each, of equal length')
    messages = encode(topic.type, topic.frame_id, stamps, {topic.field: values, **span})
    return TopicMessages(topic.name, stamps, messages)


def _write_directory(
    path: Path, facts: TestFacts, channels: Sequence[TopicMessages], log_delay: int,
    chunk_size: int,
) -> None:
    typestore = get_typestore(Stores.ROS2_JAZZY)
    writer = _Writer(path, facts.as_text(), chunk_size)
    with writer:
        connections = [
            writer.add_connection(
                channel.topic, TOPICS[channel.topic].type, typestore=typestore,
                offered_qos_profiles=[_RELIABLE])
            for channel in channels]
        which = np.repeat(np.arange(len(channels)), [len(c.stamps) for c in channels])
        index = np.concatenate([np.arange(len(channel.stamps)) for channel in channels])
        stamps = np.concatenate([channel.stamps for channel in channels])
        order = np.argsort(stamps, kind='stable')
        for place in order.tolist():
            channel = channels[which[place]]
            writer.write(
                connections[which[place]], int(stamps[place]) + log_delay,
                channel.messages[index[place]].tobytes())


class _Writer(Rosbag2Writer):
    """rosbags' writer with MCAP files by the mcap package; they carry the facts of the test."""

    def __init__(self, path: Path, facts: Mapping[str, str], chunk_size: int) -> None:
        super().__init__(path, version=9, storage_plugin=StoragePlugin.MCAP)
        for key, value in facts.items():
            self.set_custom_data(key, value)

        def storage(folder: Path, compression: CompressionMode) -> _McapStorage:
            return _McapStorage(folder, facts, chunk_size)

        self.STORAGE_PLUGINS = {StoragePlugin.MCAP: storage}


class _McapStorage:
    """One zstd-chunked MCAP file with checksums, as a storage of the rosbags writer."""

    def __init__(self, folder: Path, facts: Mapping[str, str], chunk_size: int) -> None:
        self.path = folder / f'{folder.name}_0.mcap'
        self._facts = dict(facts)
        self._file: BinaryIO = self.path.open('xb')
        self._writer = McapWriter(
            self._file, chunk_size=chunk_size, compression=CompressionType.ZSTD,
            enable_crcs=True)
        self._writer.start(profile='ros2', library='saddlering_ros')
        self._writer.add_metadata(RECORD, self._facts)  # First, so that a file that is cut off has
                                                        # it.
        self._schemas: dict[str, int] = {}
        self._channels: dict[int, int] = {}
        self._sequences: dict[int, int] = {}

    def add_msgtype(self, connection: Connection) -> None:
        self._schemas[connection.msgtype] = self._writer.register_schema(
            name=connection.msgtype, encoding='ros2msg', data=connection.msgdef.data.encode())

    def add_connection(self, connection: Connection, offered_qos_profiles: str) -> None:
        self._channels[connection.id] = self._writer.register_channel(
            topic=connection.topic, message_encoding='cdr',
            schema_id=self._schemas[connection.msgtype],
            metadata={'offered_qos_profiles': offered_qos_profiles,
                      'topic_type_hash': connection.digest})

    def write(self, connection: Connection, timestamp: int, data: bytes | memoryview) -> None:
        self._writer.add_message(
            self._channels[connection.id], log_time=timestamp, publish_time=timestamp,
            data=bytes(data))

    def close(self, version: int, metadata: str) -> None:
        self._writer.add_metadata('rosbag2', {'serialized_metadata': metadata})
        self._writer.finish()
        self._file.close()

    def abort(self) -> None:
        with suppress(OSError):
            self._file.close()


def _check_target(path: Path, overwrite: bool) -> None:
    if not path.exists():
        return
    if not overwrite:
        raise BagError(f'{path}: exists already: choose another name, or remove it first')
    is_bag = path.is_dir() and all(
        file.name == 'metadata.yaml' or file.suffix == '.mcap' for file in path.iterdir())
    if not is_bag:
        raise BagError(f'{path}: exists and is not a bag, so that it is not replaced: choose '
                       'another name')


def _put_in_place(written: Path, path: Path) -> None:
    """Move the finished bag to `path` and remove an earlier one at the same moment."""
    for file in written.iterdir():
        settle(file)
    if path.exists():
        exchange(written, path)
    else:
        written.rename(path)
    settle(path.parent)
