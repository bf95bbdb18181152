"""YAML from anywhere as plain values: no text can run code, fill memory or take long."""

from __future__ import annotations

import re
from typing import Any

import yaml

LARGEST = 1 << 20
"""Longest text that is read [characters]."""

DEEPEST = 50
"""Most collections inside each other."""

LONGEST_NUMBER = 100
"""Most characters of a number; YAML 1.1 reads 1:1:1... as one, in time growing as its square."""

_LOADER = getattr(yaml, 'CSafeLoader', yaml.SafeLoader)
"""libyaml's, ten times as fast, where PyYAML was built with it; both make plain values only."""

_NUMBER = re.compile(r'[-+0-9_:.]+')


def parse_yaml(text: str) -> Any:
    """The one document of `text`; YAMLError for whatever cannot be read or should not be."""
    if len(text) > LARGEST:
        raise yaml.YAMLError(f'longer than {LARGEST} characters')
    try:
        _check_events(text)
        return yaml.load(text, _LOADER)
    except (ValueError, LookupError, AttributeError, TypeError, ArithmeticError,
            RecursionError) as problem:  # what the constructors of PyYAML let through
        raise yaml.YAMLError(str(problem)) from problem


def _check_events(text: str) -> None:
    depth = 0
    for event in yaml.parse(text, _LOADER):
        if isinstance(event, yaml.AliasEvent):
            raise yaml.YAMLError('aliases, of which a few can stand for very much, are not read')
        if isinstance(event, yaml.ScalarEvent) and len(event.value) > LONGEST_NUMBER and \
                _NUMBER.fullmatch(event.value):
            raise yaml.YAMLError('a number of very many digits')
        depth += isinstance(event, yaml.CollectionStartEvent)
        depth -= isinstance(event, yaml.CollectionEndEvent)
        if depth > DEEPEST:
            raise yaml.YAMLError(f'more than {DEEPEST} collections inside each other')
