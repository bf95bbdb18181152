"""The blocks of an MDF 4 file (ASAM MDF 4.1): their layout, and the bytes of the records.

Source of the format: ASAM MDF, version 4.1.0, chapters on blocks (the layout is public). Only what
loggers of a test rig write is read: sorted groups of fixed-length records, plain or zipped.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
import re
import struct
from typing import BinaryIO
import zlib

import numpy as np

from saddlering_ros.importing.errors import ImportingError

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
