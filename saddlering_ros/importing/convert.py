"""Files of data loggers as bags by a map, and their picture; a first map from their columns."""

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from functools import partial
from itertools import groupby, zip_longest
import json
from operator import itemgetter
from pathlib import Path
import re
from typing import Any

import numpy as np

from saddlering_ros.bags.write import BagWriter, messages_of
from saddlering_ros.errors import BagError, counted, did_you_mean, plain_number
from saddlering_ros.files import sha256_of_file, whole_file
from saddlering_ros.importing import calibration
from saddlering_ros.importing.calibration import ImportingError, known_unit, measures, words_of
from saddlering_ros.importing.feed import Feed, feeds_of, Part, Samples
from saddlering_ros.importing.mapping import ImportMap, instruments_text, REQUIRED, TO_DO
from saddlering_ros.importing.source import (
    Column,
    MOMENT,
    NUMBER,
    open_sources,
    Source,
    TEXT,
    TIME_NAME,
)
from saddlering_ros.quantities import first_of
from saddlering_ros.record.batches import Floats, SECOND, Stamps
from saddlering_ros.record.record import TestMetadata
from saddlering_ros.record.topics import RANGE_TYPE
from saddlering_ros.rig import FORCE_UNITS, Rig

PREVIEW_ENDINGS = ('.png', '.svg', '.pdf')

MAX_RUNS, MAX_POINTS, POINTS_PER_BLOCK = 6, 4096, 256
"""Of a picture: runs, points of a channel (more than pixels), and points of a block that was read;
each point has its extremes."""

_COLOURS = {'hydraulic_load': '#333333', 'eddy_current_1': '#0072B2', 'eddy_current_2': '#D55E00',
            'eddy_current_3': '#009E73', 'eddy_current_4': '#CC79A7'}


@dataclass
class Course:
    """A channel: how many samples, the stamps [ns] of its ends, and stretches for a picture.

    stamps: the first [ns] of each stretch; lowest, highest: its extreme values.
    """

    count: int = 0
    first: int = 0
    last: int = 0
    stamps: list[int] = field(default_factory=list)
    lowest: list[float] = field(default_factory=list)
    highest: list[float] = field(default_factory=list)

    def add(self, stamps: Stamps, values: Floats) -> None:
        """Add a block of samples (N,)."""
        if not len(stamps):
            return
        self.first = self.first if self.count else int(stamps[0])
        self.last = int(stamps[-1])
        self.count += len(stamps)
        starts = np.unique(np.linspace(0, len(stamps), POINTS_PER_BLOCK + 1).astype(int)[:-1])
        self.stamps += stamps[starts].tolist()
        self.lowest += np.minimum.reduceat(values, starts).tolist()
        self.highest += np.maximum.reduceat(values, starts).tolist()
        if len(self.stamps) > MAX_POINTS:
            even = len(self.stamps) // 2 * 2
            self.stamps = self.stamps[:even:2]
            self.lowest = np.minimum(self.lowest[:even:2], self.lowest[1:even:2]).tolist()
            self.highest = np.maximum(self.highest[:even:2], self.highest[1:even:2]).tolist()


@dataclass(frozen=True)
class ImportedRun:
    """A bag that was written: its metadata, and the course of each channel."""

    path: Path
    metadata: TestMetadata
    courses: Mapping[str, Course]

    @property
    def start(self) -> int:
        """The first stamp [ns]."""
        return min(course.first for course in self.courses.values())

    @property
    def stop(self) -> int:
        """The last stamp [ns]."""
        return max(course.last for course in self.courses.values())


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
                'samples': course.count, 'first': course.first, 'last': course.last,
                'lowest': min(course.lowest), 'highest': max(course.highest)}
                         for name, course in run.courses.items()},
        } for run in self.runs]
        return {'runs': runs, 'warnings': list(self.warnings)}


