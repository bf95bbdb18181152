"""The rig: rollers, carriage, trunnion, probes, preload; its file, and the hash of it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass, field, replace
import hashlib
import json
import math
import os
from pathlib import Path
from typing import Any

from saddlering_ros.errors import did_you_mean, refuse_unknown_keys
from saddlering_ros.plain_yaml import is_number
from saddlering_ros.quantities import compact, quantity
from saddlering_ros.rig import parameter_file, units
from saddlering_ros.rig.instruments import Instruments, instruments_from
from saddlering_ros.rig.parameter_file import (
    check_sections,
    ContactParameters,
    EXPONENTS,
    PARAMETER_UNITS,
    RigError,
)
from saddlering_ros.rig.units import FORCE_UNITS, LoadLimits


@dataclass(frozen=True)
class RollerRow:
    """One row of equal rollers; the two axial rows share one description."""

    rollers: int  # count
    pitch_radius: float  # [m]
    clearance: float  # [m], half of it at each side
    height: float = 0.0  # [m] of the row over the reference point C (radial row only)


@dataclass(frozen=True)
class Carriage:
    """Slewing parts: mass [kg], inertia about C [kg m2], dead weight [N] at x = weight_x [m]."""

    mass: float
    inertia: float
    weight: float
    weight_x: float


@dataclass(frozen=True)
class Trunnion:
    """Where the load acts on the upper ring, relative to C."""

    x: float  # [m] to the rear
    y: float  # [m] upwards


OPPOSITE = {1: 3, 3: 1}
"""Radial probes by the probe that faces them."""


@dataclass(frozen=True)
class Probes:
    """Four eddy-current probes."""

    axial_span: float  # [m] of the axial pair
    radial_height: float  # [m] of the radial pair
    polarity: tuple[float, float, float, float]  # 1 or -1: d = polarity (gap - zero)
    min_range: float  # [m], of the gap
    max_range: float  # [m]
    absent: int = 0  # number of the radial probe that the rig lacks, 1 or 3; 0: none

    @property
    def present(self) -> tuple[int, ...]:
        return tuple(number for number in (1, 2, 3, 4) if number != self.absent)

    @property
    def partner(self) -> int:
        """Number of the radial probe opposite to the absent one; 0 if none is absent."""
        return OPPOSITE.get(self.absent, 0)

    @property
    def partner_row(self) -> int:
        """Row of this probe among those that the rig has."""
        return self.present.index(self.partner)


WEAR_LIMITS = ('tilting_clearance', 'axial_reduction')
"""Figures of makers whose wear since a base measurement a rig file may limit."""

Pair = tuple[float, float]
"""A low and a high bound."""

DEFAULT_BOUNDS: dict[str, Pair] = {
    'K1': (2e7, 1e9), 'n1': (1.0, 1.5), 'D1': (1e4, 2e7),
    'K2': (2e7, 1e9), 'n2': (1.0, 1.5), 'D2': (1e4, 2e7)}
"""Search range of an identification where a rig file gives none."""


@dataclass(frozen=True)
class Rig:
    """The whole rig; every default is a project assumption, not a measured dimension.

    radial_row is called middle_row in files. Preload and full scale are in N. full_scale_time [s]:
    the shortest time in which the hydraulics change the load by full scale. instruments: what
    certificates state; wear_limits: the user's own [m], by the names of WEAR_LIMITS. source: its
    file, '' for none.
    """

    axial_rows: RollerRow
    radial_row: RollerRow
    carriage: Carriage
    trunnion: Trunnion
    probes: Probes
    preload: float
    bounds: dict[str, Pair] = field(default_factory=DEFAULT_BOUNDS.copy)
    full_scale_load: float = units.FULL_SCALE_LOAD
    full_scale_time: float = units.FULL_SCALE_TIME
    force_unit: str = 't'
    instruments: Instruments = field(default_factory=Instruments)
    wear_limits: Mapping[str, float] = field(default_factory=dict)
    source: str = field(default='', compare=False)

    @property
    def limits(self) -> LoadLimits:
        """Limits of loads, from the full scale."""
        return LoadLimits(self.full_scale_load)

    @property
    def full_scale_words(self) -> str:
        """The full scale in three digits: '25 t', '9.81 kN'."""
        return f'{compact(self.full_scale_load / FORCE_UNITS[self.force_unit])} {self.force_unit}'

    def force_words(self, force: float, decimals: int = 1) -> str:
        """A load [N] in the unit that the rig file chooses; a small rig gets more decimals."""
        shown = units.force_decimals(self.full_scale_load, self.force_unit, decimals)
        return units.force_words(force, self.force_unit, shown)

    def force_range(self, low: float, high: float, decimals: int = 1) -> str:
        """Two forces [N] in that unit: '0.5 to 25.0 t'."""
        shown = units.force_decimals(self.full_scale_load, self.force_unit, decimals)
        return (f'{low / FORCE_UNITS[self.force_unit]:.{shown}f} to '
                + units.force_words(high, self.force_unit, shown))

    def changed(self, part: str, entry: str, change: float) -> Rig:
        """The rig with another value of one entry of a part, by `change` [its unit]."""
        old = getattr(self, part)
        return replace(self, **{part: replace(old, **{entry: getattr(old, entry) + change})})

    @property
    def digest(self) -> str:
        """SHA-256 of the canonical description: its SI numbers as JSON, keys sorted.

        Numbers are written with the fewest digits that give the same float, -0 as 0.
        """
        text = json.dumps(_canonical(asdict(self)), sort_keys=True, separators=(',', ':'))
        return hashlib.sha256(text.encode()).hexdigest()


def default_rig() -> Rig:
    """The rig of the published tests at the project's assumed dimensions."""
    return Rig(
        axial_rows=RollerRow(rollers=97, pitch_radius=0.600, clearance=40e-6),
        radial_row=RollerRow(rollers=110, pitch_radius=0.600, clearance=40e-6, height=0.0),
        carriage=Carriage(mass=4079.0, inertia=3000.0, weight=40e3, weight_x=0.0),
        trunnion=Trunnion(x=0.15, y=1.00),
        probes=Probes(axial_span=1.30, radial_height=0.0, polarity=(1.0, 1.0, 1.0, 1.0),
                      min_range=0.0, max_range=2e-3),
        preload=4903.325)


