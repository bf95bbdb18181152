"""Standard uncertainties (k = 1) of instruments and dimensions, as certificates state them."""

from __future__ import annotations

from dataclasses import dataclass, fields
from typing import Any

from saddlering_ros.errors import refuse_unknown_keys
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


def instruments_from(values: Any, where: str) -> Instruments:
    """Instruments from the section of a rig file; RigError (one line) for an entry of no use."""
    if not isinstance(values, dict):
        raise RigError(f'{where}: rig.instruments is not a section: give it as "instruments:" '
                       'with entries')
    refuse_unknown_keys({key: value for key, value in values.items() if key not in NAMES}, NAMES,
                        'rig.instruments', where, RigError)
    stated: dict[str, Any] = {}
    for name, value in values.items():
        numbers = value if isinstance(value, list) else [value]
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