def import_files(
    files: Sequence[Path], mapping: ImportMap, out: Path, *, rig: Rig | None = None,
    overwrite: bool = False, on_progress: Callable[[int], None] = lambda samples: None,
) -> ImportResult:
    """Write the channels of `mapping` in the files as a bag at `out`.

    If the map splits the files into runs, `out` becomes a folder with a bag for each.
    `on_progress` is called with the number of samples written so far.
    """
    sources = open_sources(files, mapping.csv)
    hashes = '; '.join(f'{file.name} sha256 {sha256_of_file(file)}' for file in files)
    feeds = feeds_of(sources, mapping)
    ranges = _ranges(mapping, rig)
    runs: list[ImportedRun] = []
    by_run = [groupby(feed.parts(), key=itemgetter(0)) for feed in feeds]
    for streams in zip_longest(*by_run):
        if mapping.split is None and None in streams:
            name = feeds[streams.index(None)].names[0]
            raise ImportingError(f'{out}: channel {name} has no sample: correct its column or its '
                                 'calibration, or copy a file that was cut off again')
        if len({stream and stream[0] for stream in streams}) > 1:
            raise ImportingError(f'{out}: the channels do not agree on the runs: their files have '
                                 'gaps, or values of the split column, at different places')
        (number, label), _ = streams[0]
        metadata = _metadata(mapping, number, label, hashes, rig)
        path = out
        if mapping.split is not None:  # by the name of the run or its number, once for each run
            name = re.sub(r'[^\w.+-]+', '_', metadata.run).strip('._') or f'run_{number + 1}'
            names = [name, *(f'{name}-{count}' for count in range(2, len(runs) + 2))]
            path = next(out / one for one in names if out / one not in [run.path for run in runs])
        parts = [(feed, stream) for feed, (_, stream) in zip(feeds, streams, strict=True)]
        topics = {channel.topic.name: channel.topic.type for channel in mapping.channels}
        with BagWriter(path, topics, metadata.as_text(), overwrite=overwrite) as writer:
            courses = {channel.name: Course() for channel in mapping.channels}
            for samples in _merged(parts):
                writer.write([messages_of(channel.topic, *samples[channel.name],
                                          ranges[channel.name]) for channel in mapping.channels])
                for name, course in courses.items():
                    course.add(*samples[name])
                on_progress(sum(course.count for course in courses.values()))
            empty = [name for name, course in courses.items() if not course.count]
            if empty:
                said = first_of([line for source in sources for line in source.warnings])
                raise ImportingError(f'{path}: channel {empty[0]} has no sample ({said}): correct '
                                     'its column or its calibration')
        runs.append(ImportedRun(path, metadata, courses))
    if not runs:
        raise ImportingError(f'{files[0]}: has no sample with a readable time: correct the map')
    if mapping.split is not None and mapping.split.by == 'gap' and (
            len(runs) < len(mapping.split.runs)):
        described = counted(len(mapping.split.runs), 'run')
        sources[0].warn(f'split.runs of the map describes {described} and the files hold '
                        f'{len(runs)}: check seconds: and the elevation of each, which goes by '
                        'their order')
    warnings = [line for source in sources for line in source.warnings]
    return ImportResult(tuple(runs), tuple(warnings))


def _ranges(mapping: ImportMap, rig: Rig | None) -> dict[str, tuple[float, ...]]:
    """The range [m] of each probe by its channel: that of the map, or else of the rig."""
    ranges = {channel.name: channel.range for channel in mapping.channels}
    for channel in mapping.channels:
        if channel.topic.type == RANGE_TYPE and not channel.range:
            if rig is None:
                raise ImportingError(f'channels.{channel.name}: the range of the probe is not '
                                     'stated: give range: [low, high] in metres, or --rig')
            ranges[channel.name] = rig.probes.min_range, rig.probes.max_range
    return ranges


