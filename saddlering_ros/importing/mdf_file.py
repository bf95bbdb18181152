"""MDF 4 files, as loggers and INCA or CANape write them: sorted groups of records.

Source of the format: ASAM MDF, version 4.1.0, chapters on blocks (the layout is public). Only what
loggers of a test rig write is read: sorted groups of fixed-length records, plain or zipped. It is
read by hand, because asammdf (LGPL-3) would bring pandas, canmatrix, lxml, numexpr and five more
packages to an installation, in place of the 300 lines below.
"""

from __future__ import annotations

from collections.abc import Collection, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
import re
import struct
from typing import Any, BinaryIO
import zlib

import numpy as np
from numpy.typing import NDArray

from saddlering_ros.importing.calibration import ImportingError
from saddlering_ros.importing.source import BLOCK_ROWS, Column, NUMBER, Source, Timing

_HEAD = struct.Struct('<4s4xQQ')
HEADER_PLACE = 64
"""Where the header block of every file lies."""

MAX_BLOCK = 1 << 28
"""A block of texts or descriptions, or a zipped one, that claims to be larger is damaged."""

MAX_BLOCKS = 1_000_000
"""A list of more blocks has no end."""


@dataclass(frozen=True)
class MdfBlock:
    """A block: its four-character id, the places it links to, and its data."""

    id: str
    links: tuple[int, ...]
    data: bytes


class MdfBlocks:
    """Reads the blocks of an open file."""

    def __init__(self, file: BinaryIO, where: str) -> None:
        self._file = file
        self._where = where
        self._file.seek(0, 2)
        self._size = self._file.tell()

    def block(self, place: int, *ids: str) -> MdfBlock:
        """The block at `place`, which must be one of `ids`."""
        name, length, links = self._head(place)
        if ids and name not in ids:
            raise self.damaged(f'a block {name} where {" or ".join(ids)} should be')
        if length > MAX_BLOCK:
            raise self.damaged(f'a block {name} of {length} bytes')
        body = self._file.read(length - _HEAD.size)
        if len(body) < length - _HEAD.size or links * 8 > len(body):
            raise self.damaged('it ends too early')
        return MdfBlock(name, struct.unpack(f'<{links}Q', body[:links * 8]), body[links * 8:])

    def chain(self, place: int, name: str) -> Iterator[MdfBlock]:
        """A block and all that follow it by their first link."""
        for _ in range(MAX_BLOCKS):
            if not place:
                return
            block = self.block(place, name)
            yield block
            place = block.links[0]
        raise self.damaged(f'a list of {name} blocks without an end')

    def text(self, place: int) -> str:
        """The text at `place`, '' for none; tags of a description are left out."""
        if not place:
            return ''
        block = self.block(place, '##TX', '##MD')
        text = block.data.split(b'\0')[0].decode('utf-8', 'replace')
        if block.id == '##MD':
            inner = re.search(r'<TX[^>]*>(.*?)</TX>', text, re.S)
            text = inner[1] if inner else re.sub(r'<[^>]*>', '', text)
        return text.strip()

    def pieces(self, place: int) -> Iterator[bytes]:
        """The bytes of all records of a group, piece by piece."""
        if not place:
            return
        name, length, _ = self._head(place)
        if name == '##DT':
            yield from self._plain(place + _HEAD.size, length - _HEAD.size)
        elif name == '##DZ':
            yield self._unzipped(self.block(place))
        elif name == '##HL':
            yield from self.pieces(self.block(place).links[0])
        elif name == '##DL':
            for block in self.chain(place, '##DL'):
                for piece in block.links[1:]:
                    yield from self.pieces(piece)
        else:
            raise ImportingError(f'{self._where}: its records are kept as {name}, which is not '
                                 'read: save the file as MDF 4.10 with sorted records')

    def damaged(self, words: str) -> ImportingError:
        """An error that names the fault."""
        return ImportingError(f'{self._where}: is damaged ({words}): copy or save the file again')

    def _head(self, place: int) -> tuple[str, int, int]:
        if not 0 < place <= self._size - _HEAD.size:
            raise self.damaged('a link leads outside of the file')
        self._file.seek(place)
        name, length, links = _HEAD.unpack(self._file.read(_HEAD.size))
        if not name.startswith(b'##') or length < _HEAD.size:
            raise self.damaged('a link does not lead to a block')
        return name.decode('ascii', 'replace'), length, links

    def _plain(self, place: int, length: int) -> Iterator[bytes]:
        self._file.seek(place)
        while length > 0:
            piece = self._file.read(min(length, 1 << 22))
            if not piece:
                raise self.damaged('its records end too early')
            length -= len(piece)
            place += len(piece)
            yield piece
            self._file.seek(place)

    def _unzipped(self, block: MdfBlock) -> bytes:
        kind, parameter, size, packed = struct.unpack_from('<xxBxIQQ', block.data)
        if size > MAX_BLOCK:
            raise self.damaged('a zipped block of more than 256 MB')
        try:
            unzip = zlib.decompressobj()
            data = unzip.decompress(block.data[24:24 + packed], size)
        except zlib.error as problem:
            raise self.damaged('zipped records cannot be unzipped') from problem
        if len(data) != size:
            raise self.damaged('zipped records end too early')
        if kind == 0 or not parameter:
            return data
        rows = size // parameter
        table = np.frombuffer(data, np.uint8, rows * parameter).reshape(parameter, rows)
        return table.T.tobytes() + data[rows * parameter:]


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
        try:
            self._read_header(self._blocks.block(HEADER_PLACE, '##HD'))
        except (struct.error, IndexError) as problem:
            raise self._blocks.damaged('a block is shorter than it should be') from problem

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
            yield np.frombuffer(left, np.uint8, count * group.record).reshape(count, group.record)

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
        self.columns += (Column(name, unit, rows, NUMBER, self._samples(name), own, (text,)),)

    def _samples(self, name: str) -> tuple[str, ...]:
        """The first three values, for people; none where they cannot be read."""
        channel = self._channels[name]
        group = self._groups[channel.group]
        first = next(iter(self._blocks.pieces(group.data)), b'')
        count = min(3, len(first) // group.record)
        records = np.frombuffer(first, np.uint8, count * group.record).reshape(count, group.record)
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
