"""What unequal rollers of a sound ring do to its displacement: no cause, but to be allowed for.

Every roller's gap and stiffness differ a little. To first order a gap change g_i moves the ring by
S^-1 k_i v_i g_i and a stiffness change e_i by -S^-1 F_i v_i e_i, with v_i the roller's
penetration by (delta_x, delta_y, gamma), k_i its tangent stiffness and S the sum of k_i v_i
v_i'. Both are averaged over the scatter itself, since a roller about to touch is neither in
contact nor out of it.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from saddlering_ros.rig import Rig
from saddlering_ros.ring.simulator import static_response

Array = NDArray[np.float64]

GAP_SCATTER = 1.5e-6
"""Spread of single rollers' gaps [m] that counts as a sound ring."""
STIFFNESS_SCATTER = 0.03
"""Spread of single rollers' stiffness, as a share."""
CLEARANCE_UNKNOWN = 1e-6
"""Standard deviation [m] to which a row's mean clearance is known beforehand."""
WEIGHT_UNKNOWN = 0.02
"""Standard deviation to which the carriage's weight is known beforehand, as a share."""
GRID = 70
COLUMNS = 60
_NODES, _WEIGHTS = np.polynomial.hermite_e.hermegauss(7)
_WEIGHTS = _WEIGHTS / _WEIGHTS.sum()


def scatter_columns(rig: Rig, contact: Array, elevation: float, load: Array) -> Array:
    """Probe increments (4, N, k) that one spread of each roller's scatter gives at loads (N,)."""
    low, high = float(load.min()), float(load.max())
    # Finer where contact begins.
    grid = low + (high - low) * np.linspace(0.0, 1.0, GRID) ** 1.5
    motion = static_response(rig, contact, elevation, grid)
    columns = np.array([_columns_at(rig, contact, q) for q in motion.T])
    columns = np.nan_to_num(columns)
    flat = columns.reshape(GRID, -1)
    place = np.clip(np.searchsorted(grid, load) - 1, 0, GRID - 2)
    share = ((load - grid[place]) / (grid[place + 1] - grid[place]))[:, None]
    seen = (1.0 - share) * flat[place] + share * flat[place + 1]
    q = seen.reshape(load.size, 3, -1)
    height, half = rig.probes.radial_height, 0.5 * rig.probes.axial_span
    radial = q[:, 0] + height * q[:, 2]
    return np.stack([radial, q[:, 1] + half * q[:, 2], -radial, q[:, 1] - half * q[:, 2]])


def rig_columns(rig: Rig, contact: Array, elevation: float, load: Array) -> Array:
    """Probe increments (4, N, 3) of one spread of both clearances and of the weight.

    Without them a common gain of the load would be told from the stiffnesses by nothing but
    clearances and a weight that no one knows so well.
    """
    axial, middle, carriage = rig.axial_rows, rig.middle_row, rig.carriage
    varied = [
        replace(rig, axial_rows=replace(axial, clearance=axial.clearance + CLEARANCE_UNKNOWN)),
        replace(rig, middle_row=replace(middle, clearance=middle.clearance + CLEARANCE_UNKNOWN)),
        replace(rig, carriage=replace(carriage, weight=carriage.weight * (1.0 + WEIGHT_UNKNOWN))),
    ]
    grid = np.linspace(float(load.min()), float(load.max()), GRID)
    usual = static_response(rig, contact, elevation, grid)
    height, half = rig.probes.radial_height, 0.5 * rig.probes.axial_span
    columns = []
    for other in varied:
        change = static_response(other, contact, elevation, grid) - usual
        x, y, gamma = (np.interp(load, grid, np.nan_to_num(row)) for row in change)
        radial = x + height * gamma
        columns.append(np.stack([radial, y + half * gamma, -radial, y - half * gamma]))
    return np.stack(columns, axis=-1)


def _columns_at(rig: Rig, contact: Array, q: Array) -> Array:
    """Motion (3, k) for one spread of every gap, every stiffness, and of touching softly, at q."""
    axial, middle = rig.axial_rows, rig.middle_row
    first = np.cos(2.0 * np.pi * np.arange(axial.rollers) / axial.rollers)
    second = np.cos(2.0 * np.pi * np.arange(middle.rollers) / middle.rollers)
    zero, one = np.zeros_like(first), np.ones_like(first)
    upper = np.stack([zero, one, -axial.pitch_radius * first])
    radial = np.stack([second, np.zeros_like(second), middle.height * second])
    directions = np.hstack([upper, -upper, radial])
    counts = (2 * axial.rollers, middle.rollers)
    half_gap = np.repeat([0.5 * axial.clearance, 0.5 * middle.clearance], counts)
    stiffness = np.repeat([contact[0], contact[3]], counts)
    exponent = np.repeat([contact[1], contact[4]], counts)
    depth = q @ directions - half_gap
    spread = depth[:, None] + GAP_SCATTER * _NODES[None, :]
    touching = np.maximum(spread, 0.0)
    forces = stiffness[:, None] * touching ** exponent[:, None]
    tangents = np.where(
        spread > 0.0,
        (exponent * stiffness)[:, None] * np.maximum(touching, 1e-12) ** (exponent[:, None] - 1.0),
        0.0,
    )
    force, tangent = forces @ _WEIGHTS, tangents @ _WEIGHTS
    plain = stiffness * np.maximum(depth, 0.0) ** exponent
    system = (directions * tangent) @ directions.T
    system += 1e-9 * np.trace(system) * np.diag([1.0, 1.0, axial.pitch_radius**2])
    answer = np.linalg.solve(
        system,
        np.hstack(
            [
                directions * (tangent * GAP_SCATTER),
                -directions * (force * STIFFNESS_SCATTER),
                -(directions @ (force - plain))[:, None],
            ]
        ),
    )
    return np.asarray(answer)


def compressed(columns: Array, most: int = COLUMNS) -> Array:
    """Fewer columns (n, <= most) of all but the same covariance as columns (n, k)."""
    values, vectors = np.linalg.eigh(columns.T @ columns)
    order = np.argsort(values)[::-1][:most]
    order = order[values[order] > 1e-12 * values[-1]]
    return np.asarray(columns @ vectors[:, order])
