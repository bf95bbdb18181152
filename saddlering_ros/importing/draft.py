"""A first map made from the files' own columns, to be completed by hand."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
import re

from saddlering_ros.importing.calibration import FORCE, known_unit, LENGTH, PRESSURE, TIME
from saddlering_ros.importing.clock import parse_moment, words_of
from saddlering_ros.importing.mapping import REQUIRED, TO_DO
from saddlering_ros.importing.source import Column, MOMENT, NUMBER, Source, TEXT

_LOAD = re.compile(r'load|force|kraft|last|cylinder|zylinder|pressure|druck|\bp\d?\b|^f\b', re.I)
_PROBE = re.compile(r'eddy|probe|gap|weg|abstand|distance|displ|sensor|taster|^[sdx]_?\d', re.I)
_TIME = re.compile(r'time|zeit|stamp|date|datum|^t\b', re.I)
_NUMBERED = re.compile(r'(?<!\d)([1-4])(?!\d)')
_DAY_FIRST = re.compile(r'^\s*\d{1,2}\.\d{1,2}\.\d{4}')
_CLOCK = re.compile(r'^\s*\d{1,2}:\d{2}:\d{2}([.,]\d+)?\s*$')


@dataclass(frozen=True)
class Draft:
    """A proposed map as YAML text, and observations, a line each."""

    text: str
    seen: tuple[str, ...]


def draft_map(sources: Sequence[Source]) -> Draft:
    """A map proposed from the columns of the files; unknown entries stand as TODO."""
    columns = [column for source in sources for column in source.columns]
    lines = ['# Draft of a map, made from the columns of the files. Complete every TODO, check',
             '# the rest. A unit is given here only if the file states it.']
    settings = next((source.settings() for source in sources if source.settings()), None)
    if settings is not None:
        shape = ', '.join(f'{key}: {_quoted(value)}' for key, value in settings.items())
        lines.append(f'csv: {{{shape}}}')
    lines += ['time:', *(f'  {line}' for line in _time(columns)), 'channels:']
    chosen = _chosen(columns)
    for name in REQUIRED:
        entries = _channel(name, chosen.get(name))
        if chosen.get(name) is not None:
            entries += _rod_pressure(name, chosen[name], columns) + _clock(chosen[name], sources)
        lines.append(f'  {name}: {{{", ".join(entries)}}}')
    lines += [
        'test:',
        f'  test: {TO_DO}            # static or dynamic',
        f'  elevation_deg: {TO_DO}   # of the barrel, degrees',
        '  # rig: SR-017          # name of the rig',
        '  # run: 1', '  # date: 2026-11-20', '  # operator: name', '  # service_hours: 120',
        '# split: {by: gap, seconds: 1}   # several runs in one file, or {by: column, column: ..}',
    ]
    return Draft('\n'.join(lines) + '\n', tuple(_seen(sources)))


def _seen(sources: Sequence[Source]) -> Iterator[str]:
    for source in sources:
        yield f'{source.path}: {source.FORMAT}, {len(source.columns)} columns'
        yield from (f'  {line}' for line in source.describe())
        for column in source.columns:
            unit = f' [{column.unit}]' if column.unit else ' (no unit given)' \
                if column.kind == NUMBER else ''
            rows = '' if column.rows is None else f', {column.rows} rows'
            own = _timing_in_words(column)
            first = f', first {", ".join(column.samples)}' if column.samples else ''
            yield f'  {column.name}{unit}: {column.kind}s{rows}{own}{first}'
        yield from (f'  warning: {line}' for line in source.warnings.all())


def _timing_in_words(column: Column) -> str:
    timing = column.timing
    if timing is None:
        return ''
    start = 'no date' if timing.start is None else f'from {words_of(timing.start)}'
    how = f'{1 / timing.period:g} Hz' if timing.period else f'times in {timing.column}'
    return f', {how} {start}'


def _quoted(value: object) -> str:
    if not isinstance(value, str):
        return str(value)
    text = value.replace('\\', '\\\\').replace('"', '\\"').replace('\t', '\\t')
    return f'"{text}"'


def _time(columns: Sequence[Column]) -> list[str]:
    if any(column.timing is not None for column in columns):
        return ['from: file               # each channel has a time of its own in the file']
    moments = [column for column in columns if column.kind == MOMENT]
    if moments:
        return [f'column: {_quoted(moments[0].name)}', 'format: file']
    texts = [column for column in columns if column.kind == TEXT and column.samples]
    dated = [column for column in texts
             if _TIME.search(_last_part(column)) or _is_date(column.samples[0])]
    if dated:
        return _dated(dated)
    for column in _counted(columns):
        return [f'column: {_quoted(column.name)}',
                f'unit: {_unit_of_time(column)}                  # s, ms, us, ns, min, h',
                '# start: "2026-11-20T08:00:00Z"   # if the column counts from the start of '
                'the test']
    return [f'rate: {TO_DO}              # samples per second',
            f'start: {TO_DO}             # like "2026-11-20T08:00:00Z"']


def _counted(columns: Sequence[Column]) -> list[Column]:
    """Columns that count a time."""
    return [column for column in columns
            if column.kind == NUMBER and _TIME.search(_last_part(column))]


def _unit_of_time(column: Column) -> str:
    unit = known_unit(column.unit)
    return unit.name if unit is not None and unit.quantity == TIME else TO_DO


def _clock(column: Column, sources: Sequence[Source]) -> list[str]:
    """The time of a channel beside it, where a table has several: that to the left of it."""
    for source in sources:
        if column not in source.columns or column.timing is not None:
            continue
        times = _counted(source.columns[:source.columns.index(column)])
        if len(times) > 1:
            return [f'time: {{column: {_quoted(times[-1].name)}, '
                    f'unit: {_unit_of_time(times[-1])}}}']
    return []


def _rod_pressure(name: str, column: Column, columns: Sequence[Column]) -> list[str]:
    """A second pressure beside the piston's, which acts on the other side of it."""
    def is_pressure(one: Column) -> bool:
        unit = known_unit(one.unit)
        return unit is not None and unit.quantity == PRESSURE

    others = [one for one in columns if one is not column and is_pressure(one)]
    if name != 'hydraulic_load' or not is_pressure(column) or not others:
        return []
    return [f'rod_pressure: {_quoted(others[0].name)}', f'rod_area: {TO_DO}']


