"""YAML from any source as plain values: no text can run code, fill memory or take long."""

import os
from pathlib import Path
import re
import stat
from typing import Any, TypeGuard

import yaml

from saddlering_ros.errors import SaddleringError

MAX_BYTES = 1 << 20
"""Longest text that is read [characters]."""

DEEPEST = 50
"""Most collections inside each other."""

LONGEST_NUMBER = 100
"""Most characters of a number; YAML 1.1 reads 1:1:1... as one, in time growing as its square."""


class _Loader(getattr(yaml, 'CSafeLoader', yaml.SafeLoader)):  # type: ignore[misc]
    """libyaml's, ten times as fast, where PyYAML was built with it; both make plain values only.

    A list of parameters in a launch file reaches its node as a YAML sequence with the tag of a
    Python tuple. It is read as a list, which is what rclpy makes of it.
    """


_Loader.add_constructor('tag:yaml.org,2002:python/tuple', _Loader.construct_yaml_seq)

_NUMBER = re.compile(r'[-+0-9_:.]+')

_UNCLEAR_NUMBER = re.compile(
    r'[-+]?(?:0[0-9_]+|0b[01_]+|0o[0-7_]+|0x[0-9a-fA-F_]+|[0-9][0-9_]*_[0-9_]*|'
    r'[0-9]+(?::[0-5]?[0-9])+)')
"""0110 is 72 to YAML 1.1 and to ROS, 110 to YAML 1.2; 1:30 is 90; 1_000 is text to ROS."""


class YamlRefused(yaml.YAMLError):
    """The text is YAML, but it holds something that is not accepted; `line` counts from 1."""

    def __init__(self, reason: str, place: yaml.Event | yaml.Node | None = None) -> None:
        super().__init__(reason)
        self.reason = reason
        self.line = None if place is None else _line(place)


def _line(place: yaml.Event | yaml.Node) -> int:
    return place.start_mark.line + 1 if place.start_mark is not None else 0


def is_number(value: object) -> TypeGuard[float]:
    """Whether a value of a file is a number, which True and False are not."""
    return isinstance(value, (int, float)) and not isinstance(value, bool)


def parse_yaml(text: str) -> Any:
    """The one document of `text`; YAMLError if it cannot be read or may not be."""
    if len(text) > MAX_BYTES:
        raise YamlRefused(f'is longer than {MAX_BYTES} characters: check the file')
    try:
        depth = 0
        for event in yaml.parse(text, _Loader):
            if isinstance(event, yaml.AliasEvent):
                raise YamlRefused('holds an alias (*name), which is not accepted: write the value '
                                  'out', event)
            if isinstance(event, yaml.ScalarEvent) and len(event.value) > LONGEST_NUMBER and (
                    _NUMBER.fullmatch(event.value)):
                raise YamlRefused(f'holds a number of more than {LONGEST_NUMBER} digits: '
                                  'shorten it', event)
            depth += isinstance(event, yaml.CollectionStartEvent)
            depth -= isinstance(event, yaml.CollectionEndEvent)
            if depth > DEEPEST:
                raise YamlRefused(f'holds more than {DEEPEST} collections inside each other: '
                                  'correct the file', event)
        return yaml.load(text, _Loader)
    except (ValueError, LookupError, AttributeError, TypeError, ArithmeticError,
            RecursionError) as problem:  # faults that the constructors of PyYAML accept
        raise yaml.YAMLError(str(problem)) from problem


def parse_strict_yaml(text: str) -> Any:
    """As `parse_yaml`; duplicate keys and numbers that readers take differently are refused."""
    value, nodes = parse_yaml(text), [yaml.compose(text, _Loader)]
    while nodes:
        node = nodes.pop()
        if isinstance(node, yaml.MappingNode):
            lines: dict[str, int] = {}
            for key in (key for key, _ in node.value if isinstance(key, yaml.ScalarNode)):
                if key.value in lines:
                    raise YamlRefused(f'the key {key.value!r} is given twice in one section '
                                      f'(first in line {lines[key.value]}): remove one', key)
                lines[key.value] = _line(key)
            nodes += [entry for pair in node.value[::-1] for entry in pair[::-1]]
        elif isinstance(node, yaml.SequenceNode):
            nodes += node.value[::-1]
        elif isinstance(node, yaml.ScalarNode) and not node.style and (
                _UNCLEAR_NUMBER.fullmatch(node.value)):
            raise YamlRefused(f'the number {node.value} is not in plain decimal digits and would '
                              'be read differently by different programs: write it without '
                              'leading zeros, colons or underscores, or in quotes if it is text',
                              node)
    return value


def read_strict_yaml(path: Path | str, error: type[SaddleringError]) -> Any:
    """The one document of the file at `path`, read by `parse_strict_yaml`.

    Raises `error` with one line that names the file, the line and the reason. Only regular files
    of at most MAX_BYTES bytes are opened: a pipe would block and a device would never end.
    """
    text = read_regular_text(Path(path), error)
    try:
        return parse_strict_yaml(text)
    except YamlRefused as problem:
        line = '' if problem.line is None else f', line {problem.line}'
        raise error(f'{path}{line}: {problem.reason}') from problem
    except yaml.YAMLError as problem:
        mark, reason = (getattr(problem, name, None) for name in ('problem_mark', 'problem'))
        line = '' if mark is None else f', line {mark.line + 1}'
        beside = f' ({reason or problem})' if reason or mark is None else ''
        raise error(f'{path}{line}: is not YAML{beside}: correct the file') from problem


def read_regular_text(path: Path, error: type[SaddleringError], limit: int = MAX_BYTES) -> str:
    """The text of a regular file of at most `limit` bytes; `error` with one line otherwise.

    It never waits for data. A read of some files below /proc, regular by their kind, never ends.
    """
    try:
        handle, data = os.open(path, os.O_RDONLY | os.O_NONBLOCK | os.O_CLOEXEC), b''
        try:
            mode = os.fstat(handle).st_mode  # of the open file: its path may change meanwhile
            if not stat.S_ISREG(mode):
                kind = 'a directory' if stat.S_ISDIR(mode) else 'a pipe or device'
                raise error(f'{path}: cannot be read ({kind}): give the path of a regular file')
            while len(data) <= limit and (block := os.read(handle, limit + 1 - len(data))):
                data += block
        except BlockingIOError as problem:
            raise error(f'{path}: cannot be read (it waits for data): give the path of a regular '
                        'file') from problem
        finally:
            os.close(handle)
        if len(data) > limit:
            raise error(f'{path}: is larger than {limit >> 20} MB, the limit for such files: '
                        'check the path')
        return data.decode('utf-8')
    except (OSError, UnicodeDecodeError, ValueError) as problem:
        if isinstance(problem, SaddleringError):
            raise
        reason = getattr(problem, 'strerror', None) or 'not a text file'
        raise error(f'{path}: cannot be read ({reason}): check the path') from problem
