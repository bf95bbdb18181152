"""Names of a package that are imported on first use, so that the package itself costs little."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from importlib import import_module
import sys
from typing import Any


def names_on_first_use(package: str, places: Mapping[str, str]) -> Callable[[str], Any]:
    """The `__getattr__` of a package; places: module of each name, below the package (PEP 562)."""
    def get(name: str) -> Any:
        if name not in places:
            raise AttributeError(f'module {package!r} has no attribute {name!r}')
        value = getattr(import_module(f'{package}.{places[name]}'), name)
        setattr(sys.modules[package], name, value)
        return value
    return get