def _is_date(text: str) -> bool:
    try:
        parse_moment(re.sub(r'[.,]\d+$', '', text.strip()), 'iso')
    except ValueError:
        return bool(_DAY_FIRST.match(text))
    return True


def _dated(columns: Sequence[Column]) -> list[str]:
    clock = [column for column in columns if _CLOCK.match(column.samples[0])]
    day = [column for column in columns if column not in clock]
    names = ', '.join(_quoted(column.name) for column in (*day[:1], *clock[:1]))
    first = (day or clock)[0].samples[0]
    form = 'iso'
    if _DAY_FIRST.match(first):
        form = '"%d.%m.%Y %H:%M:%S"'
    has_zone = bool(re.search(r'(Z|[+-]\d\d:?\d\d)\s*$', first))
    lines = [f'column: [{names}]' if day and clock else f'column: {names}', f'format: {form}']
    return lines if has_zone else [*lines, f'zone: {TO_DO}              # UTC, Europe/Berlin, ..']


def _chosen(columns: Sequence[Column]) -> dict[str, Column]:
    """A column for each channel: by its unit and name; numbers 1 to 4 for the probes."""
    numbers = [column for column in columns if column.kind == NUMBER
               and not (_TIME.search(_last_part(column)) and not _LOAD.search(_last_part(column)))]
    chosen: dict[str, Column] = {}

    def is_load(column: Column) -> bool:
        unit = known_unit(column.unit)
        return bool(_LOAD.search(_last_part(column))) or (
            unit is not None and unit.quantity in (FORCE, PRESSURE))

    def is_probe(column: Column) -> bool:
        unit = known_unit(column.unit)
        return not is_load(column) and (bool(_PROBE.search(_last_part(column))) or (
            unit is not None and unit.quantity == LENGTH))

    load = _first(numbers, is_load)
    if load is not None:
        chosen['hydraulic_load'] = load
    for column in numbers:
        found = _NUMBERED.search(_last_part(column))
        if found and is_probe(column):
            chosen.setdefault(f'eddy_current_{found[1]}', column)
    return chosen


def _last_part(column: Column) -> str:
    """The name without the groups before it."""
    return column.name.rpartition('/')[2]


def _first(columns: Sequence[Column], which: Callable[[Column], bool]) -> Column | None:
    return next((column for column in columns if which(column)), None)


def _channel(name: str, column: Column | None) -> list[str]:
    if column is None:
        return [f'column: {TO_DO}', f'unit: {TO_DO}']
    unit = known_unit(column.unit)
    entries = [f'column: {_quoted(column.name)}', f'unit: {unit.name if unit else TO_DO}']
    quantity = unit.quantity if unit is not None else ''
    if name == 'hydraulic_load' and quantity == PRESSURE:
        entries.append(f'piston_area: {TO_DO}')
    elif quantity not in ('', LENGTH, FORCE):
        entries += [f'scale: {TO_DO}', f'scale_unit: {TO_DO}']
    if name != 'hydraulic_load':
        entries.append(f'range: {TO_DO}')
    return entries
