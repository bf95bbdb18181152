"""MDF 4 files, as loggers and INCA or CANape write them: sorted groups of records.

Source of the format: ASAM MDF, version 4.1.0, chapters on blocks (the layout is public). Only what
loggers of a test rig write is read: sorted groups of fixed-length records, plain or zipped. It is
read by hand, because asammdf (LGPL-3) would bring pandas, canmatrix, lxml, numexpr and five more
packages to an installation, in place of the 300 lines below.
"""

from collections.abc import Collection, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
import re
import struct
from typing import Any
import zlib

import numpy as np
from numpy.typing import NDArray

from saddlering_ros.errors import counted
from saddlering_ros.importing.calibration import ImportingError
from saddlering_ros.importing.source import Block, BLOCK_ROWS, Column, NUMBER, Source, Timing

_HEAD = struct.Struct('<4s4xQQ')
HEADER_PLACE = 64
"""Where the header block of every file lies."""

MAX_BLOCK = 1 << 28
"""A block of texts or descriptions, or a zipped one, that claims to be larger is damaged."""

MAX_BLOCKS = 1_000_000
"""A list of more blocks has no end."""

_FIXED, _MASTER, _VIRTUAL_MASTER, _TIME = 0, 2, 3, 1
_NUMBERS = {0: '<u', 1: '>u', 2: '<i', 3: '>i', 4: '<f', 5: '>f'}
_ALL_INVALID, _HAS_INVALID_BIT = 1, 2
_CONVERSIONS = (0, 1, 2, 4, 5)
"""Kinds of conversions that are read: none, linear, rational, table with and without lines."""


@dataclass(frozen=True)
class MdfBlock:
    """A block: its four-character id, the places it links to, and its data."""

    id: str
    links: tuple[int, ...]
    data: bytes


class MdfBlocks:
    """Reads the blocks of a file."""

    def __init__(self, path: Path) -> None:
        self._where, self._size = str(path), path.stat().st_size
        self._file = path.open('rb')
        head = self._file.read(HEADER_PLACE)
        if head.startswith(b'UnFinMF'):
            raise ImportingError(f'{path}: was not closed by the program that wrote it: finalize '
                                 'it, with asammdf for example')
        version = head[8:12].decode('ascii', 'replace')
        if not version.startswith('4'):
            raise ImportingError(f'{path}: is of MDF version {version.strip()}: save it as MDF 4')

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
            for begin in range(place + _HEAD.size, place + length, 1 << 22):
                self._file.seek(begin)
                size = min(1 << 22, place + length - begin)
                piece = self._file.read(size)
                if piece:
                    yield piece
                if len(piece) < size:
                    raise self.damaged('its records end too early')
        elif name == '##DZ':
            yield self._unzipped(self.block(place).data)
        elif name == '##HL':
            yield from self.pieces(self.block(place).links[0])
        elif name == '##DL':
            for block in self.chain(place, '##DL'):
                for link in block.links[1:]:
                    yield from self.pieces(link)
        else:
            raise ImportingError(f'{self._where}: its records are kept as {name}, which is not '
                                 'read: save the file as MDF 4.10 with sorted records')

    def damaged(self, words: str) -> ImportingError:
        return ImportingError(f'{self._where}: is damaged ({words}): copy or save the file again')

    def _head(self, place: int) -> tuple[str, int, int]:
        if not 0 < place <= self._size - _HEAD.size:
            raise self.damaged('a link leads outside of the file')
        self._file.seek(place)
        name, length, links = _HEAD.unpack(self._file.read(_HEAD.size))
        if not name.startswith(b'##') or length < _HEAD.size:
            raise self.damaged('a link does not lead to a block')
        return name.decode('ascii', 'replace'), length, links

    def _unzipped(self, block: bytes) -> bytes:
        kind, parameter, size, packed = struct.unpack_from('<xxBxIQQ', block)
        if size > MAX_BLOCK:
            raise self.damaged('a zipped block of more than 256 MB')
        try:
            data = zlib.decompressobj().decompress(block[24:24 + packed], size)
        except zlib.error as problem:
            raise self.damaged('zipped records cannot be unzipped') from problem
        if len(data) != size:
            raise self.damaged('zipped records end too early')
        if kind == 0 or not parameter:
            return data
        rows = size // parameter  # the bytes of all records are sorted by their place in them
        return _table(data, rows, parameter).T.tobytes() + data[rows * parameter:]


