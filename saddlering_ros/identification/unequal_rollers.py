"""The effect of the unequal rollers of any sound ring on readings and estimate.

The rig file describes a ring of equal rollers. The rollers of a real ring differ, and their common
effect on the readings of all runs is many times the noise of a mean. The size of the differences
is that of the diagnosis (ring/roller_scatter.py).
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from saddlering_ros.identification.objective import WeightedObjective
from saddlering_ros.identification.observation import Observation
from saddlering_ros.rig import probes_to_displacement, Rig
from saddlering_ros.ring.roller_scatter import scatter_columns, SimulatedCourse

Array = NDArray[np.float64]

BEFORE = 1.0
"""Length [s] of the rest before the first reading that is the zero, if it is not in the record."""


def roller_effects(objective: WeightedObjective, contact: Array) -> Array:
    """Whitened residuals (R, M) by one standard deviation of each roller's scatter at a law (6,).

    All runs share a column, because the same rollers are unequal in each of them.
    """
    return np.concatenate(objective.whiten(_of_each_run(objective, contact)), axis=1).T


def roller_shifts(objective: WeightedObjective, contact: Array, inverse: Array) -> Array:
    """`inverse` (F, R) times the effects: shifts (F, M) of the parameters by each roller."""
    return objective.combined(inverse, _of_each_run(objective, contact))


def _of_each_run(objective: WeightedObjective, contact: Array) -> list[Array]:
    """Increments (M, 3, N) of each run."""
    usual = objective.increments(contact[None, :])
    return [_increments(objective.rig, contact, one, found[0])
            for one, found in zip(objective.observations, usual, strict=True)]


def _increments(rig: Rig, contact: Array, one: Observation, usual: Array) -> Array:
    """Increments (M, 3, N) of one run since its zero, beside the usual ones (3, N)."""
    x, y, gamma = np.concatenate([np.zeros((3, 1)), usual], axis=1)
    height, half = rig.probes.radial_height, 0.5 * rig.probes.axial_span
    probes = np.stack([x + height * gamma, y + half * gamma, -x - height * gamma,
                       y - half * gamma])
    course = SimulatedCourse(
        one.elevation, one.zero_load, np.append(one.zero_load, one.load),
        np.append(one.time[0] - BEFORE, one.time), probes, not one.dynamic)
    columns = scatter_columns(rig, contact, course)
    since_zero = np.ascontiguousarray((columns[:, 1:] - columns[:, :1]).transpose(0, 2, 1))
    moved = probes_to_displacement(rig.probes, since_zero)
    return np.stack([moved.delta_x, moved.delta_y, moved.gamma], axis=1)
