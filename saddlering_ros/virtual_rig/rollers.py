"""The table of all rollers, each with its own diameter and stiffness."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from saddlering_ros.rig import ContactParameters, Rig, RollerRow
from saddlering_ros.virtual_rig import integrator as at

Floats = NDArray[np.float64]


@dataclass(frozen=True)
class Scatter:
    """How rollers differ: rms of their gaps [m] and of their stiffness (share)."""

    gap: float = 0.7e-6
    stiffness: float = 0.02


@dataclass
class Rollers:
    """Rollers of all three rows: table (N, ROLLER_COLUMNS), columns as in integrator.py.

    spans: rows of the table that belong to 'upper', 'lower' and 'middle'; random: for effects that
    deal rollers out, the same for all runs of one rig.
    """

    table: Floats
    spans: dict[str, slice]
    random: np.random.Generator

    def of(self, row: str) -> Floats:
        """The part of the table that holds this row (a view)."""
        return self.table[self.spans[row]]

    def angles(self, row: str) -> Floats:
        """Angle phi of this row's rollers [rad], 0 at the rear."""
        count = len(self.of(row))
        return 2.0 * np.pi * np.arange(count) / count


def make_rollers(rig: Rig, contact: ContactParameters, scatter: Scatter, seed: int) -> Rollers:
    """The rollers of one rig; the same `seed` is the same rig."""
    random = np.random.default_rng([seed, 304])
    axial = (contact.K1, contact.n1, contact.D1)
    radial = (contact.K2, contact.n2, contact.D2)
    parts = {
        'upper': _row(rig.axial_rows, axial, 1.0), 'lower': _row(rig.axial_rows, axial, -1.0),
        'middle': _row(rig.radial_row, radial, 0.0),
    }
    spans, start = {}, 0
    for name, part in parts.items():
        spans[name] = slice(start, start + len(part))
        start += len(part)
        part[:, at.GAP] += scatter.gap * random.normal(size=len(part))
        part[:, at.STIFFNESS] *= np.maximum(
            1.0 + scatter.stiffness * random.normal(size=len(part)), 0.1)
    return Rollers(np.concatenate(list(parts.values())), spans, random)


def _row(row: RollerRow, law: tuple[float, float, float], side: float) -> Floats:
    """One row: side +1 upper, -1 lower, 0 middle; penetration = b . (x, y, tilt) - gap."""
    table = np.zeros((row.rollers, at.ROLLER_COLUMNS))
    cosine = np.cos(2.0 * np.pi * np.arange(row.rollers) / row.rollers)
    if side == 0.0:
        table[:, at.BY_X], table[:, at.BY_TILT] = cosine, row.height * cosine
    else:
        table[:, at.BY_Y], table[:, at.BY_TILT] = side, -side * row.pitch_radius * cosine
    table[:, at.GAP] = 0.5 * row.clearance
    table[:, at.STIFFNESS], table[:, at.EXPONENT], table[:, at.DAMPING] = law
    return table
