"""A first map made from the files' own columns, to be completed by hand."""

from collections.abc import Sequence
from functools import partial
import json
import re

from saddlering_ros.importing import calibration
from saddlering_ros.importing.calibration import known_unit, measures
from saddlering_ros.importing.mapping import REQUIRED, TO_DO
from saddlering_ros.importing.source import Column, MOMENT, NUMBER, Source, TEXT

_LOAD = re.compile(r'load|force|kraft|last|cylinder|zylinder|pressure|druck|\bp\d?\b|^f\b', re.I)
_PROBE = re.compile(r'eddy|probe|gap|weg|abstand|distance|displ|sensor|taster|^[sdx]_?\d', re.I)
_TIME = re.compile(r'time|zeit|stamp|date|datum|^t\b', re.I)
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
        if column.kind != NUMBER or (_is_called(column, _TIME) and not is_load):
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
        seen.append(f'{source.path}: {source.FORMAT}, {len(source.columns)} columns')
        seen += [f'  {line}' for line in source.shape_words]
        for column in source.columns:
            unit = f' [{column.unit}]' if column.unit else ' (no unit given)' \
                if column.kind == NUMBER else ''
            rows = '' if column.rows is None else f', {column.rows} rows'
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
             and (_is_called(column, _TIME) or _is_date(column.samples[0]))]
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
    return [column for column in columns if column.kind == NUMBER and _is_called(column, _TIME)]


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
