"""Plain data between two processes as JSON: values, tuples, arrays, and dataclasses known by name.

Reading makes these types only: no code, and no class that is not in the given list.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import fields, is_dataclass
import json
import socket
import struct
from typing import Any

import numpy as np

MAX_BYTES = 1 << 26
"""Bytes of the largest message."""

_LENGTH = struct.Struct('<I')
_TYPE, _TUPLE, _ARRAY = '(type)', '(tuple)', '(array)'


class PlainDataError(ValueError):
    """A value that is no plain data, or bytes that are no message."""


class ValueSocket:
    """A stream socket on which values go whole; `types` are the dataclasses that may."""

    def __init__(self, stream: socket.socket, types: Iterable[type]) -> None:
        self._stream = stream
        self._types = {kind.__name__: kind for kind in types}

    def send(self, value: Any) -> None:
        """Send one value; PlainDataError if it is no plain data, OSError without another end."""
        data = json.dumps(self._plain(value)).encode()
        if len(data) > MAX_BYTES:
            raise PlainDataError(f'a message of {len(data)} bytes is too large')
        self._stream.sendall(_LENGTH.pack(len(data)) + data)

    def receive(self) -> Any:
        """The next value, waited for; EOFError when the other end is gone."""
        (length,) = _LENGTH.unpack(self._exactly(_LENGTH.size))
        if length > MAX_BYTES:
            raise PlainDataError(f'a message of {length} bytes is too large')
        return self._value(json.loads(self._exactly(length)))

    def fileno(self) -> int:
        """For select."""
        return self._stream.fileno()

    def close(self) -> None:
        """Let go of the socket."""
        self._stream.close()

    def _exactly(self, size: int) -> bytes:
        data = bytearray()
        while len(data) < size:
            more = self._stream.recv(min(size - len(data), 1 << 20))
            if not more:
                raise EOFError
            data += more
        return bytes(data)

    def _plain(self, value: Any) -> Any:
        if value is None or isinstance(value, (bool, int, float, str)):
            return value.item() if isinstance(value, np.generic) else value
        if isinstance(value, np.generic):
            return value.item()
        if isinstance(value, np.ndarray) and value.dtype == np.float64:
            return {_ARRAY: value.ravel().tolist(), 'shape': list(value.shape)}
        if isinstance(value, tuple):
            return {_TUPLE: [self._plain(item) for item in value]}
        if isinstance(value, list):
            return [self._plain(item) for item in value]
        if isinstance(value, Mapping):
            return self._mapping(value)
        kind = type(value)
        if is_dataclass(value) and self._types.get(kind.__name__) is kind:
            return {_TYPE: kind.__name__, **{
                field.name: self._plain(getattr(value, field.name)) for field in fields(value)}}
        raise PlainDataError(f'a {kind.__name__} is no plain data')

    def _mapping(self, value: Mapping[Any, Any]) -> dict[str, Any]:
        if not all(isinstance(key, str) and not key.startswith('(') for key in value):
            raise PlainDataError('a key of a mapping is no plain text')
        return {key: self._plain(item) for key, item in value.items()}

    def _value(self, plain: Any) -> Any:
        if isinstance(plain, list):
            return [self._value(item) for item in plain]
        if not isinstance(plain, dict):
            return plain
        if _TUPLE in plain:
            return tuple(self._value(item) for item in plain[_TUPLE])
        if _ARRAY in plain:
            return np.array(plain[_ARRAY], dtype=np.float64).reshape(plain['shape'])
        values = {key: self._value(item) for key, item in plain.items() if key != _TYPE}
        if _TYPE not in plain:
            return values
        if plain[_TYPE] not in self._types:
            raise PlainDataError(f'{plain[_TYPE]!r} is not among the types agreed on')
        return self._types[plain[_TYPE]](**values)
