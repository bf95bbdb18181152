"""The map of an import (MAP.yaml): the column, unit and time of each channel."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from datetime import date, datetime
import json
import math
from pathlib import Path
from typing import Any

from saddlering_ros.errors import did_you_mean, plain_number, refuse_unknown_keys
from saddlering_ros.importing import calibration
from saddlering_ros.importing.calibration import Calibration, ImportingError, TimeSource, unit_of
from saddlering_ros.plain_yaml import read_strict_yaml
from saddlering_ros.record.batches import SECOND
from saddlering_ros.record.record import DETAILS
from saddlering_ros.record.topics import RANGE_TYPE, RigTopic, TOPICS
from saddlering_ros.rig.description import OPPOSITE

CHANNELS: dict[str, RigTopic] = {name.rpartition('/')[2]: topic for name, topic in TOPICS.items()}
"""The rig's topics by the names that a map has for them."""

REQUIRED = tuple(name for name, topic in CHANNELS.items() if topic.required)

RADIAL = tuple(f'eddy_current_{number}' for number in OPPOSITE)
"""Channels that may be `absent`, if the rig does not have this probe (rig.probes.absent)."""

QUANTITIES = {'N': calibration.FORCE, 'm': calibration.LENGTH, 'rad': calibration.ANGLE}
"""Quantity of a topic, by its unit in the bag."""

TO_DO = 'TODO'
"""Mark in a draft for an entry that a person must state."""

TIME_KEYS = ('column', 'unit', 'format', 'zone', 'start', 'rate', 'from')
CHANNEL_KEYS = ('column', 'unit', 'scale', 'scale_unit', 'offset', 'table', 'table_unit',
                'polynomial', 'polynomial_unit', 'polarity', 'delay', 'range', 'piston_area',
                'rod_pressure', 'rod_area', 'time', 'file', 'uncertainty')
UNCERTAINTIES = {'load': ('gain', 'offset', 'nonlinearity'),
                 'probe': ('gain', 'nonlinearity', 'lag')}
"""Entries of `uncertainty`: load_gain, probe_gain and so on of rig.instruments, in its units."""

TEST_KEYS = ('test', 'elevation_deg', 'rig', 'run',
             *(key for key in DETAILS
               if not key.startswith(('import', 'rig_hash', 'instruments', 'recorder'))))
NUMBERS = {'piston_area': 0.0, 'rod_area': 0.0, 'polarity': 1.0, 'delay': 0.0}


@dataclass(frozen=True)
class ChannelMap:
    """One channel: its column and the unit there, the way to SI, and its clock.

    delay [s]: the reading lags the quantity by so much, its stamp is that much earlier;
    polarity: -1 turns the reading's sign before anything else; range [m] of a probe, () if not
    given; rod_pressure: column of the rod side's pressure, read as `column` is, with areas [m2] of
    both sides;
    uncertainty: of the calibration, by the names of UNCERTAINTIES, and its `certificate`.
    """

    name: str
    topic: RigTopic
    column: str
    unit: calibration.Unit
    calibration: Calibration
    time: TimeSource | None = None
    file: str = '*'
    delay: float = 0.0
    polarity: float = 1.0
    range: tuple[float, ...] = ()
    rod_pressure: str = ''
    areas: tuple[float, float] = (0.0, 0.0)
    uncertainty: Mapping[str, Any] = field(default_factory=dict)


@dataclass(frozen=True)
class Split:
    """How one recording is cut into runs: by the values of a column, or where time leaps.

    seconds: a leap; runs: test metadata of each run, by value of the column or in their order.
    """

    by: str
    column: str = ''
    seconds: float = 1.0
    runs: Mapping[str, Mapping[str, str]] = field(default_factory=dict)


@dataclass(frozen=True)
class ImportMap:
    """A whole map; `text` is the unchanged text of the file."""

    channels: tuple[ChannelMap, ...]
    time: TimeSource
    test: Mapping[str, str]
    split: Split | None = None
    csv: Mapping[str, Any] = field(default_factory=dict)
    text: str = ''


