"""From a good start to the bottom: bounded least squares on the whitened residuals."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from saddlering_ros.errors import Cancelled
from saddlering_ros.estimation.least_squares import minimise, on_bound
from saddlering_ros.estimation.space import SearchSpace
from saddlering_ros.identification.objective import WeightedObjective
from saddlering_ros.progress import IsCancelled
from saddlering_ros.rig import ContactParameters

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Refinement:
    """The bottom: coordinates (F,), contact (6,), chi square, Jacobian (R, F), at bound (F,)."""

    point: Array
    contact: Array
    chi_square: float
    jacobian: Array
    at_bound: NDArray[np.bool_]

    @property
    def law(self) -> ContactParameters:
        """The contact parameters by name."""
        return ContactParameters.from_array(self.contact)


def refine(
    objective: WeightedObjective,
    space: SearchSpace,
    start: Array,
    is_cancelled: IsCancelled | None = None,
) -> Refinement:
    """Least squares from coordinates `start` (F,); raises Cancelled when asked to stop."""

    def residuals(points: Array) -> Array:
        if is_cancelled is not None and is_cancelled():
            raise Cancelled
        return objective.residuals(space.contacts(points))

    found = minimise(residuals, lambda point: _slopes(objective, space, point), start,
                     space.low, space.high)
    return Refinement(found.point, space.contacts(found.point)[0], found.chi_square,
                      found.jacobian, found.at_bound)


def stay_at(
    objective: WeightedObjective, space: SearchSpace, contact: ContactParameters
) -> Refinement:
    """A `Refinement` at given contact parameters, without moving them."""
    law = contact.to_array()
    point = space.coordinates(law)
    return Refinement(point, law, float(objective(law[None, :])[0]),
                      _slopes(objective, space, point), on_bound(point, space.low, space.high))


def _slopes(objective: WeightedObjective, space: SearchSpace, point: Array) -> Array:
    """Jacobian (R, F) of the whitened residuals by the coordinates at a point (F,)."""
    contact = space.contacts(point)[0]
    return np.asarray(objective.slopes(contact)[space.free].T * space.scale(contact))
