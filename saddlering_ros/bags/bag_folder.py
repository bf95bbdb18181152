"""The files beside the MCAP file of a rosbag2 bag that is being written: metadata.yaml.

rosbags knows the definitions of the messages and their hashes. Its own writer forms every text of
YAML by pure Python, several times a bag, which took half the time of a short bag.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Any

from rosbags.interfaces import (
    Qos,
    QosDurability,
    QosHistory,
    QosLiveliness,
    QosReliability,
    QosTime,
)
from rosbags.typesys.store import Typestore
import yaml

from saddlering_ros.files import exchange, settle
from saddlering_ros.record.errors import BagError

VERSION = 9
"""Of the form of metadata.yaml: that of Jazzy."""

LIBRARY = 'saddlering_ros'
"""Name of the writer in MCAP files."""

FOLDER_RECORD = 'rosbag2'
"""Name of the MCAP metadata record that holds the content of metadata.yaml."""

_FOREVER = QosTime(9223372036, 854775807)
RELIABLE = Qos(
    QosHistory.KEEP_LAST, 1000, QosReliability.RELIABLE, QosDurability.VOLATILE,
    _FOREVER, _FOREVER, QosLiveliness.AUTOMATIC, _FOREVER, False)

_DUMPER = getattr(yaml, 'CSafeDumper', yaml.SafeDumper)
"""libyaml's where PyYAML was built with it; both write the same text."""


@dataclass
class BagTopic:
    """A topic of a bag, and the number and log times [ns] of its messages so far."""

    name: str
    type: str
    definition: str
    type_hash: str
    qos: Qos
    count: int = 0
    first: int = 2 ** 63 - 1
    last: int = 0

    def add(self, count: int, first: int, last: int) -> None:
        """Count further messages, of log times `first` to `last` [ns]."""
        self.count += count
        self.first, self.last = min(self.first, first), max(self.last, last)

    def channel_metadata(self) -> dict[str, str]:
        """The texts of the topic's channel in the MCAP file."""
        return {'offered_qos_profiles': _qos_text(self.qos), 'topic_type_hash': self.type_hash}


class BagFolder:
    """A rosbag2 directory at `path`, which it makes; `facts` are its custom data."""

    def __init__(self, path: Path, facts: Mapping[str, str]) -> None:
        path.mkdir(mode=0o755, parents=True)
        self.path = path
        self.file = path / f'{path.name}_0.mcap'
        self.topics: list[BagTopic] = []
        self._facts = dict(facts)

    def add_topic(self, name: str, kind: str, store: Typestore, qos: Qos = RELIABLE) -> BagTopic:
        """Add a topic of the message type `kind`, which `store` knows."""
        definition, _ = store.generate_msgdef(kind, ros_version=2)
        self.topics.append(BagTopic(name, kind, definition, store.hash_rihs01(kind), qos))
        return self.topics[-1]

    def record(self) -> dict[str, str]:
        """The MCAP file's record FOLDER_RECORD."""
        return {'serialized_metadata': _text(self._information()).strip()}

    def describe(self) -> None:
        """Write metadata.yaml, when the MCAP file is complete."""
        (self.path / 'metadata.yaml').write_text(
            _text({'rosbag2_bagfile_information': self._information()}), 'utf-8')

    def _information(self) -> dict[str, Any]:
        count = sum(topic.count for topic in self.topics)
        start = min((topic.first for topic in self.topics), default=2 ** 63 - 1)
        last = max((topic.last for topic in self.topics), default=0)
        times = {'starting_time': {'nanoseconds_since_epoch': start},
                 'duration': {'nanoseconds': max(0, last - start)}, 'message_count': count}
        return {
            'version': VERSION, 'storage_identifier': 'mcap',
            'relative_file_paths': [self.file.name], **times,
            'topics_with_message_count': [
                {'topic_metadata': {
                    'name': topic.name, 'type': topic.type, 'serialization_format': 'cdr',
                    'offered_qos_profiles': [_qos(topic.qos)],
                    'type_description_hash': topic.type_hash},
                 'message_count': topic.count}
                for topic in self.topics],
            'compression_format': '', 'compression_mode': '',
            'files': [{'path': self.file.name, **times}],
            'custom_data': self._facts or None, 'ros_distro': 'rosbags'}


def _qos(qos: Qos) -> dict[str, Any]:
    return {
        'history': qos.history.name.lower(), 'depth': qos.depth,
        'reliability': qos.reliability.name.lower(),
        'durability': qos.durability.name.lower(),
        'deadline': _time(qos.deadline), 'lifespan': _time(qos.lifespan),
        'liveliness': qos.liveliness.name.lower(),
        'liveliness_lease_duration': _time(qos.liveliness_lease_duration),
        'avoid_ros_namespace_conventions': qos.avoid_ros_namespace_conventions}


def _time(time: QosTime) -> dict[str, int]:
    return {'sec': time.sec, 'nsec': time.nsec}


@lru_cache(maxsize=8)
def _qos_text(qos: Qos) -> str:
    return _text([_qos(qos)]).strip()


class _WithoutAliases(_DUMPER):  # type: ignore[misc, valid-type]
    """Readers refuse aliases (&id001), by which equal parts would be named."""

    def ignore_aliases(self, data: object) -> bool:
        return True


def _text(value: object) -> str:
    text: str = yaml.dump(value, Dumper=_WithoutAliases, default_flow_style=False,
                          allow_unicode=True)
    return text


def check_target(path: Path, overwrite: bool) -> None:
    """Refuse a path at which something is that may not be replaced."""
    if not path.exists():
        return
    if not overwrite:
        raise BagError(f'{path}: exists already: choose another name, or remove it first')
    is_bag = path.is_dir() and all(
        file.name == 'metadata.yaml' or file.suffix == '.mcap' for file in path.iterdir())
    if not is_bag:
        raise BagError(f'{path}: exists and is not a bag, so that it is not replaced: choose '
                       'another name')


def put_in_place(written: Path, path: Path) -> None:
    """Move the finished bag to `path` and remove an earlier one at the same moment."""
    for file in written.iterdir():
        settle(file)
    if path.exists():
        exchange(written, path)
    else:
        written.rename(path)
    settle(path.parent)
