"""A bag of any size, written block by block in the memory of one block.

NumPy encodes the messages of a block and puts them into the file, about thirty times as fast as
message by message.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from contextlib import ExitStack
from pathlib import Path
from types import TracebackType

import numpy as np
from numpy.typing import NDArray

from saddlering_ros.bags.bag_folder import check_target, put_in_place
from saddlering_ros.bags.cdr import encode
from saddlering_ros.bags.writer import BlockBag
from saddlering_ros.files import temporary_folder
from saddlering_ros.record.errors import BagError
from saddlering_ros.record.topics import RigTopic

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
        check_target(self.path, overwrite)
        try:
            self.path.parent.mkdir(parents=True, exist_ok=True)
            folder = self._stack.enter_context(
                temporary_folder(self.path.parent, f'.{self.path.name}.'))
        except OSError as problem:
            raise self._unwritable(problem) from problem
        self._written = folder / self.path.name
        self._metadata = dict(metadata)
        self._bag: BlockBag | None = None

    @property
    def messages(self) -> int:
        """Number of messages written."""
        return self._bag.messages if self._bag is not None else 0

    def write(
        self, samples: Sequence[tuple[NDArray[np.int64], NDArray[np.float64]]],
    ) -> None:
        """Add stamps (N_i,) [ns] and readings (N_i,) [SI] of each topic, in order of the topics.

        Every stamp must be later than those of the block before.
        """
        assert self._bag is not None
        try:
            for part in _parts(samples):
                self._bag.write_chunk([
                    (stamps, self._encode(topic, span, stamps, values))
                    for (topic, span), (stamps, values) in zip(self._topics, part, strict=True)])
        except OSError as problem:
            raise self._unwritable(problem) from problem

    def __enter__(self) -> BlockBagWriter:
        self._bag = BlockBag(self._written, [topic for topic, _ in self._topics], self._metadata)
        return self

    def __exit__(self, kind: type[BaseException] | None, problem: BaseException | None,
                 trace: TracebackType | None) -> None:
        assert self._bag is not None
        try:
            if kind is not None:
                self._bag.abort()
                return
            self._bag.close()
            check_target(self.path, self._overwrite)
            put_in_place(self._written, self.path)
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