def read_map(path: Path) -> ImportMap:
    """The map at `path`, beside which its tables lie; ImportingError if it cannot be used."""
    document, where = read_strict_yaml(path, ImportingError), str(path)
    if not isinstance(document, Mapping):
        raise ImportingError(f'{where}: is not a map: give time:, channels: and test:')
    refuse_unknown_keys(document, ('time', 'channels', 'test', 'split', 'csv'), '', where,
                        ImportingError)
    for key in ('time', 'channels', 'test'):
        if not isinstance(document.get(key), Mapping):
            raise ImportingError(f'{where}: {key}: is missing, or has no entries: add this '
                                 'section')
    _refuse_todo(document, '', where)
    given = document['channels']
    refuse_unknown_keys(given, tuple(CHANNELS), 'channels', where, ImportingError)
    missing = [name for name in REQUIRED if name not in given]
    if missing:
        raise ImportingError(f'{where}: channels.{missing[0]} is missing: a bag needs '
                             f'{", ".join(REQUIRED)}')
    absent = [name for name in RADIAL if given[name] == 'absent']
    if len(absent) == len(RADIAL):
        raise ImportingError(f'{where}: channels.{absent[0]} and channels.{absent[1]} are both '
                             'absent, and delta_x needs one of them')
    channels = tuple(
        _channel(name, given[name], where, path.parent) for name in given if name not in absent)
    for channel in channels:
        if isinstance(channel.time, calibration.CountedTime) and 'start' in document['time'] and (
                'start' not in given[channel.name]['time']):
            raise ImportingError(f'{where}: channels.{channel.name}.time has no start, and time: '
                                 'has one: give both, or start: 1970-01-01T00:00:00Z here')
    return ImportMap(channels, _time(document['time'], where, 'time'),
                     _test(document['test'], where, 'test'), _split(document.get('split'), where),
                     _section(document.get('csv') or {}, where, 'csv'),
                     path.read_text(encoding='utf-8'))


def _refuse_todo(value: Any, name: str, where: str) -> None:
    """A draft that has not been completed is refused at its first gap."""
    if isinstance(value, Mapping):
        for key, entry in value.items():
            _refuse_todo(entry, f'{name}.{key}' if name else str(key), where)
    elif isinstance(value, list):
        for entry in value:
            _refuse_todo(entry, name, where)
    elif value == TO_DO:
        raise ImportingError(f'{where}: {name} is still {TO_DO}: state it')


def _section(value: Any, file: str, name: str, keys: Sequence[str] = ()) -> Mapping[str, Any]:
    """The section of that dotted name; ImportingError if it is none, or has unknown entries."""
    if not isinstance(value, Mapping):
        raise ImportingError(f'{file}: {name} is {value!r}: give a section with entries')
    if keys:
        refuse_unknown_keys(value, keys, name, file, ImportingError)
    return value


def _time(given: Any, file: str, name: str) -> TimeSource:
    section, where = _section(given, file, name, TIME_KEYS), f'{file}: {name}'
    zone = start = None
    if 'zone' in section:
        zone = calibration.zone_of(section['zone'], f'{where}.zone')
    if 'start' in section:
        start = calibration.start_of(section['start'], zone, f'{where}.start')
    if 'from' in section:
        if section['from'] != 'file':
            raise ImportingError(f'{where}.from is {section["from"]!r}: the only choice is file')
        return calibration.FileTime(start)
    if 'rate' in section:
        rate = _number(section['rate'], f'{where}.rate')
        if start is None:
            raise ImportingError(f'{where}: a rate needs a start, like "2026-11-20T08:00:00Z"')
        if rate <= 0:
            raise ImportingError(f'{where}.rate is {rate:g}: give samples per second')
        return calibration.RegularTime(SECOND / rate, start)
    columns = section.get('column')
    if columns is None:
        raise ImportingError(f'{where}: give column: (with unit: or format:), rate: and start:, '
                             'or from: file')
    names = tuple(map(str, columns)) if isinstance(columns, list) else (str(columns),)
    if 'format' in section:
        form = str(section['format']).replace('.%f', '').replace(',%f', '')
        dated = calibration.DatedTime(names, form, zone, start)
        if start is not None and dated.is_dated:
            raise ImportingError(f'{where}: a time with a date needs no start: remove start:')
        return dated
    if 'unit' not in section:
        raise ImportingError(f'{where}: the unit of the time is not stated: give unit: s (ms, us, '
                             'ns) for numbers, format: iso or like "%d.%m.%Y %H:%M:%S" for dates')
    unit = unit_of(section['unit'], f'{where}.unit')
    if unit.quantity != calibration.TIME or len(names) != 1:
        units = ', '.join(calibration.FACTORS[calibration.TIME])
        raise ImportingError(f'{where}.unit is {unit.name}: give a unit of time ({units}) and '
                             'one column')
    return calibration.CountedTime((names[0],), unit, start or 0)


