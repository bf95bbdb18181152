"""Checks of the kinds of arguments: a wrong kind is refused in a line, not by a traceback."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
import math
import os
from pathlib import Path
from typing import Any

import numpy as np

from saddlering_ros.api.errors import ApiError
from saddlering_ros.progress import IsCancelled, OnProgress


def check_path(name: str, given: object, also: str = '') -> None:
    """ApiError unless an argument is a path; `also` names what else it may be."""
    if not isinstance(given, (str, os.PathLike)):
        raise ApiError(f'{name} is {_kind(given)}: give a path{also}')


def check_whole(name: str, given: object) -> None:
    """ApiError unless an argument is a whole number."""
    if not _is_whole(given):
        raise ApiError(f'{name} is {given!r}: give a whole number')


def check_seed(seed: int) -> None:
    """Refuse a seed that no random generator takes."""
    if not _is_whole(seed) or seed < 0:
        raise ApiError(f'seed is {seed!r}: give a whole number, 0 or above')


def check_number(name: str, given: object) -> None:
    """ApiError unless an argument is a finite number."""
    if not _is_number(given):
        raise ApiError(f'{name} is {given!r}: give a number')


def check_bounds(bounds: object) -> None:
    """ApiError unless bounds are pairs of numbers by the name of a parameter."""
    if not isinstance(bounds, Mapping):
        raise ApiError(f'bounds is {_kind(bounds)}: give {{name: (low, high)}}')
    for name, pair in bounds.items():
        is_pair = isinstance(pair, (tuple, list)) and len(pair) == 2
        if not is_pair or not all(map(_is_number, pair)):
            raise ApiError(f'bounds of {name} are {pair!r}: give (low, high) in SI units')


def check_calls(on_progress: OnProgress | None, is_cancelled: IsCancelled | None) -> None:
    """ApiError unless both can be called or are None."""
    for name, given in (('on_progress', on_progress), ('is_cancelled', is_cancelled)):
        if given is not None and not callable(given):
            raise ApiError(f'{name} is {_kind(given)}: give a function, or None')


def several(name: str, given: Any, one: tuple[type, ...]) -> list[Any]:
    """The items of an argument that is one item of the kinds `one`, or several of them."""
    kinds = (*one, Path, str)
    if isinstance(given, kinds):
        return [given]
    advice = 'give bags of read_bag or paths, one or a list of them'
    if isinstance(given, Mapping) or not isinstance(given, Iterable):
        raise ApiError(f'{name} is {_kind(given)}: {advice}')
    found = list(given)
    for number, item in enumerate(found):
        if not isinstance(item, kinds):
            raise ApiError(f'{name}[{number}] is {_kind(item)}: {advice}')
    return found


def _is_whole(given: object) -> bool:
    return isinstance(given, (int, np.integer)) and not isinstance(given, bool)


def _is_number(given: object) -> bool:
    return (isinstance(given, (int, float, np.integer, np.floating))
            and not isinstance(given, bool) and math.isfinite(given))


def _kind(given: object) -> str:
    return 'None' if given is None else f'of type {type(given).__name__}'