def _metadata(
    mapping: ImportMap, number: int, label: str, hashes: str, rig: Rig | None,
) -> TestMetadata:
    """The test metadata of run `number`, from 0 on; hashes: of the files."""
    given = dict(mapping.test)
    if mapping.split is not None:
        label = label if mapping.split.by == 'column' else str(number + 1)
        described = mapping.split.runs
        if described and label not in described:
            raise ImportingError(
                f'split.runs: does not describe the run {label!r}'
                f'{did_you_mean(label, list(described))} (it has: {", ".join(described)})')
        given |= described.get(label, {})
        given.setdefault('run', label)
    for key in ('test', 'elevation_deg'):
        if key not in given:
            raise ImportingError(f'test.{key} is missing in the map: add it; '
                                 'test: static or dynamic, elevation_deg: degrees')
    details = {key: value for key, value in given.items()
               if key not in ('test', 'elevation_deg', 'rig', 'run')}
    details |= {'import_sources': hashes, 'import_map': mapping.text}
    if stated := instruments_text(mapping.channels):
        details['instruments'] = stated
    if rig is not None:
        details['rig_hash'] = rig.digest
    try:
        return TestMetadata(given['test'], plain_number(given['elevation_deg']),
                            given.get('rig', ''), given.get('run', ''), details)
    except BagError as problem:
        words = str(problem).removeprefix('test metadata: ')
        raise ImportingError(f'test of the map: {words}') from problem
    except ValueError as problem:
        raise ImportingError(f'test.elevation_deg is {given["elevation_deg"]!r}: give degrees'
                             ) from problem


def _merged(feeds: Sequence[tuple[Feed, Iterator[Part]]]) -> Iterator[Samples]:
    """The samples of one run of all channels, in order of time, block by block."""
    waiting = {name: (np.empty(0, dtype=np.int64), np.empty(0))
               for feed, _ in feeds for name in feed.names}
    going_on = list(feeds)
    while True:
        for feed, parts in list(going_on):
            while any(not len(waiting[name][0]) for name in feed.names):
                _, samples = next(parts, (None, None))
                if samples is None:
                    going_on.remove((feed, parts))
                    break
                for name, (stamps, values) in samples.items():
                    waiting[name] = (np.concatenate([waiting[name][0], stamps]),
                                     np.concatenate([waiting[name][1], values]))
        if not any(len(stamps) for stamps, _ in waiting.values()):
            return
        horizon = min((waiting[name][0][-1] for feed, _ in going_on for name in feed.names),
                      default=np.iinfo(np.int64).max)
        taken = {}
        for name, (stamps, values) in waiting.items():
            end = int(np.searchsorted(stamps, horizon, side='right'))
            taken[name] = stamps[:end], values[:end]
            waiting[name] = stamps[end:], values[end:]
        yield taken


def save_preview(path: Path, runs: Sequence[ImportedRun], rig: Rig) -> None:
    """Write the picture of the first MAX_RUNS runs, by the suffix, in the rig's unit of forces."""
    from saddlering_ros.pages.charts import Chart, draw, line, Panel, Series, strokes

    panels, shown = [], runs[:MAX_RUNS]
    for column, run in enumerate(shown):
        load, gaps = list[Series](), list[Series]()
        for name in (name for name in _COLOURS if name in run.courses):
            course, is_load = run.courses[name], name == 'hydraulic_load'
            time = (np.array(course.stamps) - run.start) / SECOND
            low, high = np.array([course.lowest, course.highest]) / (
                FORCE_UNITS[rig.force_unit] if is_load else 1e-3)
            words = name.replace('eddy_current_', 'probe ').replace('hydraulic_', '')
            (load if is_load else gaps).extend([
                line(time, 0.5 * (low + high), _COLOURS[name], words, width=0.9),
                strokes(time, low, high, colour=_COLOURS[name], opacity=0.35)])
        facts = run.metadata
        panels += [
            Panel(0, column, 'time / s', f'load / {rig.force_unit}', tuple(load), title=(
                f'{run.path.name}: {facts.test}, {facts.elevation_deg:g} deg\n'
                f'from {words_of(run.start)}')),
            Panel(1, column, 'time / s', 'gap / mm', tuple(gaps))]
    figure = draw(Chart(tuple(panels), max(7.5, 4.0 * len(shown)), 5.0, (1.0, 1.0), len(shown),
                        shares_x=True))
    with whole_file(path, ImportingError) as temporary:
        figure.savefig(temporary, format=path.suffix.lstrip('.').lower() or 'png', dpi=120)


