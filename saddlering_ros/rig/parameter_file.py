"""The contact law, and ROS 2 parameter files: written by identification, read by all others.

Their shape, `/**: ros__parameters:`, becomes a nested dictionary; RigError says why not.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import astuple, dataclass, field
import math
from pathlib import Path
import re
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray
import yaml

from saddlering_ros.errors import did_you_mean, plain_number, refuse_unknown_keys, SaddleringError
from saddlering_ros.files import Origin, write_text
from saddlering_ros.plain_yaml import is_number, read_strict_yaml
from saddlering_ros.rig.units import stiffnesses_per_millimetre

SECTIONS = ('rig', 'bounds', 'contact', 'effects', 'source')
"""What a rig file or a parameter file may hold; one file may be both."""

OF_EVERY_NODE = ('use_sim_time',)
"""Parameters of ROS itself that the same file may hold."""


class RigError(SaddleringError):
    """A rig or parameter file that cannot be used; one line: fault, place, remedy."""


def read_ros_parameters(path: Path) -> dict[str, Any]:
    """Nested parameters of a file's node entry; RigError (one line) for another shape."""
    document = read_strict_yaml(path, RigError)
    if not isinstance(document, Mapping):
        raise RigError(f'{path}: is not a ROS 2 parameter file: '
                       'start it with "/**: ros__parameters:"')
    entries = {key: node for key, node in document.items()
               if isinstance(node, Mapping) and isinstance(node.get('ros__parameters'), Mapping)}
    if not entries:
        raise RigError(f'{path}: has no ros__parameters: start it with "/**: ros__parameters:"')
    others = [str(key) for key in document if key not in entries]
    if others:
        raise RigError(f'{path}: {others[0]} stands outside of ros__parameters: '
                       'move it below "/**: ros__parameters:"')
    if len(entries) > 1:
        raise RigError(f'{path}: has parameters for several nodes ('
                       f'{", ".join(map(str, entries))}): put them into one entry "/**"')
    (node,) = entries.values()
    beside = [str(key) for key in node if key != 'ros__parameters']
    if beside:
        raise RigError(f'{path}: {beside[0]} is beside ros__parameters: move it below')
    return unfold(node['ros__parameters'], str(path), RigError)


def check_sections(parameters: Mapping[str, Any], needed: str, hint: str, where: str) -> None:
    """RigError if the section `needed` is missing, or if a section is not in SECTIONS."""
    allowed = (*SECTIONS, *OF_EVERY_NODE)
    unknown = [key for key in parameters if key not in allowed]
    if needed not in parameters and not any(did_you_mean(key, allowed) for key in unknown):
        raise RigError(f'{where}: there is no {needed} section: {hint}')
    refuse_unknown_keys(parameters, allowed, '', where, RigError)


def unfold(parameters: Mapping[str, Any], where: str,
           error: type[SaddleringError]) -> dict[str, Any]:
    """Dotted keys (`rig.preload`) made nested dictionaries; numbers written 1e8 made floats.

    `error` if two entries contradict each other: a value and a section of one name, or one name in
    both notations.
    """
    result: dict[str, Any] = {}

    def put(place: dict[str, Any], entries: Mapping[str, Any], above: str) -> None:
        for key, value in entries.items():
            name, dot, below = str(key).partition('.')
            full = above + name
            if dot or isinstance(value, Mapping):
                inner = place.setdefault(name, {})
                if not isinstance(inner, dict):
                    raise error(f'{where}: {full} is given as a value and as a section: remove '
                                'one')
                put(inner, {below: value} if dot else value, f'{full}.')
                continue
            if name in place:
                kind = 'as a value and as a section' if isinstance(place[name], dict) else 'twice'
                raise error(f'{where}: {full} is given {kind}: remove one')
            is_text = above == 'source.' and name not in ('covariance', 'objective')
            place[name] = value if is_text else _as_ros_reads(value)  # a bag may be named 1e5

    put(result, parameters, '')
    return result


def _as_ros_reads(value: Any) -> Any:
    """YAML 1.1 reads `1e8` as text; ROS and this reader read it as a number."""
    if isinstance(value, list):
        return [_as_ros_reads(entry) for entry in value]
    try:
        return plain_number(value) if isinstance(value, str) else value
    except ValueError:
        return value


def plain_exponents(line: str) -> str:
    """Exponents as ROS and YAML 1.1 read them: 4e-05 as 4.0e-05, 1.5e16 as 1.5e+16."""
    line = re.sub(r'(?<![\d.])(\d+)e([+-]?\d+)', r'\1.0e\2', line)
    return re.sub(r'(\d\.\d+)e(\d)', r'\1e+\2', line)


EXPONENTS = (0.5, 5.0)
"""Range of n in F = K p^n; far outside it the solver fails at touch-down and hardly ends."""


