"""MDF 4 files, as loggers and INCA or CANape write them: sorted groups of records."""

from __future__ import annotations

from collections.abc import Collection, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
import struct
from typing import Any

import numpy as np
from numpy.typing import NDArray

from saddlering_ros.importing.errors import ImportingError
from saddlering_ros.importing.formats.mdf_blocks import HEADER_PLACE, MdfBlock, MdfBlocks
from saddlering_ros.importing.source import BLOCK_ROWS, Column, NUMBER, Source, Timing

_MASTER, _VIRTUAL_MASTER = 2, 3
_TIME = 1
_FIXED = 0
_NUMBERS = {0: '<u', 1: '>u', 2: '<i', 3: '>i', 4: '<f', 5: '>f'}
_ALL_INVALID, _HAS_INVALID_BIT = 1, 2


@dataclass(frozen=True)
class _Group:
    """Records of one group: where their bytes are, and how long each is."""

    data: int
    record: int
    prefix: int
    content: int
    rows: int


@dataclass(frozen=True)
class _Channel:
    """A number in each record of a group; conversion: kind and its values."""

    group: int
    offset: int
    bit: int
    bits: int
    kind: str
    invalid_bit: int
    conversion: tuple[int, tuple[float, ...]]

    def values(self, records: NDArray[np.uint8], group: _Group) -> NDArray[np.float64]:
        """Physical values of records (N, length) as bytes; NaN where marked invalid."""
        start = group.prefix + self.offset
        raw = self._raw(records, start)
        values = _converted(raw, *self.conversion)
        if self.invalid_bit >= 0:
            place = group.prefix + group.content + self.invalid_bit // 8
            values = np.where(records[:, place] >> (self.invalid_bit % 8) & 1, np.nan, values)
        return values

    def _raw(self, records: NDArray[np.uint8], start: int) -> NDArray[Any]:
        size = (self.bit + self.bits + 7) // 8
        part = np.ascontiguousarray(records[:, start:start + size])
        if self.bit == 0 and self.bits in (8, 16, 32, 64):
            return part.view(f'{self.kind}{size}')[:, 0]
        order = range(size) if self.kind[0] == '<' else range(size - 1, -1, -1)
        whole = np.zeros(len(records), dtype=np.uint64)
        for shift, byte in enumerate(order):
            whole |= part[:, byte].astype(np.uint64) << np.uint64(8 * shift)
        whole = (whole >> np.uint64(self.bit)) & np.uint64((1 << self.bits) - 1)
        if self.kind[1] == 'u':
            return whole
        lost = np.uint64(64 - self.bits)
        return (whole << lost).view(np.int64) >> lost.astype(np.int64)