class _Section:
    """A mapping of the file with its dotted name, for messages."""

    def __init__(self, values: Any, name: str, where: str) -> None:
        if not isinstance(values, Mapping):
            raise RigError(f'{where}: {name} is not a section: give it as "{name}:" with entries')
        self._values = dict(values)
        self.name = name
        self.where = where
        self._known: list[str] = []

    def take(self, key: str, default: Any = None, kind: str = 'number') -> Any:
        """An entry, or its default; RigError for one that is missing and has none."""
        self._known.append(key)
        if key in self._values or default is not None:
            return self._values.pop(key, default)
        for given in self._values:
            if did_you_mean(str(given), [key]):
                raise RigError(f'{self.where}: {self.name} has unknown entries ({given}): '
                               f'did you mean {key}?')
        raise RigError(f'{self.where}: {self.name}.{key} is missing: add this {kind}')

    def __contains__(self, key: str) -> bool:
        self._known.append(key)
        return key in self._values

    def section(self, key: str, default: Mapping[str, Any] | None = None) -> _Section:
        return _Section(self.take(key, default, 'section'), f'{self.name}.{key}', self.where)

    def number(self, key: str, low: float, high: float, default: float | None = None) -> float:
        value = self.take(key, default)
        if not is_number(value):
            raise RigError(f'{self.where}: {self.name}.{key} is {value!r}: give a number')
        if not math.isfinite(value) or not low <= value <= high:
            raise RigError(f'{self.where}: {self.name}.{key} is {value}: '
                           f'give a number from {low:g} to {high:g} (SI units)')
        return float(value)

    def finish(self) -> None:
        refuse_unknown_keys(self._values, self._known, self.name, self.where, RigError)


