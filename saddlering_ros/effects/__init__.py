"""The catalogue of causes: one file, one effect; found by walking this folder."""

from __future__ import annotations

import importlib
import inspect
import pkgutil
from collections.abc import Mapping
from functools import lru_cache

from saddlering_ros.effects.base import Effect, EffectError, EffectParameter, Variant
from saddlering_ros.effects.extension import NO_EXTENSION, RingExtension

__all__ = ['NO_EXTENSION', 'Effect', 'EffectError', 'EffectParameter', 'RingExtension', 'Variant',
           'catalogue', 'extension_of']


@lru_cache(maxsize=1)
def catalogue() -> dict[str, Effect]:
    """Every effect of this folder by its id, in alphabetical order."""
    found: dict[str, Effect] = {}
    for module_info in pkgutil.iter_modules(__path__):
        module = importlib.import_module(f'{__name__}.{module_info.name}')
        for _, cls in inspect.getmembers(module, inspect.isclass):
            if issubclass(cls, Effect) and not inspect.isabstract(cls):
                found[cls.id] = cls()
    return dict(sorted(found.items()))


def extension_of(effects: Mapping[str, Mapping[str, float]]) -> RingExtension:
    """The knobs that the given effects turn; EffectError for an id or parameter unknown."""
    extension = NO_EXTENSION
    for name, values in effects.items():
        effect = catalogue().get(name)
        if effect is None:
            raise EffectError(f'effects.{name} is not in the catalogue: '
                              f'choose from {", ".join(catalogue())}')
        extension = effect.extend(extension, effect.complete(values))
    return extension
