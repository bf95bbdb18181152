"""Bags in the form of a recorder: rosbag2 directories with one zstd-chunked MCAP file."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike, NDArray
from rosbags.typesys import get_typestore, Stores

from saddlering_ros.bags.bag_folder import (
    BagFolder,
    check_target,
    FOLDER_RECORD,
    LIBRARY,
    put_in_place,
)
from saddlering_ros.bags.cdr import encode
from saddlering_ros.bags.mcap_blocks import McapBlockFile, MessageBlock, record_size
from saddlering_ros.files import temporary_folder
from saddlering_ros.record.errors import BagError
from saddlering_ros.record.metadata import METADATA_RECORD, TestMetadata
from saddlering_ros.record.topics import LOAD, PROBES, RigTopic, TOPICS
from saddlering_ros.rig import Probes

CHUNK_SIZE = 1 << 20
"""Bytes of messages per chunk before compression."""


def write_bag(
    path: Path | str,
    facts: TestMetadata,
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
    path = Path(path)
    span = {'min_range': probes.min_range, 'max_range': probes.max_range}
    absent = PROBES[probes.absent - 1] if probes.absent else None
    channels = [messages_of(LOAD, load_stamps, load)]
    channels += [messages_of(topic, stamps, gap, **span)
                 for topic, stamps, gap in zip(PROBES, probe_stamps, gaps, strict=True)
                 if topic is not absent]
    channels += [messages_of(TOPICS[name], *samples) for name, samples in (others or {}).items()]
    check_target(path, overwrite)
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        with temporary_folder(path.parent, f'.{path.name}.') as temporary:
            _write_directory(temporary / path.name, facts, channels, log_delay, chunk_size)
            put_in_place(temporary / path.name, path)
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


class BlockBag:
    """The files of a bag of the rig's topics that is being written by blocks of messages.

    The metadata record of the facts comes first, so that a file that is cut off has it.
    """

    def __init__(self, path: Path, topics: Sequence[RigTopic], facts: Mapping[str, str]) -> None:
        self._folder = BagFolder(path, facts)
        self._file = McapBlockFile(self._folder.file, LIBRARY)
        self._file.add_metadata(METADATA_RECORD, facts)
        store = get_typestore(Stores.ROS2_JAZZY)
        schemas: dict[str, int] = {}
        for number, topic in enumerate(topics, start=1):
            added = self._folder.add_topic(topic.name, topic.type, store)
            if topic.type not in schemas:
                schemas[topic.type] = self._file.add_schema(
                    topic.type, 'ros2msg', added.definition.encode())
            channel = self._file.add_channel(
                topic.name, schemas[topic.type], added.channel_metadata())
            assert channel == number

    @property
    def messages(self) -> int:
        """Number of messages written."""
        return sum(topic.count for topic in self._folder.topics)

    def write_chunk(
        self, parts: Sequence[tuple[NDArray[np.int64], NDArray[np.uint8]]],
    ) -> None:
        """Write log times (N_i,) [ns] and messages (N_i, size) of each topic as one chunk."""
        self._file.add_chunk([
            MessageBlock(number, stamps, messages)
            for number, (stamps, messages) in enumerate(parts, start=1)])
        for topic, (stamps, _) in zip(self._folder.topics, parts, strict=True):
            if len(stamps):
                topic.add(len(stamps), int(stamps.min()), int(stamps.max()))

    def close(self) -> None:
        """Write the end of the file, and metadata.yaml."""
        self._file.add_metadata(FOLDER_RECORD, self._folder.record())
        self._file.finish()
        self._folder.describe()

    def abort(self) -> None:
        """Close the file without a summary."""
        self._file.abort()


def _write_directory(
    path: Path, facts: TestMetadata, channels: Sequence[TopicMessages], log_delay: int,
    chunk_size: int,
) -> None:
    bag = BlockBag(path, [TOPICS[channel.topic] for channel in channels], facts.as_text())
    try:
        which = np.repeat(np.arange(len(channels)), [len(c.stamps) for c in channels])
        index = np.concatenate([np.arange(len(channel.stamps)) for channel in channels])
        stamps = np.concatenate([channel.stamps for channel in channels])
        order = np.argsort(stamps, kind='stable')
        sizes = np.array([record_size(channel.messages) for channel in channels])
        chunk_of = (np.cumsum(sizes[which[order]]) - 1) // chunk_size
        for chunk in np.split(order, np.flatnonzero(np.diff(chunk_of)) + 1):
            mine = [index[chunk[which[chunk] == number]] for number in range(len(channels))]
            bag.write_chunk([
                (channel.stamps[rows] + log_delay, channel.messages[rows])
                for channel, rows in zip(channels, mine, strict=True)])
        bag.close()
    except BaseException:
        bag.abort()
        raise
