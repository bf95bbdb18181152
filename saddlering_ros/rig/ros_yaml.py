"""ROS 2 parameter files: the `/**: ros__parameters:` shape, read into a nested dictionary."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import yaml

from saddlering_ros.errors import SaddleringError
from saddlering_ros.plain_yaml import parse_yaml


def read_ros_parameters(path: Path, error: type[SaddleringError]) -> dict[str, Any]:
    """The parameters of the file's first node entry, nested; dotted keys are unfolded.

    Raises `error` with one line when the file cannot be read or has another shape.
    """
    try:
        text = path.read_text(encoding='utf-8')
    except (OSError, UnicodeDecodeError) as problem:
        reason = getattr(problem, 'strerror', None) or 'not a text file'
        raise error(f'{path}: cannot be read ({reason}): check the path') from problem
    try:
        document = parse_yaml(text)
    except yaml.YAMLError as problem:
        mark = getattr(problem, 'problem_mark', None)
        line = f', line {mark.line + 1}' if mark is not None else ''
        raise error(f'{path}{line}: is not YAML: correct the file') from problem
    if not isinstance(document, Mapping):
        raise error(f'{path}: is not a ROS 2 parameter file: '
                    'start it with "/**: ros__parameters:"')
    for node in document.values():
        if isinstance(node, Mapping) and isinstance(node.get('ros__parameters'), Mapping):
            return unfold(node['ros__parameters'])
    raise error(f'{path}: has no ros__parameters: start it with "/**: ros__parameters:"')


def unfold(parameters: Mapping[str, Any]) -> dict[str, Any]:
    """Dotted keys (`rig.preload`) made nested dictionaries; numbers written 1e8 made floats."""
    result: dict[str, Any] = {}
    for key, value in parameters.items():
        *parents, last = str(key).split('.')
        place = result
        for parent in parents:
            place = place.setdefault(parent, {})
        value = unfold(value) if isinstance(value, Mapping) else _number(value)
        if isinstance(value, dict) and isinstance(place.get(last), dict):
            place[last].update(value)
        else:
            place[last] = value
    return result


def _number(value: Any) -> Any:
    """YAML 1.1 reads `1e8` as text; ROS reads it as a number, and so do we."""
    if isinstance(value, list):
        return [_number(item) for item in value]
    if not isinstance(value, str):
        return value
    try:
        return float(value)
    except ValueError:
        return value