def _channel(name: str, given: Any, file: str, folder: Path) -> ChannelMap:
    where, topic = f'{file}: channels.{name}', CHANNELS[name]
    section = _section(given, file, f'channels.{name}', CHANNEL_KEYS)
    if 'column' not in section:
        raise ImportingError(f'{where}: no column is named: give column:')
    if section.get('unit') in (None, ''):
        raise ImportingError(f'{where}: the unit of column {section["column"]!r} is not stated: '
                             'give unit:')
    unit = unit_of(section['unit'], f'{where}.unit')
    law = _calibration(section, unit, where, folder)
    numbers = {key: _number(section.get(key, usual), f'{where}.{key}')
               for key, usual in NUMBERS.items()}
    if ('rod_area' in section) != ('rod_pressure' in section):
        raise ImportingError(f'{where}: rod_pressure and rod_area belong together: give both')
    areas = piston, rod = numbers['piston_area'], numbers['rod_area']
    for key, area in zip(('piston_area', 'rod_area'), areas, strict=True):
        if key in section and not 0.0 < area < 10.0:
            raise ImportingError(f'{where}.{key} is {area:g}: give an area in m2')
    if rod and not piston:
        raise ImportingError(f'{where}: rod_area needs piston_area: give both, in m2')
    if piston and law.unit.quantity != calibration.PRESSURE:
        raise ImportingError(f'{where}: piston_area is for a pressure, and the column is in '
                             f'{law.unit.name}: correct one')
    wanted = calibration.PRESSURE if piston else QUANTITIES[topic.unit]
    if law.unit.quantity != wanted:
        units = list(calibration.FACTORS[wanted])
        remedy = (f'give a table:, or scale: with scale_unit: like {units[0]}/{law.unit.name}, '
                  f'or correct the unit ({", ".join(units)})')
        if (law.unit.quantity, wanted) == (calibration.PRESSURE, calibration.FORCE):
            remedy = 'give piston_area: in m2 (and rod_pressure:, rod_area:)'
        raise ImportingError(f'{where}: is a {law.unit.quantity} ({law.unit.name}) where a '
                             f'{wanted} is needed: {remedy}')
    if numbers['polarity'] not in (-1.0, 1.0):
        raise ImportingError(f'{where}.polarity is {numbers["polarity"]:g}: give 1 or -1')
    kind = 'probe' if topic.type == RANGE_TYPE else 'load'
    uncertainty = _section(section.get('uncertainty', {}), file, f'channels.{name}.uncertainty',
                           (*UNCERTAINTIES[kind], 'certificate'))
    for key in set(uncertainty) - {'certificate'}:
        if _number(uncertainty[key], f'{where}.uncertainty.{key}') <= 0.0:
            raise ImportingError(f'{where}.uncertainty.{key} is {uncertainty[key]!r}: give a '
                                 'standard uncertainty above zero')
    return ChannelMap(
        name=name, topic=topic, column=str(section['column']), unit=unit, calibration=law,
        time=(_time(section['time'], file, f'channels.{name}.time') if 'time' in section
              else None),
        file=str(section.get('file', '*')), delay=numbers['delay'], polarity=numbers['polarity'],
        range=_range(section.get('range'), topic, f'{where}.range'),
        rod_pressure=str(section.get('rod_pressure', '')), areas=areas,
        uncertainty=uncertainty)


def instruments_text(channels: Sequence[ChannelMap]) -> str:
    """The uncertainties of all calibrations as `instruments` of the metadata; '' for none.

    Entries are those of rig.instruments. Of the four probes the largest lag and curvature counts.
    """
    stated: dict[str, Any] = {}
    for channel in channels:
        kind = 'probe' if channel.topic.type == RANGE_TYPE else 'load'
        for key, value in channel.uncertainty.items():
            if key == 'certificate':
                stated.setdefault('certificates', []).append(str(value))
            else:
                name = f'{kind}_{key}'
                stated[name] = max(float(value), stated.get(name, 0.0))
    return json.dumps(stated, sort_keys=True) if stated else ''