_LOAD = re.compile(r'load|force|kraft|last|cylinder|zylinder|pressure|druck|\bp\d?\b|^f\b', re.I)
_PROBE = re.compile(r'eddy|probe|gap|weg|abstand|distance|displ|sensor|taster|^[sdx]_?\d', re.I)
_NUMBERED = re.compile(r'(?<!\d)([1-4])(?!\d)')
_DAY_FIRST = re.compile(r'^\s*\d{1,2}\.\d{1,2}\.\d{4}')
_CLOCK = re.compile(r'^\s*\d{1,2}:\d{2}:\d{2}([.,]\d+)?\s*$')

_HEAD = """\
# Draft of a map, made from the columns of the files. Complete every TODO, check
# the rest. A unit is given here only if the file states it.
"""
_TEST = """\
test:
  test: TODO            # static or dynamic
  elevation_deg: TODO   # of the barrel, degrees
  # ring: SR-017         # name of the ring
  # rig: bench 2         # name of the rig
  # run: 1
  # date: 2026-11-20
  # operator: name
  # service_hours: 120
# split: {by: gap, seconds: 1}   # several runs in one file, or {by: column, column: ..}
"""


def draft_map(sources: Sequence[Source]) -> tuple[str, list[str]]:
    """A map proposed from the files' columns, as YAML with TODOs, and what was seen of them."""
    columns = [column for source in sources for column in source.columns]
    lines = []
    for settings in [source.settings for source in sources if source.settings][:1]:
        shape = ', '.join(f'{key}: {_quoted(value)}' for key, value in settings.items())
        lines.append(f'csv: {{{shape}}}')
    lines += ['time:', *(f'  {line}' for line in _time(columns)), 'channels:']
    # A column for each channel: by its unit and name; numbers 1 to 4 for the probes.
    chosen: dict[str, Column] = {}
    for column in columns:
        is_load = _is_called(column, _LOAD)
        if column.kind != NUMBER or (_is_called(column, TIME_NAME) and not is_load):
            continue
        number = _NUMBERED.search(column.name.rpartition('/')[2])
        if is_load or measures(column.unit, calibration.FORCE, calibration.PRESSURE):
            chosen.setdefault('hydraulic_load', column)
        elif number and (_is_called(column, _PROBE) or measures(column.unit, calibration.LENGTH)):
            chosen.setdefault(f'eddy_current_{number[1]}', column)
    for name in REQUIRED:
        entries = _channel(name, chosen[name], sources) if name in chosen else \
            [f'column: {TO_DO}', f'unit: {TO_DO}']
        lines.append(f'  {name}: {{{", ".join(entries)}}}')
    seen = []
    for source in sources:
        seen.append(f'{source.path}: {source.FORMAT}, {counted(len(source.columns), "column")}')
        seen += [f'  {line}' for line in source.shape_words]
        for column in source.columns:
            unit = f' [{column.unit}]' if column.unit else ' (no unit given)' \
                if column.kind == NUMBER else ''
            rows = '' if column.rows is None else f', {counted(column.rows, "row")}'
            clock, timing = '', column.timing
            if timing is not None:
                how = f'{1 / timing.period:g} Hz' if timing.period else f'times in {timing.column}'
                start = timing.start
                clock = f', {how} ' + (
                    'no date' if start is None else f'from {calibration.words_of(start)}')
            first = f', first {", ".join(column.samples)}' if column.samples else ''
            seen.append(f'  {column.name}{unit}: {column.kind}s{rows}{clock}{first}')
        seen += [f'  {name}: not read, because {why}' for name, why in source.unread.items()]
        seen += [f'  warning: {line}' for line in source.warnings]
    return _HEAD + '\n'.join(lines) + '\n' + _TEST, seen


