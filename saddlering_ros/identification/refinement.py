"""From a good start to the bottom: bounded least squares on the whitened residuals."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import least_squares

from saddlering_ros.errors import Cancelled
from saddlering_ros.estimation.space import SearchSpace
from saddlering_ros.identification.objective import WeightedObjective
from saddlering_ros.rig import ContactParameters

Array = NDArray[np.float64]

DIFFERENCE = 5e-4
"""Step of the central differences, in coordinates (relative for logarithmic ones)."""


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


def jacobian(objective: WeightedObjective, space: SearchSpace, point: Array) -> Array:
    """Central differences of the residuals, (R, F); all of them in one batch of the simulator."""
    steps = DIFFERENCE * np.eye(len(point))
    above = np.minimum(point + steps, space.high)
    below = np.maximum(point - steps, space.low)
    residuals = objective.residuals(space.contacts(np.concatenate([above, below])))
    forward, backward = np.split(residuals, 2)
    return np.asarray((forward - backward).T / np.diag(above - below))


def refine(
    objective: WeightedObjective,
    space: SearchSpace,
    start: Array,
    is_cancelled: Callable[[], bool] | None = None,
) -> Refinement:
    """Least squares from coordinates `start` (F,); raises Cancelled when asked to stop."""

    def residuals(point: Array) -> Array:
        if is_cancelled is not None and is_cancelled():
            raise Cancelled
        return np.asarray(objective.residuals(space.contacts(point[None, :]))[0])

    margin = 1e-9 * (space.high - space.low)
    solution = least_squares(
        residuals,
        np.clip(start, space.low + margin, space.high - margin),
        jac=lambda point: jacobian(objective, space, point),
        bounds=(space.low, space.high),
        x_scale='jac', ftol=1e-10, xtol=1e-9, gtol=1e-10, max_nfev=60,
    )
    point = np.asarray(solution.x)
    near = 1e-4 * (space.high - space.low)
    at_bound = (point - space.low < near) | (space.high - point < near)
    return Refinement(
        point=point,
        contact=space.contacts(point)[0],
        chi_square=2.0 * float(solution.cost),
        jacobian=jacobian(objective, space, point),
        at_bound=np.asarray(at_bound),
    )