def _calibration(section: Mapping[str, Any], unit: calibration.Unit, where: str,
                 folder: Path) -> Calibration:
    kinds = [key for key in ('table', 'polynomial', 'scale') if key in section]
    if len(kinds) > 1:
        raise ImportingError(f'{where}: {kinds[0]} and {kinds[1]} are both given: give one')
    if 'table' in section:
        if 'offset' in section:
            raise ImportingError(f'{where}: an offset cannot be combined with a table: add it to '
                                 'the table')
        value_unit = (unit_of(section['table_unit'], f'{where}.table_unit')
                      if 'table_unit' in section else None)
        return calibration.read_table(folder / str(section['table']), unit, value_unit)
    if 'polynomial' in section:
        numbers = section['polynomial']
        if not isinstance(numbers, list) or not numbers or 'offset' in section:
            raise ImportingError(f'{where}.polynomial is {numbers!r}: give [c0, c1, c2, ..], the '
                                 'offset is c0')
        if 'polynomial_unit' not in section:
            raise ImportingError(f'{where}: the unit of the result of the polynomial is not '
                                 'stated: add polynomial_unit:')
        return calibration.Polynomial(
            unit_of(section['polynomial_unit'], f'{where}.polynomial_unit'),
            tuple(_number(number, f'{where}.polynomial') for number in numbers))
    if 'scale_unit' in section:
        text = str(section['scale_unit'])
        above, _, below = text.partition('/')
        if calibration.known_unit(below) != unit:
            raise ImportingError(f'{where}.scale_unit is {text!r}: give the unit of the quantity '
                                 f'over that of the column, like mm/{unit.name}'
                                 + did_you_mean(text, [f'mm/{unit.name}']))
        unit = unit_of(above, f'{where}.scale_unit')
    return calibration.Polynomial(unit, (_number(section.get('offset', 0.0), f'{where}.offset'),
                                         _number(section.get('scale', 1.0), f'{where}.scale')))


def _range(value: Any, topic: RigTopic, where: str) -> tuple[float, ...]:
    if value is None:
        return ()
    if topic.type != RANGE_TYPE:
        raise ImportingError(f'{where}: only a probe has a range: remove it')
    if not isinstance(value, list) or len(value) != 2:
        raise ImportingError(f'{where} is {value!r}: give [low, high] in metres')
    low, high = (_number(end, where) for end in value)
    if not 0.0 <= low < high <= 1.0:
        raise ImportingError(f'{where} is [{low:g}, {high:g}]: give [low, high] in metres, like '
                             '[0, 0.002]')
    return low, high


def _number(value: Any, where: str) -> float:
    try:
        number = float('nan') if isinstance(value, bool) else plain_number(str(value))
    except ValueError as problem:
        raise ImportingError(f'{where} is {value!r}: give a number') from problem
    if not math.isfinite(number):
        raise ImportingError(f'{where} is {value!r}: give a finite number')
    return number


def _test(given: Any, file: str, name: str) -> dict[str, str]:
    return {str(key): _plain_text(value, f'{file}: {name}.{key}')
            for key, value in _section(given, file, name, TEST_KEYS).items() if value is not None}


def _plain_text(value: Any, where: str) -> str:
    if isinstance(value, (dict, list)):
        raise ImportingError(f'{where} is {value!r}: give a text or a number')
    if isinstance(value, (datetime, date)):
        return value.isoformat()
    if isinstance(value, float) and value == int(value) and abs(value) < 1e15:
        return str(int(value))
    return str(value).strip()


def _split(given: Any, file: str) -> Split | None:
    if given is None:
        return None
    where = f'{file}: split'
    section = _section(given, file, 'split', ('by', 'column', 'seconds', 'runs'))
    by = section.get('by')
    if by not in ('column', 'gap'):
        raise ImportingError(f'{where}.by is {by!r}: give column or gap')
    if (by == 'column') != ('column' in section):
        raise ImportingError(f'{where}: by: column needs column:, by: gap has none')
    seconds = _number(section.get('seconds', 1.0), f'{where}.seconds')
    if seconds <= 0:
        raise ImportingError(f'{where}.seconds is {seconds:g}: give the gap between two runs in s')
    runs = section.get('runs') or ({} if by == 'column' else [])
    if not isinstance(runs, Mapping if by == 'column' else list):
        raise ImportingError(f'{where}.runs: give a section by value of the column, or a list of '
                             'sections in order of time for by: gap')
    pairs = runs.items() if isinstance(runs, Mapping) else enumerate(runs, 1)
    return Split(str(by), str(section.get('column', '')), seconds,
                 {_plain_text(label, where): _test(test, file, 'split.runs')
                  for label, test in pairs})