@dataclass(frozen=True)
class ContactParameters:
    """Force law of the contact units, F = max(0, K p^n + s(p) D dp/dt); 1: axial, 2: radial row.

    The names are the published model's; docs/ring.md has the law.
    """

    K1: float  # [N/m^n1]
    n1: float
    D1: float  # [N s/m]
    K2: float  # [N/m^n2]
    n2: float
    D2: float  # [N s/m]

    def __post_init__(self) -> None:
        for name in PARAMETER_NAMES:
            value = getattr(self, name)
            if not np.isfinite(value) or value < 0.0 or (value == 0.0 and name[0] != 'D'):
                raise RigError(f'contact.{name} is {value!r}: give a finite number above zero')
            low, high = EXPONENTS
            if name[0] == 'n' and not low <= value <= high:
                raise RigError(f'contact.{name} is {value!r}: give {low:g} to {high:g} '
                               '(line contact 1.11, point contact 1.5)')
            object.__setattr__(self, name, float(value))

    def to_array(self) -> NDArray[np.float64]:
        """The six numbers in the order of `PARAMETER_NAMES`, shape (6,)."""
        return np.array(astuple(self), dtype=np.float64)

    @classmethod
    def from_array(cls, values: ArrayLike) -> ContactParameters:
        """From six numbers in the order of `PARAMETER_NAMES`, shape (6,)."""
        array = np.asarray(values, dtype=np.float64)
        if array.shape != (6,):
            raise RigError(f'contact parameters have shape {array.shape}: six numbers are needed')
        return cls(*(float(value) for value in array))


PARAMETER_NAMES: tuple[str, ...] = ('K1', 'n1', 'D1', 'K2', 'n2', 'D2')
"""Order of the contact parameters in every array and covariance."""

PARAMETER_UNITS: dict[str, str] = {
    'K1': 'N/m^n', 'n1': '1', 'D1': 'N s/m', 'K2': 'N/m^n', 'n2': '1', 'D2': 'N s/m'}

TRUE_TO_SCALE = ContactParameters(
    K1=6e4 * 1000.0 ** (10.0 / 9.0), n1=10.0 / 9.0, D1=3e6, K2=6e4 * 1000.0 ** (10.0 / 9.0),
    n2=10.0 / 9.0, D2=3e6)
"""Values that give displacements of the size measured on a real ring (a project assumption)."""

SOURCE_KEYS = ('method', 'bags', 'objective', 'covariance', 'note', 'sha256', 'versions',
               'undetermined', 'rig_hash', 'K1_in_N_per_mm_n', 'K2_in_N_per_mm_n')
"""Entries of the section `source`."""

Effects = dict[str, dict[str, float]]
"""Extensions of the model: effect id of the catalogue to its parameter values (SI units)."""


@dataclass(frozen=True)
class ParameterSource:
    """Where parameters came from."""

    method: str = 'given'
    bags: tuple[str, ...] = ()  # their paths
    objective: float | None = None  # reached
    covariance: NDArray[np.float64] | None = None  # (6, 6)
    note: str = ''
    sha256: tuple[str, ...] = ()  # of each bag, '' where not known, or () (see files.py)
    versions: str = ''  # of the programs that computed them, in words
    undetermined: Mapping[str, str] = field(default_factory=dict)  # reason by parameter
    rig_hash: str = ''  # digest of their rig, '' where not known

    @property
    def origins(self) -> tuple[Origin, ...]:
        hashes = self.sha256 if len(self.sha256) == len(self.bags) else ('',) * len(self.bags)
        return tuple(map(Origin, self.bags, hashes))


@dataclass(frozen=True)
class ParameterSet:
    """Everything the simulator needs beside the rig: contact law, extensions, and their source."""

    contact: ContactParameters
    effects: Effects = field(default_factory=dict)
    source: ParameterSource = field(default_factory=ParameterSource)


def read_parameters(path: Path | str) -> ParameterSet:
    """Read a parameter file; RigError (one line) when something in it cannot be used."""
    if not isinstance(path, (str, Path)):
        raise RigError(f'parameter file is of type {type(path).__name__}: give a path')
    return parameters_from_mapping(read_ros_parameters(Path(path)), str(path))


