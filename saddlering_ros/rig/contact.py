"""The six contact parameters of an identification."""

from __future__ import annotations

from dataclasses import astuple, dataclass, fields

import numpy as np
from numpy.typing import ArrayLike, NDArray

from saddlering_ros.rig.errors import RigError

EXPONENTS = (0.5, 5.0)
"""Range of n in F = K p^n; far outside it the solver fails at touch-down and hardly ends."""


@dataclass(frozen=True)
class ContactParameters:
    """Force law of the contact units, F = max(0, K p^n + s(p) D dp/dt); 1: axial, 2: radial row.

    K [N/m^n], n [-], D [N s/m]; the names are the published model's.
    """

    K1: float
    n1: float
    D1: float
    K2: float
    n2: float
    D2: float

    def __post_init__(self) -> None:
        for field in fields(self):
            value = getattr(self, field.name)
            if not np.isfinite(value) or value < 0.0 or (value == 0.0 and field.name[0] != 'D'):
                raise RigError(
                    f'contact.{field.name} is {value!r}: give a finite number above zero'
                )
            low, high = EXPONENTS
            if field.name[0] == 'n' and not low <= value <= high:
                raise RigError(f'contact.{field.name} is {value!r}: give {low:g} to {high:g} '
                               '(line contact 1.11, point contact 1.5)')
            object.__setattr__(self, field.name, float(value))

    def to_array(self) -> NDArray[np.float64]:
        """The six numbers in the order of `PARAMETER_NAMES`, shape (6,)."""
        return np.array(astuple(self), dtype=np.float64)

    @classmethod
    def from_array(cls, values: ArrayLike) -> ContactParameters:
        """From six numbers in the order of `PARAMETER_NAMES`."""
        array = np.asarray(values, dtype=np.float64)
        if array.shape != (6,):
            raise RigError(f'contact parameters have shape {array.shape}: six numbers are needed')
        return cls(*(float(value) for value in array))


PARAMETER_NAMES: tuple[str, ...] = ('K1', 'n1', 'D1', 'K2', 'n2', 'D2')
"""Order of the contact parameters in every array and covariance."""

PARAMETER_UNITS: dict[str, str] = {
    'K1': 'N/m^n', 'n1': '1', 'D1': 'N s/m', 'K2': 'N/m^n', 'n2': '1', 'D2': 'N s/m',
}

TRUE_TO_SCALE = ContactParameters(
    K1=6e4 * 1000.0 ** (10.0 / 9.0), n1=10.0 / 9.0, D1=3e6,
    K2=6e4 * 1000.0 ** (10.0 / 9.0), n2=10.0 / 9.0, D2=3e6,
)
"""Values that give displacements of the size measured on a real ring (a project assumption)."""
