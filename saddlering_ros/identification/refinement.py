"""From a good start to the optimum: bounded least squares on the whitened residuals."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from saddlering_ros.errors import Cancelled
from saddlering_ros.estimation.least_squares import (
    minimise,
    NEGLIGIBLE,
    on_bound,
    SearchSpace,
    USUAL_DAMPING,
)
from saddlering_ros.identification.objective import LinearisedFit, WeightedObjective
from saddlering_ros.progress import IsCancelled
from saddlering_ros.rig import ContactParameters

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Refinement:
    """The optimum: coordinates (F,), contact (6,), chi square, Jacobian (R, F), at bound (F,)."""

    point: Array
    contact: Array
    chi_square: float
    jacobian: Array
    at_bound: NDArray[np.bool_]

    @property
    def law(self) -> ContactParameters:
        """The contact parameters by name."""
        return ContactParameters.from_array(self.contact)


@dataclass(frozen=True)
class _At:
    """Residual (R,) at a point (F,) of the search space, and its Jacobian (R, F) on demand."""

    linearised: LinearisedFit
    space: SearchSpace
    contact: Array

    @property
    def residual(self) -> Array:
        return self.linearised.residual

    def slopes(self) -> Array:
        by_contact = self.linearised.slopes()
        return np.asarray(by_contact[self.space.free].T * self.space.scale(self.contact))


def refine(
    objective: WeightedObjective,
    space: SearchSpace,
    start: Array,
    is_cancelled: IsCancelled | None = None,
    negligible: float = NEGLIGIBLE,
    damping: float = USUAL_DAMPING,
) -> Refinement:
    """Least squares from coordinates `start` (F,); Cancelled on request.

    The descent ends if the next step is expected to gain less than `negligible` of chi square.
    damping: that of the first step.
    """

    def at(point: Array) -> _At:
        if is_cancelled is not None and is_cancelled():
            raise Cancelled
        return _at(objective, space, point)

    found = minimise(at, start, space.low, space.high, negligible, damping)
    return Refinement(found.point, space.contacts(found.point)[0], found.chi_square,
                      found.jacobian, found.at_bound)


def stay_at(
    objective: WeightedObjective, space: SearchSpace, contact: ContactParameters
) -> Refinement:
    """A `Refinement` at given contact parameters, without a step."""
    point = space.coordinates(contact.to_array())
    found = _at(objective, space, point)
    return Refinement(point, contact.to_array(), float(found.residual @ found.residual),
                      found.slopes(), on_bound(point, space.low, space.high))


def _at(objective: WeightedObjective, space: SearchSpace, point: Array) -> _At:
    contact = space.contacts(point)[0]
    return _At(objective.linearised(contact), space, contact)