def _row(section: _Section, **height: float) -> RollerRow:
    rollers = section.number('rollers', 3, 10_000)
    if rollers != int(rollers):
        raise RigError(f'{section.where}: {section.name}.rollers is {rollers}: '
                       'give a whole number')
    return RollerRow(int(rollers), section.number('pitch_radius', 1e-3, 50.0),
                     section.number('clearance', -1e-3, 1e-2), **height)


def _probes(section: _Section) -> Probes:
    signs = section.take('polarity', [1, 1, 1, 1])
    is_list = isinstance(signs, list) and len(signs) == 4
    if not is_list or any(isinstance(sign, bool) or sign not in (-1, 1) for sign in signs):
        raise RigError(f'{section.where}: rig.probes.polarity is {signs!r}: '
                       'give four numbers, each 1 or -1')
    first, second, third, fourth = (float(sign) for sign in signs)
    absent = section.take('absent', 0)
    if isinstance(absent, bool) or absent not in (0, 1, 2, 3, 4):
        raise RigError(f'{section.where}: rig.probes.absent is {absent!r}: give 1 or 3, the '
                       'number of the radial probe that is missing, or 0')
    if absent and absent not in OPPOSITE:
        raise RigError(f'{section.where}: rig.probes.absent is {absent}: delta_y and gamma need '
                       'both axial probes, and only a radial probe (1 or 3) can be absent: '
                       'repair or move the axial probe')
    probes = Probes(
        section.number('axial_span', 1e-2, 100.0), section.number('radial_height', -5.0, 5.0),
        (first, second, third, fourth), section.number('min_range', 0.0, 1.0),
        section.number('max_range', 0.0, 1.0), int(absent))
    if probes.max_range <= probes.min_range:
        raise RigError(f'{section.where}: rig.probes.max_range is not above min_range: '
                       'give the span in metres')
    return probes


def check_bounds(bounds: Mapping[str, Pair], where: str) -> dict[str, Pair]:
    """The same bounds if they can be used; RigError names the first that cannot."""
    for name, (low, high) in bounds.items():
        smallest = 0.0 if name.startswith('D') else 1e-9
        if not (math.isfinite(low) and math.isfinite(high) and smallest <= low < high):
            raise RigError(f'{where}: bounds.{name} is [{low:g}, {high:g}]: '
                           'give [low, high] with 0 < low < high')
        if name.startswith('n') and not EXPONENTS[0] <= low < high <= EXPONENTS[1]:
            raise RigError(f'{where}: bounds.{name} is [{low:g}, {high:g}]: '
                           f'give [low, high] from {EXPONENTS[0]:g} to {EXPONENTS[1]:g}')
    return dict(bounds)


def beyond_bounds(contact: ContactParameters, bounds: Mapping[str, Pair]) -> str:
    """A note on contact parameters outside of the bounds of a rig file, and their likely unit."""
    words = []
    for name, value in vars(contact).items():
        low, high = bounds[name]
        if 0.99 * low <= value <= 1.01 * high:  # identification may end at a bound
            continue
        per_mm = {'K': 1e3**contact.n1 if name == 'K1' else 1e3**contact.n2, 'D': 1e3}
        in_metres = value * per_mm.get(name[0], 0.0)
        unit = PARAMETER_UNITS[name]
        looks = (f', and looks like {unit.replace("/m", "/mm")}' if low <= in_metres <= high
                 else '')
        words.append(f'contact.{name} is {quantity(value, unit)}{looks}')
    return '' if not words else (
        f'{"; ".join(words)}: outside of the bounds of the rig file, which are in SI units: '
        'correct the parameters, or bounds of the rig file')