def parameters_from_mapping(parameters: Mapping[str, Any], where: str) -> ParameterSet:
    """A ParameterSet from nested parameters; `where` names the file in messages."""
    check_sections(parameters, 'contact', 'give contact.{K1,n1,D1,K2,n2,D2}', where)
    contact = parameters['contact']
    if not isinstance(contact, Mapping):
        raise RigError(f'{where}: contact is not a section: give contact.{{K1,n1,D1,K2,n2,D2}}')
    refuse_unknown_keys(contact, PARAMETER_NAMES, 'contact', where, RigError)
    missing = [name for name in PARAMETER_NAMES if name not in contact]
    if missing:
        raise RigError(f'{where}: contact.{missing[0]} is missing: give all of K1,n1,D1,K2,n2,D2')
    numbers = [_number(contact[name], f'contact.{name}', where) for name in PARAMETER_NAMES]
    try:
        law = ContactParameters(*numbers)
    except RigError as problem:
        raise RigError(f'{where}: {problem}') from problem
    effects: Effects = {}
    section = parameters.get('effects') or {}
    if not isinstance(section, Mapping):
        raise RigError(f'{where}: effects is not a section: give effects.<id>.<parameter>')
    for effect, values in section.items():
        if not isinstance(values, Mapping):
            raise RigError(f'{where}: effects.{effect} is not a section: give its parameters')
        effects[str(effect)] = {str(name): _number(value, f'effects.{effect}.{name}', where)
                                for name, value in values.items()}
    return ParameterSet(law, effects, _source(parameters.get('source', {}), where))


def _number(value: object, name: str, where: str) -> float:
    if not is_number(value) or not math.isfinite(value):
        raise RigError(f'{where}: {name} is {value!r}: give a finite number')
    return float(value)


def _source(section: Any, where: str) -> ParameterSource:
    if isinstance(section, str) or section is None:
        return ParameterSource(note=section or '')
    if not isinstance(section, Mapping):
        raise RigError(f'{where}: source is {section!r}: give a section or a text')
    refuse_unknown_keys(section, SOURCE_KEYS, 'source', where, RigError)
    covariance = section.get('covariance') or None
    if covariance is not None:
        if not isinstance(covariance, list) or len(covariance) != 36:
            raise RigError(f'{where}: source.covariance has no 36 numbers: '
                           'give it row by row or leave it out')
        numbers = [_number(value, 'source.covariance', where) for value in covariance]
        covariance = np.array(numbers, dtype=np.float64).reshape(6, 6)
    objective = section.get('objective')
    # Reasons by name from a list of texts 'K1: why'.
    reasons = {}
    for text in _texts(section, 'undetermined', where):
        name, colon, reason = text.partition(': ')
        if name not in PARAMETER_NAMES or not colon:
            raise RigError(f"{where}: source.undetermined holds {text!r}: give 'K1: why'")
        reasons[name] = reason
    return ParameterSource(
        method=str(section.get('method', 'given')), bags=_texts(section, 'bags', where),
        objective=None if objective is None else _number(objective, 'source.objective', where),
        covariance=covariance, note=str(section.get('note', '')),
        sha256=_texts(section, 'sha256', where), versions=str(section.get('versions', '')),
        undetermined=reasons, rig_hash=str(section.get('rig_hash', '')))


def _texts(section: Mapping[str, Any], key: str, where: str) -> tuple[str, ...]:
    """A list of texts that may be left out; ROS writes an empty list as ['']."""
    values = section.get(key)
    if values is None:
        return ()
    if not isinstance(values, list):
        raise RigError(f'{where}: source.{key} is {values!r}: give a list of texts, [..]')
    return tuple(str(value) for value in values if key != 'bags' or value != '')


def parameters_to_mapping(parameters: ParameterSet) -> dict[str, Any]:
    """The nested dictionary that a parameter file holds below `ros__parameters`."""
    contact, source = parameters.contact, parameters.source
    covariance = np.empty(0) if source.covariance is None else source.covariance
    stated = {
        'bags': list(source.bags), 'sha256': list(source.sha256) if any(source.sha256) else [],
        'versions': source.versions,
        'objective': None if source.objective is None else float(source.objective),
        'covariance': covariance.ravel().tolist() if np.isfinite(covariance).all() else [],
        'rig_hash': source.rig_hash,
        'undetermined': [f'{name}: {reason}' for name, reason in source.undetermined.items()]}
    result: dict[str, Any] = {
        'contact': {name: float(getattr(contact, name)) for name in PARAMETER_NAMES},
        'source': {
            'method': source.method,
            **{name: value for name, value in stated.items() if value not in (None, '', [])},
            'note': source.note,
            **{f'{name}_in_N_per_mm_n': stiffness for name, stiffness in
               stiffnesses_per_millimetre(vars(contact)).items()}}}
    if parameters.effects:
        result['effects'] = {effect: {name: float(value) for name, value in values.items()}
                             for effect, values in parameters.effects.items()}
    return result


class _Dumper(yaml.SafeDumper):
    """Writes floats so that ROS's parameter parser and YAML 1.1 both read them as floats."""


_Dumper.add_representer(float, lambda dumper, value: dumper.represent_scalar(
    'tag:yaml.org,2002:float', plain_exponents(repr(value))))


def write_parameters(path: Path | str, parameters: ParameterSet) -> None:
    """Write a parameter file, whole or not at all (temporary file, then rename)."""
    document = {'/**': {'ros__parameters': parameters_to_mapping(parameters)}}
    text = yaml.dump(document, Dumper=_Dumper, sort_keys=False, default_flow_style=None, width=99)
    write_text(path, text, RigError)
