"""Records of other people's simulators: rotors by ross, robot arms with faults by FloBaRoID.

Each is imported where it is used, because a benchmark may have one without the other.
"""

from collections.abc import Callable
from dataclasses import replace
from functools import cache
import importlib
import os
import sys
from typing import Any

import numpy as np

from machines.machine import Array, Draw, swings
from saddlering_ros.discrepancy import Run

STEP, EARLY, COUNT = 1e-3, 150, 250  # s, of a rotor; samples to its record, and of it
HERTZ, MOVES = 50.0, 450  # Samples of an arm in a second, and in all.
WEIGHTS = np.array([1.0, 0.4])  # Sizes in both joints, by the torque that each can hold.
FAULTS = {
    'coulomb_friction': 'friction.torque', 'stiction': 'stiction.torque',
    'backlash': 'backlash.width', 'cogging_amplitude': 'cogging.torque',
    'elasticity_gain': 'elasticity.size', 'cable_stiffness': 'cables.rate',
    'viscous_friction': 'thermal.torque', 'grav_comp_error': 'gravity_error.torque',
    'compliance': 'deflection.compliance'}  # The name of each in FloBaRoID, and in the catalogue.


def rotor(draw: Draw) -> Run:
    """Displacements [um] of both discs of a rotor by ross, x and y of each."""
    import ross
    from ross import faults

    time, speed = STEP * np.arange(EARLY + COUNT), draw.random.uniform(70.0, 160.0)
    steel = ross.Material('Steel', rho=7850, E=2.17e11, G_s=81.2e9)
    beams = ross.Rotor(
        [ross.ShaftElement(0.06, 0.0, 0.019, material=steel, alpha=20.0, beta=1e-5)] * 12,
        [ross.DiskElement(n, 2.6, 0.0036, 0.0068) for n in (4, 8)],
        [ross.BearingElement(n, 1e6 * draw.true[f'{end}_x'], 500, kyy=1e6 * draw.true[f'{end}_y'],
                             cyy=500) for n, end in ((1, 'near'), (11, 'far'))])
    force, turned, *_ = beams.unbalance_force_over_time(
        [4], [1e-4 * draw.true['unbalance']], [draw.true['angle']], speed, time, return_all=True)
    bow = draw.size('bow.force') * np.exp(1j * (turned + 0.8))
    force[24:26] += [bow.real, bow.imag]
    if apart := 5e-6 * draw.size('misaligned.force'):
        coupling = faults.MisalignmentFlex(beams, 0, 'parallel', apart, apart, 0.0, 4e4, 3.8e4)
        force += coupling.compute_reaction_force(turned)
    push = 1e6 * draw.size('rub.stiffness')
    rub = faults.Rubbing(beams, 6, 4e-5, push, 40.0 if push else 0.0, 0.3)
    rub.forces = np.zeros_like(force)
    found = beams.run_time_response(
        speed, force.T, time, 'newmark', add_to_RHS=lambda step, disp_resp, velc_resp, **_:
        rub._get_force_over_time(step, disp_resp, velc_resp, speed))
    seen = 1e6 * found.yout[EARLY:, [24, 25, 48, 49]].T
    return draw.run(time[EARLY:], {'speed': speed}, seen)


@cache
def floating_base_faults() -> Any:
    """The module of FloBaRoID that has its faults."""
    sys.path.insert(0, os.environ['FLOBAROID'])
    return importlib.import_module('simulationEffects')


def arm(draw: Draw, rigid: Callable[..., Array]) -> Run:
    """Torques [N m] of a robot arm by FloBaRoID, beside those that `rigid` gives of its motion.

    FLOBAROID is the folder of its excitation/simulationEffects.py. In a sound arm the masses hang
    off the axes, drag is not quite linear, and torque and angle are filtered and rounded.
    """
    faults = floating_base_faults()
    time, still = np.arange(MOVES) / HERTZ, np.zeros((MOVES, 2))
    q = 1.2 * np.column_stack([swings(draw.random, time, 0.1, 0.6) for _ in range(2)])
    v = np.gradient(q, time, axis=0)
    a = np.gradient(v, time, axis=0)
    sizes = {field: WEIGHTS * draw.size(name) for field, name in FAULTS.items()}
    joints = faults.JointProperties(
        2, torque_limit=200.0 * WEIGHTS, torque_sensor_error=0.002, velocity_limit=5.0 * WEIGHTS,
        link_mass=np.array([0.0, 1.0 / 1.47]), elasticity_freq=np.array([25.0, 32.0]),
        elasticity_damping=np.full(2, 0.07), torque_quant_bits=np.full(2, 13.0),
        encoder_bits=np.full(2, 17.0), thermal_tau=np.full(2, 600.0), thermal_reduction=1.0,
        **sizes)
    off = draw.own.normal(size=3) * (0.02, 0.02, 0.1)
    torque = rigid(dict(draw.true), q + off[:2], v, a)
    torque += draw.true['viscous'] * off[2] * v * np.abs(v)
    torque += faults.add_friction(still, v, replace(joints, viscous_friction=np.zeros(2)))
    torque += faults.add_joint_elasticity(still, a, HERTZ, joints, 0)
    torque += faults.add_torque_ripple(MOVES, q, joints, 0)
    torque += faults.add_temperature_friction_drift(still, v, time, joints)
    torque += faults.add_cable_forces(still, q, joints, rng=np.random.default_rng(draw.seed))
    torque += faults.add_gravity_compensation_residual(still, q, joints)
    seen = faults.add_structural_deflection(faults.add_backlash(q, v, joints), torque, joints)
    seen, _, torque, *_ = faults.add_sensor_noise(seen, v, torque, HERTZ, draw.random, joints)
    seen, torque = (faults.add_encoder_quantization(seen, joints),
                    faults.add_torque_quantization(torque, joints))
    return draw.run(time, {'q': seen, 'v': v, 'a': a}, torque.T, noise=0.0)