_quoted = partial(json.dumps, ensure_ascii=False)


def _is_called(column: Column, pattern: re.Pattern[str]) -> bool:
    return bool(pattern.search(column.name.rpartition('/')[2]))


def _time(columns: Sequence[Column]) -> list[str]:
    if any(column.timing is not None for column in columns):
        return ['from: file               # each channel has a time of its own in the file']
    for column in columns:
        if column.kind == MOMENT:
            return [f'column: {_quoted(column.name)}', 'format: file']
    dated = [column for column in columns if column.kind == TEXT and column.samples
             and (_is_called(column, TIME_NAME) or _is_date(column.samples[0]))]
    if dated:
        clock = [column for column in dated if _CLOCK.match(column.samples[0])]
        day = [column for column in dated if column not in clock]
        names = ', '.join(_quoted(column.name) for column in (*day[:1], *clock[:1]))
        first = (day or clock)[0].samples[0]
        form = '"%d.%m.%Y %H:%M:%S"' if _DAY_FIRST.match(first) else 'iso'
        has_zone = re.search(r'(Z|[+-]\d\d:?\d\d)\s*$', first)
        return [f'column: [{names}]' if day and clock else f'column: {names}', f'format: {form}',
                *(() if has_zone else (f'zone: {TO_DO}              # UTC, Europe/Berlin, ..',))]
    for column in _counted(columns):
        return [f'column: {_quoted(column.name)}',
                f'unit: {_unit_of_time(column)}                  # s, ms, us, ns, min, h',
                '# start: "2026-11-20T08:00:00Z"   # if the column counts from the start of '
                'the test']
    return [f'rate: {TO_DO}              # samples per second',
            f'start: {TO_DO}             # like "2026-11-20T08:00:00Z"']


def _counted(columns: Sequence[Column]) -> list[Column]:
    return [column for column in columns
            if column.kind == NUMBER and _is_called(column, TIME_NAME)]


def _unit_of_time(column: Column) -> str:
    return column.unit if measures(column.unit, calibration.TIME) else TO_DO


def _is_date(text: str) -> bool:
    try:
        calibration.parse_moment(re.sub(r'[.,]\d+$', '', text.strip()), 'iso')
    except ValueError:
        return bool(_DAY_FIRST.match(text))
    return True


def _channel(name: str, column: Column, sources: Sequence[Source]) -> list[str]:
    unit = known_unit(column.unit)
    entries = [f'column: {_quoted(column.name)}', f'unit: {unit.name if unit else TO_DO}']
    is_load = name == 'hydraulic_load'
    if is_load and measures(column.unit, calibration.PRESSURE):
        entries.append(f'piston_area: {TO_DO}')
        # A second pressure beside the piston's acts on the other side of it.
        others = [other for source in sources for other in source.columns
                  if other is not column and measures(other.unit, calibration.PRESSURE)]
        if others:
            entries += [f'rod_pressure: {_quoted(others[0].name)}', f'rod_area: {TO_DO}']
    elif unit is not None and unit.quantity not in (calibration.LENGTH, calibration.FORCE):
        entries += [f'scale: {TO_DO}', f'scale_unit: {TO_DO}']
    if not is_load:
        entries.append(f'range: {TO_DO}')
    table = next(source.columns for source in sources if column in source.columns)
    # Where a table has several times, that of a channel is the one to the left of it.
    times = _counted(table[:table.index(column)]) if column.timing is None else []
    if len(times) > 1:
        entries.append(f'time: {{column: {_quoted(times[-1].name)}, '
                       f'unit: {_unit_of_time(times[-1])}}}')
    return entries