class MdfSource(Source):
    """An MDF 4 file; a column is group/channel, and the channel alone where there is but one."""

    FORMAT = 'MDF4'

    def __init__(self, path: Path) -> None:
        super().__init__(path)
        self._file = path.open('rb')
        head = self._file.read(HEADER_PLACE)
        version = head[8:12].decode('ascii', 'replace')
        if not version.startswith('4'):
            raise ImportingError(f'{path}: is of MDF version {version.strip()}: save it as MDF 4')
        self._blocks = MdfBlocks(self._file, str(path))
        self._groups: list[_Group] = []
        self._channels: dict[str, _Channel] = {}
        self._columns: list[Column] = []
        try:
            self._read_header(self._blocks.block(HEADER_PLACE, '##HD'))
        except (struct.error, IndexError) as problem:
            raise self._blocks.damaged('a block is shorter than it should be') from problem

    @property
    def columns(self) -> tuple[Column, ...]:
        """Its channels of numbers."""
        return tuple(self._columns)

    def blocks(
        self, names: Sequence[str], as_text: Collection[str] = (),
    ) -> Iterator[dict[str, NDArray[Any]]]:
        """Channels of one group, block by block."""
        groups = {self._channels[name].group for name in names}
        if len(groups) > 1:
            raise ImportingError(f'{self.path}: {", ".join(names)} belong to different groups: '
                                 'give each channel a time: of its own')
        group = self._groups[groups.pop()]
        for records in self._records(group):
            yield {name: self._channels[name].values(records, group) for name in names}

    def _records(self, group: _Group) -> Iterator[NDArray[np.uint8]]:
        left, rows = b'', group.rows
        for piece in self._blocks.pieces(group.data):
            left += piece
            while rows and (len(left) >= group.record * BLOCK_ROWS or
                            len(left) >= group.record * rows):
                count = min(BLOCK_ROWS, rows)
                size = count * group.record
                yield np.frombuffer(left, np.uint8, size).reshape(count, group.record)
                left, rows = left[size:], rows - count
        if rows:
            count = len(left) // group.record
            self.warnings.add(f'{self.path}: a group ends {rows - count} records early: the file '
                              'was not closed properly')
            yield np.frombuffer(left, np.uint8, count * group.record).reshape(
                count, group.record)

    # -- the description -----------------------------------------------------------------------

    def _read_header(self, header: MdfBlock) -> None:
        stamp, flags = struct.unpack_from('<Q4xB', header.data)
        self._start = stamp or None
        if flags & 1:
            self._start = None
            self.warnings.add(f'{self.path}: gives its start in local time without a zone, which '
                              'is not used: give start: in the map')
        for group in self._blocks.chain(header.links[0], '##DG'):
            self._read_data_group(group)

    def _read_data_group(self, block: MdfBlock) -> None:
        prefix = block.data[0]
        groups = [group for group in self._blocks.chain(block.links[1], '##CG')
                  if struct.unpack_from('<8xQ', group.data)[0]]
        if len(groups) > 1:
            raise ImportingError(f'{self.path}: has unsorted records: sort it in the program that '
                                 'wrote it, or with asammdf')
        for group in groups:
            rows, flags, content, invalid = struct.unpack_from('<8xQH6xII', group.data)
            if flags & 1:
                continue
            self._groups.append(_Group(block.links[2], prefix + content + invalid, prefix,
                                       content, rows))
            self._read_channels(group)

    def _read_channels(self, group: MdfBlock) -> None:
        number, timing = len(self._groups) - 1, None
        channels = list(self._blocks.chain(group.links[1], '##CN'))
        for channel in channels:
            kind, sync = channel.data[0], channel.data[1]
            name = f'{number}/{self._blocks.text(channel.links[2])}'
            if kind == _VIRTUAL_MASTER and sync == _TIME:
                how, values = self._conversion(channel.links[4])
                first, period = (values[0], values[1]) if how == 1 else (0.0, 1.0)
                timing = Timing(self._start, first, period)
            elif kind == _MASTER and sync == _TIME:
                timing = Timing(self._start, column=name)
        for channel in channels:
            self._read_channel(channel, number, timing)

    def _read_channel(self, block: MdfBlock, number: int, timing: Timing | None) -> None:
        kind, _, form, bit, offset, bits, flags, invalid = struct.unpack_from(
            '<BBBBIIII', block.data)
        text = self._blocks.text(block.links[2])
        if kind not in (_FIXED, _MASTER) or form not in _NUMBERS or not 0 < bits <= 64 \
                or block.links[1] or flags & _ALL_INVALID:
            return
        if form in (4, 5) and (bit or bits not in (16, 32, 64)):
            return
        conversion = self._conversion(block.links[4])
        if conversion[0] not in (0, 1, 2, 4, 5):
            self.warnings.add(f'{self.path}: channel {text!r} is left out, because its '
                              'conversion is to text or by a formula')
            return
        name = f'{number}/{text}'
        while name in self._channels:
            name += '#2'
        self._channels[name] = _Channel(number, offset, bit, bits, _NUMBERS[form],
                                        invalid if flags & _HAS_INVALID_BIT else -1, conversion)
        unit = self._blocks.text(block.links[6]) or self._unit_of_conversion(block.links[4])
        own = timing if timing is None or timing.column != name else None
        rows = self._groups[number].rows
        self._columns.append(Column(name, unit, rows, NUMBER, self._samples(name), own, (text,)))

    def _samples(self, name: str) -> tuple[str, ...]:
        """The first three values, for people; none where they cannot be read."""
        channel = self._channels[name]
        group = self._groups[channel.group]
        first = next(iter(self._blocks.pieces(group.data)), b'')
        count = min(3, len(first) // group.record)
        records = np.frombuffer(first, np.uint8, count * group.record).reshape(
            count, group.record)
        return tuple(map(str, channel.values(records, group)))

    def _conversion(self, place: int) -> tuple[int, tuple[float, ...]]:
        if not place:
            return 0, ()
        data = self._blocks.block(place, '##CC').data
        kind, count = struct.unpack_from('<B5xH', data)
        return kind, struct.unpack_from(f'<{count}d', data, 24)

    def _unit_of_conversion(self, place: int) -> str:
        return self._blocks.text(self._blocks.block(place, '##CC').links[1]) if place else ''


def _converted(raw: NDArray[Any], kind: int, values: tuple[float, ...]) -> NDArray[np.float64]:
    """Physical values by the conversion of the file."""
    numbers = raw.astype(np.float64)
    if kind == 1:
        offset, factor = values[:2]
        return numbers * factor + offset if (offset, factor) != (0.0, 1.0) else numbers
    if kind == 2:
        above, below = values[:3], values[3:6]
        return np.asarray(np.polyval(above, numbers) / np.polyval(below, numbers))
    if kind == 4:
        return np.asarray(np.interp(numbers, values[0::2], values[1::2]))
    if kind == 5:
        nearest = np.abs(numbers[:, None] - np.array(values[0::2])).argmin(axis=1)
        return np.array(values[1::2])[nearest]
    return numbers
