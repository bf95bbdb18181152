"""The bags under a folder: their test metadata, their time and the hash of their files."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from datetime import datetime, timezone
import os
from pathlib import Path

from mcap.reader import SeekingReader

from saddlering_ros.bags.directory import (
    BagDirectory,
    METADATA,
    open_directory,
    plain_file,
    read_metadata,
    SUFFIXES,
)
from saddlering_ros.campaign.errors import CampaignError
from saddlering_ros.record.errors import BagError
from saddlering_ros.record.metadata import METADATA_RECORD


@dataclass(frozen=True)
class FoundBag:
    """One bag as found; its readings have not been read.

    path: the rosbag2 directory or the bare file; sha256: of its files; time [s since 1970] of the
    test, None if unknown; metadata: the test metadata (interfaces.md), text to text; problem: why
    the bag cannot be used ('' if it can).
    """

    path: Path
    sha256: str = ''
    time: float | None = None
    metadata: tuple[tuple[str, str], ...] = ()
    problem: str = ''

    def fact(self, name: str) -> str:
        """One entry of the test metadata, '' if the bag does not state it."""
        return dict(self.metadata).get(name, '').strip()

    @property
    def ring(self) -> str:
        """Which ring was tested: `ring` of the metadata, else `rig`, else the folder's name."""
        return self.fact('ring') or self.fact('rig') or self.path.parent.name

    @property
    def bench(self) -> str:
        """Which test rig did it: `bench` of the metadata, else the rig file's hash, else ''."""
        return self.fact('bench') or self.fact('rig_hash')[:12]

    @property
    def test(self) -> str:
        """Kind of the test and its elevation in degrees, as `dynamic 50`."""
        return f'{self.fact("test") or "?"} {self.fact("elevation_deg") or "?"}'

    @property
    def service_hours(self) -> float | None:
        """Hours of service of the ring at the test, None if the bag does not state them."""
        try:
            return float(self.fact('service_hours'))
        except ValueError:
            return None


def find_bags(
    folder: Path | str, on_progress: Callable[[int], None] | None = None
) -> list[FoundBag]:
    """Every bag under `folder` at any depth, in order of path; links to folders are not followed.

    A folder with metadata.yaml, or with .mcap files of one split recording, is one bag; any other
    .mcap file is a bag of its own. CampaignError where there is no such folder.
    """
    folder = Path(folder)
    if not folder.is_dir():
        raise CampaignError(f'{folder}: is not a folder: give the folder that holds the bags')
    found = []
    for path in _places(folder):
        found.append(look_at(path))
        if on_progress is not None:
            on_progress(len(found))
    return found


def _places(folder: Path) -> Iterator[Path]:
    for here, folders, files in os.walk(folder):
        folders.sort()
        place = Path(here)
        recordings = sorted(name for name in files if name.endswith(SUFFIXES))
        if METADATA in files:
            folders.clear()
            yield place
        elif _one_recording(place.name, recordings):
            yield place
        else:
            yield from (place / name for name in recordings)


def _one_recording(name: str, files: list[str]) -> bool:
    """Whether the files are parts that rosbag2 names after their folder: name_0, name_1, ..."""
    parts = [file.partition('.mcap')[0] for file in files]
    return len(parts) > 1 and {f'{name}_{number}' for number in range(len(parts))} == set(parts)


def look_at(path: Path) -> FoundBag:
    """The bag at `path`; a fault becomes its `problem`."""
    try:
        directory = open_directory(path)
        metadata, start = _metadata_of(directory)
        return FoundBag(path, directory.sha256(), _time_of(metadata, start),
                        tuple(sorted(metadata.items())))
    except BagError as fault:
        return FoundBag(path, problem=str(fault))
    except OSError as fault:
        return FoundBag(path, problem=f'{path}: cannot be read ({fault.strerror}): check the path')


def _metadata_of(directory: BagDirectory) -> tuple[dict[str, str], int | None]:
    """Test metadata and start [ns] by the summaries alone; no message is read."""
    metadata = dict(directory.custom_data)
    start = _start_in_metadata(directory)
    if metadata and start is not None:
        return metadata, start
    for file in directory.files:
        try:
            with plain_file(file) as plain, plain.open('rb') as stream:
                reader = SeekingReader(stream)
                for record in reader.iter_metadata():
                    if record.name == METADATA_RECORD:
                        metadata = {**record.metadata, **metadata}
                summary = reader.get_summary()
                if start is None and summary is not None and summary.statistics is not None:
                    start = summary.statistics.message_start_time
        except Exception:  # of six unrelated types; reading the bag will report its damage
            continue
    return metadata, start


def _start_in_metadata(directory: BagDirectory) -> int | None:
    if not directory.has_metadata or not directory.path.is_dir():
        return None
    start = read_metadata(directory.path / METADATA).get('starting_time')
    value = start.get('nanoseconds_since_epoch') if isinstance(start, dict) else None
    return value if isinstance(value, int) else None


def _time_of(metadata: dict[str, str], start: int | None) -> float | None:
    """The date that the bag states, else the first stamp of its recorder [s since 1970]."""
    stated = metadata.get('date', '').strip()
    if stated:
        try:
            date = datetime.fromisoformat(stated.replace('Z', '+00:00'))
        except ValueError:
            date = None
        if date is not None:
            return date.replace(tzinfo=date.tzinfo or timezone.utc).timestamp()
    return None if start is None else start / 1e9
