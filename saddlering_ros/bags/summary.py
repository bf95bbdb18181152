"""The summary at the end of an MCAP file, which is read quickly for a bag of any length.

Source of the format: the MCAP specification (https://mcap.dev/spec), summary section.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
import struct

from saddlering_ros.bags.folder import open_directory

_MAGIC = b'\x89MCAP0\r\n'
_FOOTER = struct.Struct('<BQQQI')
_RECORD = struct.Struct('<BQ')
_STATISTICS = struct.Struct('<QHIIIIQQ')
_FOOTER_CODE, _STATISTICS_CODE = 0x02, 0x0B

MAX_SUMMARY = 1 << 26
"""Largest stated size [bytes] of a summary that is read."""


@dataclass(frozen=True)
class BagSummary:
    """Counts in the files of a bag: messages, topics, time between log times [s]."""

    messages: int
    topics: int
    seconds: float

    def __str__(self) -> str:
        return f'{self.messages} messages of {self.topics} topics over {self.seconds:.1f} s'


def summary_of_bag(path: Path | str) -> BagSummary | None:
    """The summary of all files of a bag; None if one of them has none. It is not checked.

    BagError if there is no bag at all.
    """
    found = [_statistics(file) for file in open_directory(path).files]
    known = [one for one in found if one is not None]
    if not known or len(known) < len(found):
        return None
    starts = [start for messages, _, start, _ in known if messages]
    stops = [stop for messages, _, _, stop in known if messages]
    seconds = (max(stops) - min(starts)) * 1e-9 if starts else 0.0
    return BagSummary(sum(one[0] for one in known), max(one[1] for one in known), seconds)


def _statistics(path: Path) -> tuple[int, int, int, int] | None:
    """Messages, channels, first and last log time [ns] by the statistics record of a file."""
    try:
        with path.open('rb') as file:
            size = file.seek(0, 2)
            end = size - len(_MAGIC) - _FOOTER.size
            if end < 0:
                return None
            file.seek(end)
            foot = file.read(_FOOTER.size)
            code, _, start, _, _ = _FOOTER.unpack(foot)
            if file.read() != _MAGIC or code != _FOOTER_CODE:
                return None
            if not 0 < start <= end or end - start > MAX_SUMMARY:
                return None
            file.seek(start)
            return _find_statistics(file.read(end - start))
    except (OSError, struct.error):
        return None


def _find_statistics(summary: bytes) -> tuple[int, int, int, int] | None:
    place = 0
    while place + _RECORD.size <= len(summary):
        code, length = _RECORD.unpack_from(summary, place)
        place += _RECORD.size
        if code == _STATISTICS_CODE:
            fields = _STATISTICS.unpack_from(summary, place)
            return fields[0], fields[2], fields[6], fields[7]
        place += length
    return None
