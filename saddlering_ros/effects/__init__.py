"""The catalogue of causes: one file, one effect; found by walking this folder."""

from collections.abc import Mapping
import difflib
from functools import lru_cache
import importlib
import inspect
import os
from pathlib import Path
import pkgutil

from saddlering_ros.effects.base import Choice, EffectError, EffectParameter, RingEffect, Variant
from saddlering_ros.effects.extension import (
    NO_EXTENSION,
    OwnParameter,
    RingExtension,
    shared_parameters,
    STAGES,
)
from saddlering_ros.effects.law import Law, LawEffect, read_law_effect
from saddlering_ros.rig import Rig

__all__ = [
    'NO_EXTENSION', 'STAGES', 'Choice', 'EffectError', 'EffectParameter', 'LawEffect',
    'OwnParameter', 'RingEffect', 'RingExtension', 'Variant', 'catalogue', 'effect',
    'extension_of', 'laws_of', 'own_files', 'own_parameters', 'use_folder']

FOLDER_VARIABLE = 'SADDLERING_EFFECTS'
"""Environment variable that holds the folder of the user's own effects."""


@lru_cache(maxsize=1)
def _shipped() -> dict[str, RingEffect]:
    found: dict[str, RingEffect] = {}
    for module_info in pkgutil.iter_modules(__path__):
        module = importlib.import_module(f'{__name__}.{module_info.name}')
        for _, cls in inspect.getmembers(module, inspect.isclass):
            is_here = cls.__module__ == module.__name__ and hasattr(cls, 'title')
            if is_here and issubclass(cls, RingEffect):
                found[cls.id] = cls()
    return found


@lru_cache(maxsize=1)
def own_parameters() -> tuple[OwnParameter, ...]:
    """Extension parameters that the effects of this folder declare themselves, by their names."""
    found = sorted(item.adds_to for one in _shipped().values() for item in one.parameters
                   if isinstance(item.adds_to, OwnParameter))
    names = [item.name for item in found] + [item.name for item in shared_parameters()]
    twice = sorted({name for name in names if names.count(name) > 1})
    if twice:
        raise EffectError(f'extension parameter {", ".join(twice)} is declared twice: '
                          'give each its own name')
    return tuple(found)


@lru_cache(maxsize=4)
def _of_folder(folder: str) -> dict[str, RingEffect]:
    """Effects of a user's folder, one file each."""
    path = Path(folder)
    if not path.is_dir():
        raise EffectError(f'{folder}: is no folder: give a folder of effect files (*.yaml)')
    found: dict[str, RingEffect] = {}
    for file in sorted(path.glob('*.yaml')):
        own = read_law_effect(file)
        if own.id in _shipped() or own.id in found:
            raise EffectError(f'{file}: the id {own.id} is taken: give the effect another id')
        found[own.id] = own
    return found


def use_folder(folder: Path | str) -> None:
    """Take the effects of a user's folder into the catalogue of this process.

    EffectError for a file that is no effect. A process that is started by this one takes them too.
    """
    _of_folder(str(folder))
    os.environ[FOLDER_VARIABLE] = str(folder)


def own_files() -> tuple[Path, ...]:
    """The effect files of the user's folder that this process uses."""
    folder = os.environ.get(FOLDER_VARIABLE, '')
    return tuple(sorted(Path(folder).glob('*.yaml'))) if folder else ()


def _known() -> dict[str, RingEffect]:
    """Every effect by its id, in alphabetical order, with those of the user's folder."""
    folder = os.environ.get(FOLDER_VARIABLE, '')
    return dict(sorted({**_shipped(), **(_of_folder(folder) if folder else {})}.items()))


def catalogue() -> dict[str, RingEffect]:
    """The effects that a diagnosis can name as a cause, by their ids, in alphabetical order."""
    return {name: one for name, one in _known().items() if one.is_searched}


def effect(effect_id: str) -> RingEffect:
    """The effect of that id; EffectError that names the ids spelled most like it."""
    known = _known()
    if effect_id in known:
        return known[effect_id]
    near = difflib.get_close_matches(effect_id, known, n=3, cutoff=0.5)
    choice = ' or '.join(near) if near else f'from {", ".join(known)}'
    raise EffectError(f'effects.{effect_id} is not in the catalogue: choose {choice}')


def extension_of(effects: Mapping[str, Mapping[str, float]],
                 rig: Rig | None = None) -> RingExtension:
    """The extension of effects (id to parameter values) on a rig (None: that of the catalogue).

    EffectError for an unknown name or a value out of bounds.
    """
    extension = NO_EXTENSION
    for effect_id, values in effects.items():
        one = effect(effect_id)
        extension = one.extend(extension, one.complete(values, rig))
    return extension


def laws_of(effects: Mapping[str, Mapping[str, float]]) -> tuple[Law, ...]:
    """The laws of a user's own effects among `effects`, with their sizes."""
    chosen = [(effect(name), values) for name, values in effects.items()]
    return tuple(one.bound(one.complete(values)) for one, values in chosen
                 if isinstance(one, LawEffect))