def rig_from_parameters(parameters: Mapping[str, Any], where: str) -> Rig:
    """A Rig from the nested parameters of a rig file; `where` names the file in messages."""
    check_sections(parameters, 'rig', 'see config/rig.yaml for the shape', where)
    rig = _Section(parameters['rig'], 'rig', where)
    ranges = _Section(parameters.get('bounds', {}), 'bounds', where)
    parts = [rig.section(name) for name in ('carriage', 'trunnion', 'probes', 'axial_rows',
                                            'middle_row')]
    carriage, trunnion, probes, axial, middle = parts
    wear = rig.section('wear_limits', {})
    unit = rig.take('force_unit', 't')
    if not isinstance(unit, str) or unit not in FORCE_UNITS:
        raise RigError(f'{where}: rig.force_unit is {unit!r}: give {" or ".join(FORCE_UNITS)}')
    bounds = {}
    for name, usual in DEFAULT_BOUNDS.items():
        pair = ranges.take(name, list(usual))
        if not (isinstance(pair, list) and len(pair) == 2 and all(map(is_number, pair))):
            raise RigError(f'{where}: bounds.{name} is {pair!r}: give [low, high]')
        bounds[name] = (float(pair[0]), float(pair[1]))
    result = Rig(
        axial_rows=_row(axial),
        radial_row=_row(middle, height=middle.number('height', -5.0, 5.0, default=0.0)),
        carriage=Carriage(
            carriage.number('mass', 1e-3, 1e9), carriage.number('inertia', 1e-3, 1e9),
            carriage.number('weight', 0.0, 1e9), carriage.number('weight_x', -50.0, 50.0)),
        trunnion=Trunnion(trunnion.number('x', -50.0, 50.0), trunnion.number('y', -50.0, 50.0)),
        probes=_probes(probes), preload=rig.number('preload', 0.0, 1e9),
        full_scale_load=rig.number('full_scale_load', 1.0, 1e9, default=units.FULL_SCALE_LOAD),
        full_scale_time=rig.number('full_scale_time', 1e-4, 1e4, default=units.FULL_SCALE_TIME),
        force_unit=unit, instruments=instruments_from(rig.take('instruments', {}), where),
        wear_limits={name: wear.number(name, 1e-9, 1.0) for name in WEAR_LIMITS if name in wear},
        bounds=check_bounds(bounds, where))
    if result.preload >= result.full_scale_load:
        raise RigError(f'{where}: rig.preload is {result.preload:g} N, not below '
                       f'rig.full_scale_load, {result.full_scale_load:g} N: correct one of them')
    for section in (*parts, ranges, wear, rig):
        section.finish()
    return result


RIG_VARIABLE = 'SADDLERING_RIG'
"""Environment variable that names the rig file of a project, for all that is given none."""


def rig_file_of_project() -> Path | None:
    """The rig file that the environment names; None: the shipped rig counts."""
    return Path(os.environ[RIG_VARIABLE]) if os.environ.get(RIG_VARIABLE) else None


def load_rig(path: Path | str | None = None) -> Rig:
    """The rig of a ROS 2 parameter file; None: of the project's, or the shipped config/rig.yaml.

    Raises RigError with one line when the file is missing, malformed, or out of range.
    """
    path = rig_file_of_project() if path is None else path
    if path is None:
        return default_rig()
    if not isinstance(path, (str, Path)):
        raise RigError(f'rig file is of type {type(path).__name__}: give a path')
    rig = rig_from_parameters(parameter_file.read_ros_parameters(Path(path)), str(path))
    return replace(rig, source=str(path))


NOT_OF_THE_RIG = ('bounds', 'force_unit', 'full_scale_time', 'absent', 'instruments',
                  'wear_limits', 'source')
"""Fields of a Rig for identification, guarding and display, and the number of a probe that is
absent. They are not part of the hash: the ring is the same."""

FIELDS = {'middle_row': 'radial_row'}
"""Fields of a Rig by the names of rig files where these differ; the hash is that of the files'."""


def place_of(entry: str) -> list[str]:
    """Field of a `Rig`, and of its part, that hold an entry of a file: 'middle_row.height'."""
    return [FIELDS.get(name, name) for name in entry.split('.')]


def short_digest(digest: str) -> str:
    """The first digits, for people: enough to distinguish the rigs of one firm."""
    return digest[:12]


def _canonical(value: object) -> object:
    if isinstance(value, dict):
        names = {field: name for name, field in FIELDS.items()}
        return {names.get(key, key): _canonical(entry) for key, entry in value.items()
                if key not in NOT_OF_THE_RIG}
    if isinstance(value, (list, tuple)):
        return [_canonical(entry) for entry in value]
    if is_number(value):
        return float(value) + 0.0
    return value
