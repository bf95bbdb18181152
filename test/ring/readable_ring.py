"""The readable ring model: plain sums over 304 rollers, equilibrium, dynamics, Jacobian.

This file serves the reader, not speed. The compiled kernels are tested against
this file, and this file against closed forms, scipy's Radau and a multibody program. Source of the
equations: docs/ring.md, after Lin, Qian, Yin, Chen, Liu, "Dynamic modeling and parameter
identification of a gun saddle ring", Defence Technology, 2020 (our own formulation of it).
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.optimize import root

from saddlering_ros.rig import ContactParameters, Rig, RollerRow
from saddlering_ros.rig.geometry import resolve_load
from saddlering_ros.ring.simulator import SimulationError

Floats = NDArray[np.float64]

TOUCH_DOWN = 1e-6
"""Penetration [m] over which the damper is faded in."""


def unit_force(penetration: Floats, rate: Floats, stiffness: float, exponent: float,
               damping: float) -> Floats:
    """Force of contact units [N]: F = max(0, K p^n + s(p) D dp/dt), zero while p <= 0.

    penetration [m] and rate [m/s] of equal shape; K [N/m^n], D [N s/m].
    """
    p = np.maximum(penetration, 0.0)
    u = np.minimum(p / TOUCH_DOWN, 1.0)
    fade = u * u * (3.0 - 2.0 * u)
    return np.asarray(np.maximum(stiffness * p**exponent + fade * damping * rate, 0.0))


def unit_tangent(penetration: Floats, rate: Floats, stiffness: float, exponent: float,
                 damping: float) -> tuple[Floats, Floats]:
    """Derivatives of `unit_force` by penetration [N/m] and by rate [N s/m]."""
    p = np.maximum(penetration, 0.0)
    u = np.minimum(p / TOUCH_DOWN, 1.0)
    fade = u * u * (3.0 - 2.0 * u)
    fade_slope = 6.0 * u * (1.0 - u) / TOUCH_DOWN
    carries = unit_force(penetration, rate, stiffness, exponent, damping) > 0.0
    with np.errstate(divide='ignore'):
        elastic = np.where(p > 0.0, stiffness * exponent * p ** (exponent - 1.0), 0.0)
    by_penetration = elastic + fade_slope * damping * rate
    return np.where(carries, by_penetration, 0.0), np.where(carries, fade * damping, 0.0)


@dataclass(frozen=True)
class ContactRow:
    """One row: p = direction . q - gap; direction (N, 3), q = (delta_x, delta_y, gamma)."""

    direction: Floats
    gap: float
    stiffness: float
    exponent: float
    damping: float


def _angles(row: RollerRow) -> Floats:
    return 2.0 * np.pi * np.arange(row.rollers) / row.rollers


def contact_rows(rig: Rig,
                 contact: ContactParameters) -> tuple[ContactRow, ContactRow, ContactRow]:
    """Upper, lower and radial row. A unit pushes the upper ring along minus its direction."""
    cosine = np.cos(_angles(rig.axial_rows))
    zero, one = np.zeros_like(cosine), np.ones_like(cosine)
    upward = np.stack([zero, one, -rig.axial_rows.pitch_radius * cosine], axis=1)
    outward_cosine = np.cos(_angles(rig.radial_row))
    outward = np.stack([outward_cosine, np.zeros_like(outward_cosine),
                        rig.radial_row.height * outward_cosine], axis=1)
    axial = (0.5 * rig.axial_rows.clearance, contact.K1, contact.n1, contact.D1)
    radial = (0.5 * rig.radial_row.clearance, contact.K2, contact.n2, contact.D2)
    return ContactRow(upward, *axial), ContactRow(-upward, *axial), ContactRow(outward, *radial)


def contact_force(rows: tuple[ContactRow, ...], q: Floats, rate: Floats) -> Floats:
    """Force and moment of all rollers on the upper ring, shape (3,)."""
    total = np.zeros(3)
    for row in rows:
        force = unit_force(row.direction @ q - row.gap, row.direction @ rate, row.stiffness,
                           row.exponent, row.damping)
        total -= row.direction.T @ force
    return total


def contact_jacobian(rows: tuple[ContactRow, ...], q: Floats,
                     rate: Floats) -> tuple[Floats, Floats]:
    """Exact derivatives of `contact_force` by q and by its rate, each (3, 3)."""
    by_q, by_rate = np.zeros((3, 3)), np.zeros((3, 3))
    for row in rows:
        k, d = unit_tangent(row.direction @ q - row.gap, row.direction @ rate, row.stiffness,
                            row.exponent, row.damping)
        by_q -= row.direction.T @ (k[:, None] * row.direction)
        by_rate -= row.direction.T @ (d[:, None] * row.direction)
    return by_q, by_rate


def roller_loads(rig: Rig, contact: ContactParameters, q: Floats) -> tuple[Floats, Floats, Floats]:
    """Static load of every roller [N] in upper, lower and radial row at q (3,)."""
    still = np.zeros(3)
    upper, lower, middle = (
        unit_force(row.direction @ q - row.gap, row.direction @ still, row.stiffness, row.exponent,
                   row.damping) for row in contact_rows(rig, contact))
    return upper, lower, middle


def external_force(rig: Rig, load: float, elevation: float) -> Floats:
    """Force and moment at C with dead weight, (3,): F_x, F_y - W, M + W x_w."""
    resolved = resolve_load(rig, load, elevation)
    weight = rig.carriage.weight
    return np.array([resolved.force_x, resolved.force_y - weight,
                     resolved.moment + weight * rig.carriage.weight_x], dtype=np.float64)


def static_equilibrium(rig: Rig, contact: ContactParameters, load: float, elevation: float,
                       start: ArrayLike | None = None) -> Floats:
    """Q (3,) at which contact and external forces balance; SimulationError if none is found."""
    rows = contact_rows(rig, contact)
    external = external_force(rig, load, elevation)
    still = np.zeros(3)
    guess = np.asarray(start, dtype=np.float64) if start is not None else np.array([
        np.copysign(0.5 * rig.radial_row.clearance + 2e-5, external[0]),
        np.copysign(0.5 * rig.axial_rows.clearance + 2e-5, external[1]), 0.0])
    scale = np.array([1e-4, 1e-4, 1e-4])
    found = root(lambda u: (external + contact_force(rows, u * scale, still)) / 1e3, guess / scale,
                 jac=lambda u: contact_jacobian(rows, u * scale, still)[0] * scale / 1e3,
                 method='hybr', options={'xtol': 1e-14})
    left = np.max(np.abs(external + contact_force(rows, found.x * scale, still)))
    if left > 1e-6 * (np.max(np.abs(external)) + 1.0):
        raise SimulationError(f'no equilibrium at load {load:g} N: '
                              'check load, rig and contact law')
    return np.asarray(found.x * scale, dtype=np.float64)


def simulate_dynamic(rig: Rig, contact: ContactParameters, elevation: float, time: ArrayLike,
                     load: ArrayLike) -> Floats:
    """Q (3, N) at the samples of time (N,), load (N,), from rest at load[0]; one step per sample.

    BDF2 (backward Euler for the first step) with Newton on the exact Jacobian. The steps are the
    intervals between the samples; none is divided.
    """
    seconds, force = np.asarray(time, dtype=np.float64), np.asarray(load, dtype=np.float64)
    rows = contact_rows(rig, contact)
    mass = np.array([rig.carriage.mass, rig.carriage.mass, rig.carriage.inertia])
    q = [static_equilibrium(rig, contact, float(force[0]), elevation)]
    v = [np.zeros(3)]
    h_old = 0.0
    for n in range(1, seconds.size):
        h = float(seconds[n] - seconds[n - 1])
        ratio = h / h_old if h_old > 0.0 else 0.0
        if 0.0 < ratio <= 2.0:
            c0 = (1.0 + 2.0 * ratio) / (1.0 + ratio) / h
            q_past = -(1.0 + ratio) / h * q[-1] + ratio**2 / (1.0 + ratio) / h * q[-2]
            v_past = -(1.0 + ratio) / h * v[-1] + ratio**2 / (1.0 + ratio) / h * v[-2]
        else:
            c0, q_past, v_past = 1.0 / h, -q[-1] / h, -v[-1] / h
        external = external_force(rig, float(force[n]), elevation)
        q_new = _implicit_step(rows, mass, external, c0, q_past, v_past, q[-1] + h * v[-1])
        q.append(q_new)
        v.append(c0 * q_new + q_past)
        h_old = h
    return np.asarray(np.array(q).T, dtype=np.float64)


def _implicit_step(rows: tuple[ContactRow, ...], mass: Floats, external: Floats, c0: float,
                   q_past: Floats, v_past: Floats, guess: Floats) -> Floats:
    """Q with mass (c0 v + v_past) = external + contact(q, v), v = c0 q + q_past."""
    q = guess
    for _ in range(50):
        v = c0 * q + q_past
        residual = external + contact_force(rows, q, v) - mass * (c0 * v + v_past)
        by_q, by_rate = contact_jacobian(rows, q, v)
        step = np.linalg.solve(np.diag(mass) * c0**2 - by_q - c0 * by_rate, residual)
        q = q + step
        if np.max(np.abs(step)) < 1e-13:
            return np.asarray(q)
    raise SimulationError('a time step did not converge: shorten the step or check the record')


def rate_of_state(rig: Rig, contact: ContactParameters, elevation: float,
                  load_at: Callable[[float], float]) -> Callable[[float, Floats], Floats]:
    """f(t, (q, v)) = (v, a) for any solver of ordinary differential equations."""
    rows = contact_rows(rig, contact)
    mass = np.array([rig.carriage.mass, rig.carriage.mass, rig.carriage.inertia])

    def rate(t: float, state: Floats) -> Floats:
        q, v = state[:3], state[3:]
        external = external_force(rig, load_at(t), elevation)
        return np.concatenate([v, (external + contact_force(rows, q, v)) / mass])

    return rate
