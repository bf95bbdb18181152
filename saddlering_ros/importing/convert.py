"""Conversion of measured files by a map into bags, for `saddlering import`."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
import fnmatch
from pathlib import Path
import re
from typing import Any

import numpy as np
from numpy.typing import NDArray

from saddlering_ros.bags.write import BagWriter, messages_of
from saddlering_ros.errors import BagError, did_you_mean, plain_number
from saddlering_ros.files import resolved
from saddlering_ros.importing import clock
from saddlering_ros.importing.calibration import ImportingError
from saddlering_ros.importing.clock import CountedTime, DatedTime, FileTime, Stamps, TimeSource
from saddlering_ros.importing.feed import Feed, first_stamp, Floats, Part, Piece
from saddlering_ros.importing.mapping import ChannelMap, ImportMap, instruments_text
from saddlering_ros.importing.preview import Envelope
from saddlering_ros.importing.source import find_column, open_source, Source
from saddlering_ros.record.metadata import TestMetadata
from saddlering_ros.record.topics import RANGE_TYPE
from saddlering_ros.rig import Rig

UNDATED = 10 * 365 * 86400 * clock.SECOND
"""A stamp before 1980 [ns] comes of a time without a date: no rig was recorded then."""

Progress = Callable[[int], None]
"""Called with the number of samples written so far."""


@dataclass(frozen=True)
class ImportedRun:
    """A bag that was written: its metadata, samples and first and last stamp [ns] of each channel.

    envelopes: the course of each channel, for a picture.
    """

    path: Path
    metadata: TestMetadata
    counts: Mapping[str, int]
    spans: Mapping[str, tuple[int, int]]
    envelopes: Mapping[str, Envelope]


@dataclass(frozen=True)
class ImportResult:
    """Bags of an import, and faults of the files (one line each)."""

    runs: tuple[ImportedRun, ...]
    warnings: tuple[str, ...]

    def as_dict(self) -> dict[str, Any]:
        """Plain data for JSON: stamps in ns, readings in SI."""
        runs = [{
            'bag': str(run.path), 'metadata': run.metadata.as_text(),
            'channels': {name: {
                'samples': count, 'first': run.spans[name][0], 'last': run.spans[name][1],
                'lowest': min(run.envelopes[name].lowest),
                'highest': max(run.envelopes[name].highest)}
                         for name, count in run.counts.items()},
        } for run in self.runs]
        return {'runs': runs, 'warnings': list(self.warnings)}


def open_sources(files: Sequence[Path], mapping: ImportMap | None = None) -> list[Source]:
    """Readers of the files; ImportingError for the same file twice."""
    seen: dict[Path, Path] = {}
    for file in files:
        if resolved(file) in seen:
            raise ImportingError(f'{file}: is given twice: give each file once')
        seen[resolved(file)] = file
    return [open_source(file, mapping.csv if mapping else None) for file in files]


def import_files(
    files: Sequence[Path], mapping: ImportMap, out: Path, *, rig: Rig | None = None,
    overwrite: bool = False, on_progress: Progress | None = None,
) -> ImportResult:
    """Write the channels of `mapping` in the files as a bag at `out`.

    If the map splits the files into runs, `out` becomes a folder with a bag for each.
    """
    sources = open_sources(files, mapping)
    feeds = _feeds(sources, mapping)
    texts = _common_metadata(sources, mapping, rig)
    runs = []
    names: set[str] = set()
    streams = [_Stream(feed) for feed in feeds]
    while True:
        pending = [stream.peek() for stream in streams]
        if all(part is None for part in pending):
            break
        first = next(part for part in pending if part is not None)
        if any(part is None or (part.run, part.label) != (first.run, first.label)
               for part in pending):
            raise ImportingError(f'{out}: the channels do not agree on the runs: their files have '
                                 'gaps, or values of the split column, at different places')
        metadata = _metadata(mapping, first, texts)
        path = _path(out, mapping, first, metadata, names)
        runs.append(_write_run(path, streams, mapping, metadata, rig, overwrite, on_progress))
    if not runs:
        raise ImportingError(f'{files[0]}: has no sample with a readable time: correct the map')
    if min(first for run in runs for first, _ in run.spans.values()) < UNDATED:
        sources[0].warnings.add('stamps count from 1970-01-01, because the time has no date: '
                                'give start: in time:')
    warnings = [line for source in sources for line in source.warnings.all()]
    return ImportResult(tuple(runs), tuple(dict.fromkeys(warnings)))


# -- which column of which file ----------------------------------------------------------------


def _feeds(sources: Sequence[Source], mapping: ImportMap) -> list[Feed]:
    """Channels that are read together, by clock."""
    channels = {channel.name: channel for channel in mapping.channels}
    pieces: dict[object, Piece] = {}
    for channel in mapping.channels:
        held = [source for source in sources if fnmatch.fnmatch(source.path.name, channel.file)]
        if not held:
            raise ImportingError(f'channels.{channel.name}: there is no file named '
                                 f'{channel.file!r}')
        for source, column in find_column(held, channel.column, f'channels.{channel.name}'):
            key = (source.path, *_clock_key(source, column, channel.time or mapping.time))
            pieces[key] = _with_channel(pieces.get(key), source, column, channel, mapping)
    # Pieces with the same channels follow each other in time.
    groups: dict[tuple[str, ...], list[Piece]] = {}
    for piece in pieces.values():
        groups.setdefault(tuple(piece.columns), []).append(piece)
    return [Feed(sorted(group, key=first_stamp) if len(group) > 1 else group, channels,
                 mapping.split) for group in groups.values()]


def _with_channel(
    piece: Piece | None, source: Source, column: str, channel: ChannelMap, mapping: ImportMap,
) -> Piece:
    """The piece with one channel more; a new one if there is none yet."""
    columns = dict(piece.columns) if piece else {}
    seconds = dict(piece.seconds) if piece else {}
    columns[channel.name] = column
    if channel.second:
        ((_, seconds[channel.name]),) = find_column(
            [source], channel.second, f'channels.{channel.name}.rod_pressure')
    split = ''
    if mapping.split is not None and mapping.split.by == 'column':
        ((_, split),) = find_column([source], mapping.split.column, 'split.column')
    return Piece(source, columns, seconds, _resolved(channel.time or mapping.time, source), split)


def _clock_key(source: Source, column: str, time: TimeSource) -> tuple[object, ...]:
    """Equal for columns that can be read row by row together."""
    found = source.column(column)
    if isinstance(time, FileTime):
        timing = found.timing
        return time, timing.column if timing is not None and timing.column else column
    if isinstance(time, (CountedTime, DatedTime)):
        return (time,)
    return time, found.rows


def _resolved(time: TimeSource, source: Source) -> TimeSource:
    """The same with the columns by their names in the file."""
    if isinstance(time, CountedTime):
        ((_, name),) = find_column([source], time.column, 'time.column')
        return CountedTime(name, time.unit, time.start)
    if isinstance(time, DatedTime):
        names = tuple(find_column([source], name, 'time.column')[0][1] for name in time.columns)
        return DatedTime(names, time.format, time.zone)
    return time


# -- test metadata of the bag ------------------------------------------------------------------


def _common_metadata(
    sources: Sequence[Source], mapping: ImportMap, rig: Rig | None,
) -> dict[str, str]:
    texts = {
        'import_sources': '; '.join(f'{source.path.name} sha256 {source.sha256}'
                                    for source in sources),
        'import_map': mapping.text}
    stated = instruments_text(mapping.channels)
    texts = {**texts, 'instruments': stated} if stated else texts
    return {**texts, 'rig_hash': rig.digest} if rig is not None else texts


def _metadata(mapping: ImportMap, part: Part, texts: Mapping[str, str]) -> TestMetadata:
    given = dict(mapping.test)
    if mapping.split is not None:
        by_label = dict(mapping.split.runs)
        label = part.label if mapping.split.by == 'column' else str(part.run + 1)
        if by_label and label not in by_label:
            raise ImportingError(
                f'split.runs: does not describe the run {label!r}'
                f'{did_you_mean(label, list(by_label))} (it has: {", ".join(by_label)})')
        given |= by_label.get(label, {})
        given.setdefault('run', label)
    for key in ('test', 'elevation_deg'):
        if key not in given:
            raise ImportingError(f'test.{key} is missing in the map: add it; '
                                 'test: static or dynamic, elevation_deg: degrees')
    try:
        elevation = plain_number(given['elevation_deg'])
        details = {key: value for key, value in given.items()
                   if key not in ('test', 'elevation_deg', 'rig', 'run')}
        return TestMetadata(given['test'], elevation, given.get('rig', ''), given.get('run', ''),
                         {**details, **texts})
    except BagError as problem:
        raise ImportingError(f'test of the map: {problem}') from problem
    except ValueError as problem:
        raise ImportingError(f'test.elevation_deg is {given["elevation_deg"]!r}: give degrees'
                             ) from problem


def _path(
    out: Path, mapping: ImportMap, part: Part, metadata: TestMetadata, names: set[str],
) -> Path:
    if mapping.split is None:
        return out
    name = re.sub(r'[^\w.+-]+', '_', metadata.run).strip('._') or f'run_{part.run + 1}'
    count = 1
    while (unique := name if count == 1 else f'{name}-{count}') in names:
        count += 1
    names.add(unique)
    return out / unique


# -- samples -----------------------------------------------------------------------------------


class _Stream:
    """The parts of a feed, one of which can be looked at before it is taken."""

    def __init__(self, feed: Feed) -> None:
        self._parts = feed.parts()
        self._next: Part | None = None
        self.names = tuple(dict.fromkeys(name for piece in feed.pieces for name in piece.columns))

    def peek(self) -> Part | None:
        """The next part, None at the end."""
        if self._next is None:
            self._next = next(self._parts, None)
        return self._next

    def take(self, run: int) -> Part | None:
        """The next part if it belongs to the run."""
        part = self.peek()
        if part is None or part.run != run:
            return None
        self._next = None
        return part


@dataclass
class _Queue:
    """Samples of one channel that are not written yet; `ended`: none will come."""

    stamps: Stamps = field(default_factory=lambda: np.empty(0, dtype=np.int64))
    values: Floats = field(default_factory=lambda: np.empty(0))
    ended: bool = False

    def add(self, stamps: Stamps, values: Floats) -> None:
        """Add samples."""
        self.stamps = np.concatenate([self.stamps, stamps])
        self.values = np.concatenate([self.values, values])

    def until(self, stamp: int) -> tuple[Stamps, Floats]:
        """Take the samples up to a stamp."""
        end = int(np.searchsorted(self.stamps, stamp, side='right'))
        taken = self.stamps[:end], self.values[:end]
        self.stamps, self.values = self.stamps[end:], self.values[end:]
        return taken


def _write_run(
    path: Path, streams: Sequence[_Stream], mapping: ImportMap, metadata: TestMetadata,
    rig: Rig | None, overwrite: bool, on_progress: Progress | None,
) -> ImportedRun:
    channels = {channel.name: channel for channel in mapping.channels}
    counts = dict.fromkeys(channels, 0)
    spans: dict[str, tuple[int, int]] = {}
    envelopes = {name: Envelope() for name in channels}
    ranges = {name: _range(channel, rig) for name, channel in channels.items()}
    topics = {channel.topic.name: channel.topic.type for channel in channels.values()}
    with BagWriter(path, topics, metadata.as_text(), overwrite=overwrite) as writer:
        for samples in _merged(streams, tuple(channels)):
            writer.write([messages_of(channel.topic, *samples[name], ranges[name])
                          for name, channel in channels.items()])
            for name, (stamps, values) in samples.items():
                if len(stamps):
                    counts[name] += len(stamps)
                    start = spans[name][0] if name in spans else int(stamps[0])
                    spans[name] = start, int(stamps[-1])
                    envelopes[name].add(stamps, values)
            if on_progress is not None:
                on_progress(sum(counts.values()))
        empty = [name for name, count in counts.items() if not count]
        if empty:
            raise ImportingError(f'{path}: channel {empty[0]} has no sample: correct its column '
                                 'or its calibration')
    return ImportedRun(path, metadata, counts, spans, envelopes)


def _range(channel: ChannelMap, rig: Rig | None) -> tuple[float, ...]:
    if channel.topic.type != RANGE_TYPE or channel.range:
        return channel.range
    if rig is None:
        raise ImportingError(f'channels.{channel.name}: the range of the probe is not stated: '
                             'give range: [low, high] in metres, or --rig')
    return rig.probes.min_range, rig.probes.max_range


def _merged(
    streams: Sequence[_Stream], names: Sequence[str],
) -> Iterator[dict[str, tuple[Stamps, NDArray[np.float64]]]]:
    """The samples of one run of all channels, in order of time, block by block."""
    first = streams[0].peek()
    run = first.run if first is not None else 0
    queues = {name: _Queue() for name in names}
    while True:
        for stream in streams:
            while any(not len(queues[name].stamps) and not queues[name].ended
                      for name in stream.names):
                part = stream.take(run)
                if part is None:
                    for name in stream.names:
                        queues[name].ended = True
                    break
                for name, samples in part.samples.items():
                    queues[name].add(*samples)
        if not any(len(queue.stamps) for queue in queues.values()):
            return
        horizon = min((int(queue.stamps[-1]) for queue in queues.values() if not queue.ended),
                      default=np.iinfo(np.int64).max)
        yield {name: queue.until(horizon) for name, queue in queues.items()}
