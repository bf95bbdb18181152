"""The catalogue of causes: one file, one effect; found by walking this folder."""

from __future__ import annotations

from collections.abc import Mapping
import difflib
from functools import lru_cache
import importlib
import inspect
import pkgutil

from saddlering_ros.effects.base import (
    Choice,
    Effect,
    EffectError,
    EffectParameter,
    STAGES,
    Variant,
)
from saddlering_ros.effects.extension import NO_EXTENSION, RingExtension

__all__ = [
    'NO_EXTENSION', 'STAGES', 'Choice', 'Effect', 'EffectError', 'EffectParameter',
    'RingExtension', 'Variant', 'catalogue', 'effect', 'extension_of',
]


@lru_cache(maxsize=1)
def _found() -> dict[str, Effect]:
    found: dict[str, Effect] = {}
    for module_info in pkgutil.iter_modules(__path__):
        module = importlib.import_module(f'{__name__}.{module_info.name}')
        for _, cls in inspect.getmembers(module, inspect.isclass):
            is_here = cls.__module__ == module.__name__
            if is_here and issubclass(cls, Effect) and not inspect.isabstract(cls):
                found[cls.id] = cls()
    return dict(sorted(found.items()))


def catalogue() -> dict[str, Effect]:
    """Every effect of this folder by its id, in alphabetical order (the caller's own dict)."""
    return dict(_found())


def effect(effect_id: str) -> Effect:
    """The effect of that id; EffectError that names the ids spelled most like it."""
    known = _found()
    if effect_id in known:
        return known[effect_id]
    near = difflib.get_close_matches(effect_id, known, n=3, cutoff=0.5)
    raise EffectError(f'effects.{effect_id} is not in the catalogue: '
                      f'choose {" or ".join(near) if near else "from " + ", ".join(known)}')


def extension_of(effects: Mapping[str, Mapping[str, float]]) -> RingExtension:
    """The extension of effects (id to parameter values); EffectError for what does not exist."""
    extension = NO_EXTENSION
    for effect_id, values in effects.items():
        one = effect(effect_id)
        extension = one.extend(extension, one.complete(values))
    return extension
