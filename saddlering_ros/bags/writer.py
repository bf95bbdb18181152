"""Bags as a recorder leaves them: rosbag2 directories with one zstd-chunked MCAP file.

rosbags writes metadata.yaml (quality of service, type hashes, custom data); the MCAP file itself
is written by the mcap package, since its files carry checksums and metadata records.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
import shutil
import tempfile
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

from saddlering_ros.bags.errors import BagError
from saddlering_ros.bags.facts import RECORD, TestFacts
from saddlering_ros.bags.topics import (
    FRAME_OF_TOPIC,
    LOAD_TOPIC,
    PROBE_TOPICS,
    TYPE_OF_TOPIC,
)
from saddlering_ros.rig import Probes
from saddlering_ros.writing import exchange, settle

CHUNK_SIZE = 1 << 20
"""Bytes of messages per chunk before compression."""

_FOREVER = QosTime(9223372036, 854775807)
_RELIABLE = Qos(
    QosHistory.KEEP_LAST, 1000, QosReliability.RELIABLE, QosDurability.VOLATILE,
    _FOREVER, _FOREVER, QosLiveliness.AUTOMATIC, _FOREVER, False)

_INFRARED = 1
"""Radiation type of sensor_msgs/Range; of its two, the other (ultrasound) is further off."""


def write_bag(
    path: Path | str,
    facts: TestFacts,
    load_stamps: ArrayLike,
    load: ArrayLike,
    probe_stamps: Sequence[ArrayLike],
    gaps: Sequence[ArrayLike],
    probes: Probes,
    *,
    log_delay: int = 0,
    chunk_size: int = CHUNK_SIZE,
    overwrite: bool = False,
) -> Path:
    """Write a rosbag2 directory at `path`, complete or not at all; return the path.

    load_stamps (N,) int64 [ns], load (N,) [N]; probe_stamps and gaps: four arrays each, (M_i,)
    int64 [ns] and (M_i,) [m] (kept as float32, the message's type). `log_delay` [ns] is put
    between a stamp and its log time. An existing bag is replaced only if `overwrite` is
    set, and anything else at `path` never.
    """
    path = Path(path)
    channels = [_wrenches(load_stamps, load)]
    for topic, stamps, gap in zip(PROBE_TOPICS, probe_stamps, gaps, strict=True):
        channels.append(_ranges(topic, stamps, gap, probes))
    _check_target(path, overwrite)
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        temporary = Path(tempfile.mkdtemp(prefix=f'.{path.name}.', dir=path.parent))
    except OSError as problem:
        raise BagError(
            f'{path}: cannot be written ({problem.strerror}): choose another place') from problem
    try:
        _write_directory(temporary / path.name, facts, channels, log_delay, chunk_size)
        _put_in_place(temporary / path.name, path)
    except OSError as problem:
        raise BagError(
            f'{path}: cannot be written ({problem.strerror}): choose another place') from problem
    finally:
        shutil.rmtree(temporary, ignore_errors=True)
    return path


@dataclass(frozen=True)
class _Channel:
    """All messages of one topic: stamps (N,) [ns], and their CDR bytes, one row each (N, size)."""

    topic: str
    stamps: NDArray[np.int64]
    messages: NDArray[np.uint8]


def _wrenches(stamps: ArrayLike, load: ArrayLike) -> _Channel:
    """WrenchStamped messages with force.x = load and nothing else."""
    def fill(table: NDArray[np.void], values: NDArray[np.float64]) -> None:
        table['force'][:, 0] = values

    return _messages(LOAD_TOPIC, stamps, load, ('pad', 8), [('force', '<f8', (6,))], fill)


def _ranges(topic: str, stamps: ArrayLike, gaps: ArrayLike, probes: Probes) -> _Channel:
    """Range messages with range = gap and the probe's span."""
    def fill(table: NDArray[np.void], values: NDArray[np.float64]) -> None:
        table['radiation_type'] = _INFRARED
        table['min_range'] = probes.min_range
        table['max_range'] = probes.max_range
        table['range'] = values

    names = ('field_of_view', 'min_range', 'max_range', 'range', 'variance')
    return _messages(topic, stamps, gaps, ('radiation_type', 4),
                     [(name, '<f4', ()) for name in names], fill)


_Field = tuple[str, str, tuple[int, ...]]
_Fill = Callable[[NDArray[np.void], NDArray[np.float64]], None]


def _messages(
    topic: str, stamps: ArrayLike, values: ArrayLike, lead: tuple[str, int],
    numbers: Sequence[_Field], fill: _Fill,
) -> _Channel:
    """CDR messages of `topic`: header, one leading byte or none, then `numbers`, set by `fill`.

    `lead` names what stands before the numbers ('pad' for nothing) and gives their alignment.
    """
    stamps = np.asarray(stamps, dtype=np.int64)
    values = np.asarray(values, dtype=np.float64)
    if stamps.ndim != 1 or stamps.shape != values.shape:
        raise BagError(f'{topic}: {stamps.shape} stamps and {values.shape} readings were given '
                       'to write: give one array of each, of equal length')
    frame = FRAME_OF_TOPIC[topic].encode() + b'\0'
    name, alignment = lead
    end = 12 + len(frame)
    before = [] if name == 'pad' else [(name, 'u1', ())]
    padding = -(end + len(before)) % alignment
    table = np.zeros(len(stamps), dtype=np.dtype([
        ('encapsulation', 'u1', (4,)), ('seconds', '<i4'), ('nanoseconds', '<u4'),
        ('length', '<u4'), ('frame', f'S{len(frame)}'), *before,
        ('padding', 'u1', (padding,)), *numbers]))
    table['encapsulation'] = (0, 1, 0, 0)
    table['seconds'], table['nanoseconds'] = np.divmod(stamps, 1_000_000_000)
    table['length'], table['frame'] = len(frame), frame
    fill(table, values)
    return _Channel(topic, stamps, table.view(np.uint8).reshape(len(stamps), -1))


def _write_directory(
    path: Path, facts: TestFacts, channels: Sequence[_Channel], log_delay: int, chunk_size: int,
) -> None:
    typestore = get_typestore(Stores.ROS2_JAZZY)
    writer = _Writer(path, facts.as_text(), chunk_size)
    with writer:
        connections = [
            writer.add_connection(
                channel.topic, TYPE_OF_TOPIC[channel.topic], typestore=typestore,
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
    """One zstd-chunked MCAP file with checksums, as rosbags' writer wants its storages."""

    def __init__(self, folder: Path, facts: Mapping[str, str], chunk_size: int) -> None:
        self.path = folder / f'{folder.name}_0.mcap'
        self._facts = dict(facts)
        self._file: BinaryIO = self.path.open('xb')
        self._writer = McapWriter(
            self._file, chunk_size=chunk_size, compression=CompressionType.ZSTD,
            enable_crcs=True)
        self._writer.start(profile='ros2', library='saddlering_ros')
        self._writer.add_metadata(RECORD, self._facts)  # first, so that a file cut off has it
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
        raise BagError(f'{path}: exists and is no bag, it is not replaced: choose another name')


def _put_in_place(written: Path, path: Path) -> None:
    """Move the finished bag to `path`; one that was there leaves at the same moment."""
    for file in written.iterdir():
        settle(file)
    if path.exists():
        exchange(written, path)
    else:
        written.rename(path)
    settle(path.parent)
