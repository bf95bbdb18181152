"""A user's own effect: a law in one coordinate, added to the load or to a reading.

The law is a table from a file, for instance the file that a diagnosis writes for a misfit that no
effect of the catalogue explains. Its size is the only parameter. It is not part of a kernel: it is
added sample by sample to the load of the ring, or to the readings of the probes.
"""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from itertools import pairwise
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from saddlering_ros.effects.base import EffectError, EffectParameter, RingEffect
from saddlering_ros.effects.extension import RingExtension
from saddlering_ros.memory_operators import Direction, Plays, Relaxations
from saddlering_ros.plain_yaml import is_number, read_strict_yaml
from saddlering_ros.rig import Rig

Floats = NDArray[np.float64]

LOAD_TARGET = 'hydraulic_load'
TARGETS = (LOAD_TARGET, 'delta_x', 'delta_y', 'gamma', 'parity', 'eddy_current_1',
           'eddy_current_2', 'eddy_current_3', 'eddy_current_4')
"""Targets of a law: channels in metres, gamma in radians, the load in newtons."""

COORDINATES = ('load', 'direction', 'rate', 'time', 'hysteresis', 'relaxation')
"""Coordinates of a table: load [N], direction times a table over load, rate [N/s], time [s] since
the zero; weights of plays over their reaches [N], of relaxations over their time constants [s].
"""

MIN_POINTS = {'hysteresis': 1, 'relaxation': 1}
"""Of other coordinates a table needs two points, because values between them follow straight."""
MAX_POINTS = 4096
"""Every sample of a record moves all plays or relaxations of a law."""
RATE_TIME = 0.1
"""Time constant [s] of the filter by which the rate of the load is seen."""


@dataclass(frozen=True)
class Law:
    """One law: `values` (K,) over `at` (K,) of its coordinate, times `size`.

    turn [N]: the load must turn back by more than this to have another direction.
    """

    target: str
    coordinate: str
    at: tuple[float, ...]
    values: tuple[float, ...]
    turn: float
    size: float = 1.0


class LawHistory:
    """The value of a law along a record: live and offline are this object.

    Every sample is computed in the same way, in any number at once.
    """

    def __init__(self, law: Law, time: float, load: float) -> None:
        self._law = law
        self._at, self._values = np.array(law.at), np.array(law.values)
        self._begin = self._last = time
        self._load = self._slow = load
        self._plays = Plays(self._at, load)
        self._relaxations = Relaxations(self._at)
        self._direction = Direction(law.turn, load)
        self._zero = self._value(time, load)

    def push(self, time: Floats, load: Floats) -> Floats:
        """Values (N,) at samples (N,), minus the value at the start."""
        if self._law.coordinate in ('load', 'time'):
            along = load if self._law.coordinate == 'load' else time - self._begin
            values = self._law.size * np.interp(along, self._at, self._values)
            return np.asarray(values - self._zero)
        pairs = zip(time.tolist(), load.tolist(), strict=True)
        return np.array([self._value(t, p) - self._zero for t, p in pairs])

    def _value(self, time: float, load: float) -> float:
        law, step = self._law, time - self._last
        change, self._last, self._load = load - self._load, time, load
        if law.coordinate == 'hysteresis':
            return law.size * float(self._plays.push(load) @ self._values)
        if law.coordinate == 'relaxation':
            return law.size * float(self._relaxations.push(step, change) @ self._values)
        along = load
        if law.coordinate == 'time':
            along = time - self._begin
        elif law.coordinate == 'rate':
            self._slow += (load - self._slow) * -float(np.expm1(-step / RATE_TIME))
            along = (load - self._slow) / RATE_TIME
        value = law.size * float(np.interp(along, self._at, self._values))
        return self._direction.push(load) * value if law.coordinate == 'direction' else value


class LawEffect(RingEffect):
    """An effect of the user's own folder; its attributes are read from the file."""

    def __init__(self, effect_id: str, law: Law, parameter: EffectParameter,
                 words: Mapping[str, str]) -> None:
        self.law = law
        channels: tuple[str, ...] = (law.target,)
        if law.target == LOAD_TARGET:
            channels = self.channels
        elif law.target.startswith('eddy_current'):
            channels = ('delta_x', 'parity') if law.target[-1] in '13' else ('delta_y', 'gamma')
        vars(self).update(
            words, id=effect_id, parameters=(parameter,), channels=channels,
            stage='load path' if law.target == LOAD_TARGET else 'measurement')

    def extend(self, extension: RingExtension, values: Mapping[str, float]) -> RingExtension:
        """No change: the law is added beside the extension, see `bound`."""
        return extension

    def parameters_on(self, rig: Rig | None) -> tuple[EffectParameter, ...]:
        """The parameters as the user's file states them, for any rig."""
        return self.parameters

    def bound(self, values: Mapping[str, float]) -> Law:
        """The law with its size."""
        return replace(self.law, size=values['size'])


def read_law_effect(path: Path) -> LawEffect:
    """The effect of one file; EffectError in one line for each fault."""
    document = read_strict_yaml(path, EffectError)
    if not isinstance(document, Mapping):
        raise EffectError(f'{path}: is no effect: give id, target, coordinate, size and table')
    for key, allowed in (('target', TARGETS), ('coordinate', COORDINATES)):
        if document.get(key) not in allowed:
            raise EffectError(f'{path}: {key} is {document.get(key)!r}: choose from '
                              f'{", ".join(allowed)}')
    for key in ('table', 'size'):
        if not isinstance(document.get(key), Mapping):
            raise EffectError(f'{path}: {key} is missing: see docs/effects.md for the fields')
    coordinate = document['coordinate']
    at, values = (_numbers(path, f'table.{key}', document['table'].get(key))
                  for key in ('at', 'values'))
    least = MIN_POINTS.get(coordinate, 2)
    if len(at) != len(values) or not least <= len(at) <= MAX_POINTS:
        raise EffectError(f'{path}: table: give {least} to {MAX_POINTS} numbers under at and as '
                          'many under values')
    if any(b <= a for a, b in pairwise(at)):
        raise EffectError(f'{path}: table.at must rise from number to number')
    if least == 1 and at[0] <= 0.0:
        raise EffectError(f'{path}: table.at must be above zero for {coordinate}')
    low, high, scale, start = (_numbers(path, f'size.{key}', [document['size'].get(key)])[0]
                               for key in ('low', 'high', 'scale', 'start'))
    if not low <= start <= high or scale <= 0.0:
        raise EffectError(f'{path}: size: start must lie from low to high, and scale above zero')
    parameter = EffectParameter('size', str(document.get('unit') or '1'), low, high, scale, start,
                                'size of the law', amplitude=True)
    law = Law(document['target'], coordinate, at, values,
              _numbers(path, 'turn', [document.get('turn', 0.0)])[0])
    words = {key: str(document.get(key, '')) for key in ('title', 'words', 'settled_by')}
    words['title'] = words['title'] or path.stem
    return LawEffect(str(document.get('id', path.stem)), law, parameter, words)


def _numbers(path: Path, name: str, values: object) -> tuple[float, ...]:
    if not isinstance(values, list):
        raise EffectError(f'{path}: {name} is missing: give a list of numbers')
    for value in values:
        if not is_number(value) or not np.isfinite(value):
            raise EffectError(f'{path}: {name} holds {value!r}: give finite numbers')
    return tuple(map(float, values))
