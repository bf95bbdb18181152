"""Coordinates in which contact parameters are searched: some logarithmic, some held."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from saddlering_ros.rig import ContactParameters, PARAMETER_NAMES

Array = NDArray[np.float64]


@dataclass(frozen=True)
class SearchSpace:
    """Box of the free parameters; the others stay at `held`.

    free (F,) indices into the six; logarithmic (6,) marks those searched as ln(value);
    low, high (F,) in coordinates; held (6,) values.
    """

    free: NDArray[np.intp]
    logarithmic: NDArray[np.bool_]
    low: Array
    high: Array
    held: Array

    @classmethod
    def of(
        cls,
        bounds: Mapping[str, tuple[float, float]],
        free: Iterable[str],
        held: ContactParameters,
        logarithmic: Iterable[str] = (),
    ) -> SearchSpace:
        """Space of the names in `free`, inside bounds (values); the others are held."""
        logarithmic = set(logarithmic)
        names = [name for name in PARAMETER_NAMES if name in set(free)]
        mask = np.array([name in logarithmic for name in PARAMETER_NAMES])
        indices = np.array([PARAMETER_NAMES.index(name) for name in names], dtype=np.intp)
        box = np.array([bounds[name] for name in names], dtype=float)
        box[mask[indices]] = np.log(np.maximum(box[mask[indices]], 1e-9))
        return cls(indices, mask, box[:, 0], box[:, 1], held.to_array())

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the free parameters in coordinate order."""
        return tuple(PARAMETER_NAMES[index] for index in self.free)

    def contacts(self, points: Array) -> Array:
        """Contact parameters (B, 6) at coordinates (B, F)."""
        points = np.atleast_2d(points)
        contacts = np.tile(self.held, (len(points), 1))
        contacts[:, self.free] = np.where(
            self.logarithmic[self.free], np.exp(np.minimum(points, 700.0)), points
        )
        return contacts

    def coordinates(self, contact: Array) -> Array:
        """Coordinates (F,) of contact parameters (6,), clipped into the box."""
        values = np.asarray(contact, dtype=float)[self.free]
        log = self.logarithmic[self.free]
        values = np.where(log, np.log(np.maximum(values, 1e-9)), values)
        return np.asarray(np.clip(values, self.low, self.high))

    def scale(self, contact: Array) -> Array:
        """Derivative d value / d coordinate (F,) at contact parameters (6,)."""
        values = np.asarray(contact, dtype=float)[self.free]
        return np.where(self.logarithmic[self.free], values, 1.0)
