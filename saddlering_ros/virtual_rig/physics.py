"""The physics of the virtual rig during a test: load, rollers, friction, joints, probes."""

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from saddlering_ros.errors import VirtualRigError
from saddlering_ros.rig import ContactParameters, Rig
from saddlering_ros.virtual_rig import integrator as at
from saddlering_ros.virtual_rig.effects import EffectRequest
from saddlering_ros.virtual_rig.effects_probes import ProbeMotion
from saddlering_ros.virtual_rig.effects_ring import FrictionElements, LoadPath, Motion
from saddlering_ros.virtual_rig.integrator import make_rollers, Scatter

Floats = NDArray[np.float64]

HELD_SHARE = 0.5
"""Friction at the start takes at most this share of the force that acts on its element."""


@dataclass(frozen=True)
class PhysicalRig:
    """One particular rig: description, true contact law, scatter and number, and its faults."""

    rig: Rig
    contact: ContactParameters
    elevation: float
    effects: tuple[EffectRequest, ...] = ()
    scatter: Scatter = field(default_factory=Scatter)
    number: int = 1

    def requests(self, stage: str) -> list[EffectRequest]:
        """The effects that act at this stage."""
        return [request for request in self.effects if request.effect.stage == stage]


@dataclass(frozen=True)
class PhysicalRun:
    """The motion before any instrument: time (N,) [s], load at an exact cell (N,) [N].

    motion: of C, absolute; increments (4, N) [m]: at the probes since the start.
    """

    time: Floats
    load: Floats
    motion: Motion
    increments: Floats


def run_test(physical: PhysicalRig, load: Floats, step: float, seed: int = 0) -> PhysicalRun:
    """Let the rig go through `load` [N], given at thirds of equal steps, (3 N + 1,), `step` [s].

    It starts at rest under load[0]. VirtualRigError if the motion cannot be followed.
    """
    count = len(load)
    path = LoadPath(
        physical.rig, step / 3.0 * np.arange(count, dtype=np.float64), load, load.copy(),
        np.full(count, physical.elevation, dtype=np.float64),
        np.full(count, physical.rig.trunnion.y, dtype=np.float64))
    _act(physical, 'load', path)
    # Force and moment at C with the dead weight, (N, 3).
    cosine, sine = np.cos(path.elevation), np.sin(path.elevation)
    arm = path.trunnion_y * cosine + physical.rig.trunnion.x * sine
    weight = physical.rig.carriage.weight
    forces = np.stack([path.arriving * cosine, -path.arriving * sine - weight,
                       path.arriving * arm + weight * physical.rig.carriage.weight_x], axis=1)
    rollers = make_rollers(physical.rig, physical.contact, physical.scatter, physical.number)
    _act(physical, 'rollers', rollers)
    elements = FrictionElements([], [])
    _act(physical, 'friction', elements)
    friction = np.array(elements.rows).reshape(-1, at.FRICTION_COLUMNS)
    force = forces[0]
    # Friction cannot push the ring: it takes half of its load at most.
    acting = np.abs(friction[:, :3] @ force)
    most = HELD_SHARE * acting / np.maximum(friction[:, at.F_LIMIT], 1e-12)
    z = np.clip(np.array(elements.initial), -most, most)
    mass = np.array([physical.rig.carriage.mass] * 2 + [physical.rig.carriage.inertia])
    # A position with the gaps closed on the side that the force presses on.
    start = np.array([np.copysign(0.5 * physical.rig.radial_row.clearance, force[0]),
                      np.copysign(0.5 * physical.rig.axial_rows.clearance, force[1]), 0.0])
    rest, failed_steps = at.settle(rollers.table, friction, z, mass, force, start)
    if failed_steps:
        raise VirtualRigError('the ring finds no rest at the start of the test: give a preload '
                              'above zero, or effects of smaller size')
    positions, failed_steps = at.integrate(rollers.table, friction, z, mass, rest, step, forces)
    if failed_steps > len(positions) // 1000 or not np.all(np.isfinite(positions)):
        raise VirtualRigError(f'the motion cannot be followed in {failed_steps} of '
                              f'{len(positions)} steps: give effects of smaller size')
    every = slice(None, None, 3)
    force_x, force_y, moment = forces[every].T
    x, y, tilt = positions.T.copy()
    motion = Motion(
        rig=physical.rig, time=path.time[every], x=x, y=y, tilt=tilt, force_x=force_x.copy(),
        force_y=force_y.copy(), moment=moment.copy(), load=path.arriving[every].copy())
    _act(physical, 'motion', motion)
    probes = physical.rig.probes
    radial, lever = motion.x + motion.tilt * probes.radial_height, 0.5 * probes.axial_span
    increments = np.stack([radial, motion.y + lever * motion.tilt, -radial,
                           motion.y - lever * motion.tilt])
    seen = ProbeMotion(motion, increments - increments[:, :1], seed)
    _act(physical, 'probes', seen)
    return PhysicalRun(motion.time, path.measured[every].copy(), motion, seen.increments)


def _act(physical: PhysicalRig, stage: str, target: object) -> None:
    for request in physical.requests(stage):
        request.effect.act(target, request.values, request.form)
