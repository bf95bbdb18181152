"""A bag written message by message, of any types with known definitions."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
import shutil
import tempfile
from types import TracebackType

from rosbags.interfaces import Qos, QosDurability, QosReliability
from rosbags.typesys import get_types_from_msg, get_typestore, Stores
from rosbags.typesys.store import Typestore

from saddlering_ros.bags.errors import BagError
from saddlering_ros.bags.writer import (
    _check_target,
    _put_in_place,
    _RELIABLE,
    _Writer,
)

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
        _check_target(self.path, overwrite)
        try:
            self.path.parent.mkdir(parents=True, exist_ok=True)
            self._folder = Path(tempfile.mkdtemp(prefix=f'.{self.path.name}.recording.',
                                                 dir=self.path.parent))
        except OSError as problem:
            raise BagError(self._complaint(problem)) from problem
        self._written = self._folder / self.path.name
        self._writer = _Writer(self._written, dict(facts or {}), CHUNK_SIZE)
        self._writer.open()
        store = _store(definitions or {})
        self._connections = {
            topic: self._writer.add_connection(
                topic, kind, typestore=store,
                offered_qos_profiles=[_latched() if topic in latched else _RELIABLE])
            for topic, kind in topics.items()}

    def write(self, topic: str, log_time: int, message: bytes) -> None:
        """Add one serialized message that was received at `log_time` [ns]."""
        try:
            self._writer.write(self._connections[topic], log_time, message)
        except OSError as problem:
            self._failed = True
            raise self._unwritable(problem) from problem
        self.messages += 1

    def __enter__(self) -> BagRecording:
        return self

    def __exit__(self, kind: type[BaseException] | None, problem: BaseException | None,
                 trace: TracebackType | None) -> None:
        if self._failed:  # The failed part lies in the middle if there is room again by now.
            self._writer.abort()
            return
        try:
            self._writer.close()
            _put_in_place(self._written, self.path)
        except OSError as fault:
            self._writer.abort()
            raise self._unwritable(fault) from fault
        shutil.rmtree(self._folder, ignore_errors=True)

    def _unwritable(self, problem: OSError) -> BagError:
        return BagError(f'{self._complaint(problem)}; the recording until then is readable in '
                        f'{self._written}')

    def _complaint(self, problem: OSError) -> str:
        return (f'{self.path}: cannot be written ({problem.strerror or problem}): '
                'choose another place')


def _latched() -> Qos:
    return _RELIABLE._replace(durability=QosDurability.TRANSIENT_LOCAL,
                              reliability=QosReliability.RELIABLE)


def _store(definitions: Mapping[str, str]) -> Typestore:
    store = get_typestore(Stores.ROS2_JAZZY)
    for kind, text in definitions.items():
        store.register(get_types_from_msg(text, kind))
    return store