@dataclass(frozen=True)
class _Group:
    """Records of one group: where their bytes are, how long each is, and where channels begin."""

    data: int
    record: int
    prefix: int
    content: int
    rows: int


@dataclass(frozen=True)
class _Channel:
    """A number in each record of a group; conversion: kind and its values."""

    group: _Group
    offset: int
    bit: int
    bits: int
    kind: str
    invalid_bit: int
    conversion: tuple[int, tuple[float, ...]]

    def values(self, records: NDArray[np.uint8]) -> NDArray[np.float64]:
        """Physical values of records (N, length) as bytes; NaN where marked invalid."""
        kind, values = self.conversion
        numbers = self._raw(records).astype(np.float64)
        if kind == 1 and values[:2] != (0.0, 1.0):
            numbers = numbers * values[1] + values[0]
        elif kind == 2:
            numbers = np.polyval(values[:3], numbers) / np.polyval(values[3:6], numbers)
        elif kind == 4:
            numbers = np.interp(numbers, values[0::2], values[1::2])
        elif kind == 5:
            nearest = np.abs(numbers[:, None] - np.array(values[0::2])).argmin(axis=1)
            numbers = np.array(values[1::2])[nearest]
        if self.invalid_bit >= 0:
            place = self.group.prefix + self.group.content + self.invalid_bit // 8
            numbers = np.where(records[:, place] >> (self.invalid_bit % 8) & 1, np.nan, numbers)
        return np.asarray(numbers)

    def _raw(self, records: NDArray[np.uint8]) -> NDArray[Any]:
        start, size = self.group.prefix + self.offset, (self.bit + self.bits + 7) // 8
        bytes_ = np.ascontiguousarray(records[:, start:start + size])
        if self.bit == 0 and self.bits in (8, 16, 32, 64):
            return bytes_.view(f'{self.kind}{size}')[:, 0]
        whole = np.zeros(len(bytes_), dtype=np.uint64)
        for shift, byte in enumerate(range(size) if self.kind[0] == '<' else range(size)[::-1]):
            whole |= bytes_[:, byte].astype(np.uint64) << np.uint64(8 * shift)
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
        self._blocks = MdfBlocks(path)
        self._channels: dict[str, _Channel] = {}
        try:
            header = self._blocks.block(HEADER_PLACE, '##HD')
            start, flags = struct.unpack_from('<Q4xB', header.data)
            if flags & 1:
                self.warn('gives its start in local time without a zone, which is not used: give '
                          'start: in the map')
            start = None if flags & 1 else start or None
            number = 0
            for group in self._blocks.chain(header.links[0], '##DG'):
                number += self._read_data_group(group, number, start)
        except ImportingError:
            raise
        except (struct.error, IndexError, ValueError) as problem:
            raise self._blocks.damaged('a block is shorter than it should be') from problem

    def blocks(self, names: Sequence[str], as_text: Collection[str] = ()) -> Iterator[Block]:
        groups = {self._channels[name].group for name in names}
        if len(groups) > 1:
            raise ImportingError(f'{self.path}: {", ".join(names)} belong to different groups: '
                                 'give each channel a time: of its own')
        group, left = groups.pop(), b''
        rows = group.rows
        for piece in self._blocks.pieces(group.data):
            left += piece
            while rows and len(left) >= group.record * min(BLOCK_ROWS, rows):
                count = min(BLOCK_ROWS, rows)
                records = _table(left, group.record, count)
                yield {name: self._channels[name].values(records) for name in names}
                left, rows = left[count * group.record:], rows - count
        if rows:
            count = len(left) // group.record
            self.warn(f'a group ends {counted(rows - count, "record")} early: the file was not '
                      'closed properly')
            records = _table(left, group.record, count)
            yield {name: self._channels[name].values(records) for name in names}

    def _read_data_group(self, block: MdfBlock, number: int, start: int | None) -> int:
        """Read the channels of a data group; how many groups of records it has, 0 or 1."""
        prefix = block.data[0]
        groups = []
        for one in self._blocks.chain(block.links[1], '##CG'):
            if struct.unpack_from('<8xQ', one.data)[0]:
                groups.append(one)
                continue
            for channel in self._blocks.chain(one.links[1], '##CN'):
                self.unread[self._blocks.text(channel.links[2])] = 'its group has no records'
        if len(groups) > 1:
            raise ImportingError(f'{self.path}: has unsorted records: sort it in the program that '
                                 'wrote it, or with asammdf')
        if not groups:
            return 0
        rows, flags, content, invalid = struct.unpack_from('<8xQH6xII', groups[0].data)
        if flags & 1:
            return 0
        group = _Group(block.links[2], prefix + content + invalid, prefix, content, rows)
        channels = list(self._blocks.chain(groups[0].links[1], '##CN'))
        timing = None
        for channel in channels:
            kind, sync = channel.data[0], channel.data[1]
            if kind == _VIRTUAL_MASTER and sync == _TIME:
                how, values, _ = self._conversion(channel.links[4])
                first, period = values[:2] if how == 1 else (0.0, 1.0)
                timing = Timing(start, first, period)
            elif kind == _MASTER and sync == _TIME:
                timing = Timing(start, column=f'{number}/{self._blocks.text(channel.links[2])}')
        for channel in channels:
            self._read_channel(channel, number, group, timing)
        return 1

    def _read_channel(
        self, block: MdfBlock, number: int, group: _Group, timing: Timing | None,
    ) -> None:
        kind, _, form, bit, offset, bits, flags, invalid = struct.unpack_from(
            '<BBBBIIII', block.data)
        text = self._blocks.text(block.links[2])
        is_float = form in (4, 5)
        how, values, unit = self._conversion(block.links[4])
        is_number = (kind in (_FIXED, _MASTER) and form in _NUMBERS and 0 < bits <= 64
                     and not block.links[1] and not (
                         is_float and (bit or bits not in (16, 32, 64))))
        for why, is_so in (('it holds no single numbers', not is_number),
                           ('all of it is marked invalid', flags & _ALL_INVALID),
                           ('its conversion is to text, by ranges or by a formula',
                            how not in _CONVERSIONS)):
            if is_so:
                self.unread[text] = why
                return
        name = f'{number}/{text}'
        while name in self._channels:
            name += '#2'
        channel = self._channels[name] = _Channel(
            group, offset, bit, bits, _NUMBERS[form],
            invalid if flags & _HAS_INVALID_BIT else -1, (how, values))
        first = next(self._blocks.pieces(group.data), b'')
        count = min(3, len(first) // group.record)
        samples = tuple(map(str, channel.values(_table(first, group.record, count))))
        its_time = timing if timing is None or timing.column != name else None
        self.columns += (Column(name, self._blocks.text(block.links[6]) or unit, group.rows,
                                NUMBER, samples, its_time, (text,)),)

    def _conversion(self, place: int) -> tuple[int, tuple[float, ...], str]:
        """Kind, values and unit of the conversion at `place`, if there is one."""
        if not place:
            return 0, (), ''
        block = self._blocks.block(place, '##CC')
        kind, count = struct.unpack_from('<B5xH', block.data)
        unit = self._blocks.text(block.links[1])
        return kind, struct.unpack_from(f'<{count}d', block.data, 24), unit


def _table(data: bytes, record: int, count: int) -> NDArray[np.uint8]:
    return np.frombuffer(data, np.uint8, count * record).reshape(count, record)
