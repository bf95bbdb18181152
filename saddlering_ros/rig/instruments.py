"""Standard uncertainties (k = 1) of instruments and dimensions, as certificates state them."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import asdict, dataclass, fields, replace
import json
from pathlib import Path
from typing import Any

import numpy as np

from saddlering_ros.errors import refuse_unknown_keys
from saddlering_ros.rig.certificate import from_certificate
from saddlering_ros.rig.ros_yaml import RigError

FOUR_PROBES = 'probe_gain'
"""The entry that may be one number or four, one for each probe."""


@dataclass(frozen=True)
class Instruments:
    """Standard uncertainties; None where no certificate states one.

    load_gain, load_nonlinearity (share, of the load and of full scale), load_offset [N]; elevation
    [rad]; probe_gain (share, of each probe), probe_nonlinearity [1/m], probe_lag [s]; clock [s],
    between load and probes; clearance [m] of each row; weight (share); trunnion, axial_span,
    radial_height [m].
    """

    load_gain: float | None = None
    load_offset: float | None = None
    load_nonlinearity: float | None = None
    elevation: float | None = None
    probe_gain: tuple[float, float, float, float] | None = None
    probe_nonlinearity: float | None = None
    probe_lag: float | None = None
    clock: float | None = None
    clearance: float | None = None
    weight: float | None = None
    trunnion: float | None = None
    axial_span: float | None = None
    radial_height: float | None = None

    @property
    def not_stated(self) -> tuple[str, ...]:
        """Names of the entries that no certificate states."""
        return tuple(one.name for one in fields(self) if getattr(self, one.name) is None)


NAMES = tuple(one.name for one in fields(Instruments))

UNITS = {'load_offset': 'N', 'elevation': 'rad', 'probe_nonlinearity': '1/m', 'probe_lag': 's',
         'clock': 's', 'clearance': 'm', 'trunnion': 'm', 'axial_span': 'm', 'radial_height': 'm'}
"""SI units of the entries; the others are shares."""


def instruments_from(values: Any, where: str) -> Instruments:
    """Instruments from the section of a rig file; RigError (one line) for an entry of no use.

    An entry {certificate: FILE.xml, quantity: NAME} is read from a DCC beside the rig file.
    """
    if not isinstance(values, dict):
        raise RigError(f'{where}: rig.instruments is not a section: give it as "instruments:" '
                       'with entries')
    refuse_unknown_keys({key: value for key, value in values.items() if key not in NAMES}, NAMES,
                        'rig.instruments', where, RigError)
    stated: dict[str, Any] = {}
    for name, value in values.items():
        numbers = [
            from_certificate(one, UNITS.get(name, '1'), Path(where).parent,
                             f'{where}: rig.instruments.{name}') if isinstance(one, dict) else one
            for one in (value if isinstance(value, list) else [value])]
        count = 4 if name == FOUR_PROBES and isinstance(value, list) else 1
        usable = len(numbers) == count and all(
            isinstance(one, (int, float)) and not isinstance(one, bool) and 0.0 < one < 1e9
            for one in numbers)
        if not usable:
            also = ' or four of them' if name == FOUR_PROBES else ''
            raise RigError(f'{where}: rig.instruments.{name} is {value!r}: give a standard '
                           f'uncertainty above zero{also} (SI units, k = 1)')
        stated[name] = (tuple(map(float, numbers)) * (4 // count) if name == FOUR_PROBES
                        else float(numbers[0]))
    return Instruments(**stated)


def stated_by(texts: Iterable[str], where: str) -> tuple[Instruments, str]:
    """Instruments that bags state in their `instruments`, and the names of the certificates.

    Where bags differ the larger uncertainty counts.
    """
    stated: dict[str, Any] = {}
    certificates: set[str] = set()
    for text in filter(None, texts):
        try:
            values = json.loads(text)
            certificates.update(values.pop('certificates', []))
        except (ValueError, AttributeError, TypeError) as problem:
            raise RigError(f'{where}: instruments of the metadata is {text[:40]!r}: give it as '
                           'saddlering import writes it') from problem
        for name, value in asdict(instruments_from(values, where)).items():
            if value is not None:
                stated[name] = max(stated.get(name, value), value)
    return Instruments(**stated), ', '.join(sorted(certificates))


def completed(own: Instruments, other: Instruments) -> Instruments:
    """The same with the entries of the other where it has none."""
    return replace(own, **{name: getattr(other, name) for name in own.not_stated})


def difference_of(first: Instruments, second: Instruments) -> Instruments:
    """Standard uncertainty of the difference of two calibrations, where both are stated."""
    both = {name: np.hypot(getattr(first, name), getattr(second, name)).tolist() for name in NAMES
            if None not in (getattr(first, name), getattr(second, name))}
    return Instruments(**both)
