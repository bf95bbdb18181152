"""A robot arm with the faults of FloBaRoID (kjyv/FloBaRoID, LGPL-3), by its author's own code.

FLOBAROID is the folder of its excitation/simulationEffects.py. In a sound arm the masses hang off
the axes, drag is not quite linear, and torque and angle are filtered and rounded.
"""

from dataclasses import replace
import importlib
import os
import sys

import numpy as np

from machines.machine import Array, declared, Draw, hides, swings
from saddlering_ros.discrepancy import Channel, Parameter, Run

sys.path.insert(0, os.environ.get('FLOBAROID', '.'))
faults = importlib.import_module('simulationEffects')

HERTZ, COUNT = 50.0, 450
JOINTS = ('shoulder', 'elbow')
WEIGHTS = np.array([1.0, 0.4])
"""Sizes in both joints, in proportion to the torque that each can hold."""

TRUE = {'inertia': 1.6, 'elbow': 0.35, 'coupling': 0.3, 'gravity': 28.0, 'lower': 9.0,
        'viscous': 2.0}


def rigid(p: dict[str, float], q: Array, v: Array, a: Array) -> Array:
    """Torques (N, 2) [N m] of two links that hang, with viscous friction."""
    bend, turn, fall = np.cos(q[:, 1]), np.sin(q[:, 1]), np.sin(q.sum(axis=1))
    coupling, lower = p['coupling'] * bend, p['lower'] * fall
    one = (p['inertia'] + 2.0 * coupling) * a[:, 0] + (p['elbow'] + coupling) * a[:, 1]
    one += p['gravity'] * np.sin(q[:, 0]) + lower
    one -= p['coupling'] * turn * v[:, 1] * (2.0 * v[:, 0] + v[:, 1])
    two = (p['elbow'] + coupling) * a[:, 0] + p['elbow'] * a[:, 1] + lower
    two += p['coupling'] * turn * v[:, 0] ** 2
    return np.column_stack([one, two]) + p['viscous'] * WEIGHTS * v


def simulate(p: dict[str, float], run: Run) -> dict[str, Array]:
    q, v, a = (np.asarray(run.inputs[name]) for name in ('q', 'v', 'a'))
    sign, hours = np.tanh(v / 0.02), run.time[:, None] / 600.0
    q = q + p['backlash.width'] * sign
    if p['deflection.compliance']:
        q = q - p['deflection.compliance'] * rigid(p, q, v, a)
    jerk = np.gradient(a, 1.0 / HERTZ, axis=0)
    fall = np.exp(-np.abs(v) / 0.05)
    added = p['friction.torque'] * sign + p['stiction.torque'] * fall * sign
    added += p['cogging.torque'] * np.sin(24.0 * q) - p['thermal.torque'] * hours * sign
    pulled = q - np.array([p['cables.rest'], p['cables.elbow']])
    added -= p['cables.rate'] * pulled * (1.0 + p['cables.hardening'] * pulled**2)
    added += p['gravity_error.torque'] * np.sin(q) + p['elasticity.size'] * jerk
    torque = rigid(p, q, v, a) + WEIGHTS * added
    return dict(zip(JOINTS, torque.T, strict=True))


def record(draw: Draw) -> Run:
    time = np.arange(COUNT) / HERTZ
    q = 1.2 * np.column_stack([swings(draw.random, time, 0.1, 0.6) for _ in JOINTS])
    v = np.gradient(q, time, axis=0)
    a = np.gradient(v, time, axis=0)
    (dry, stick, play, ripple, soft, cables, warm, heavy, bent) = (
        WEIGHTS * draw.size(f'{name}.{size}') for name, size in SIZES.items())
    arm = faults.JointProperties(
        2, warm, dry, 200.0 * WEIGHTS, 5.0 * WEIGHTS, np.array([2.0, 1.0]),
        torque_sensor_error=0.002, thermal_reduction=1.0, stiction=stick, backlash=play,
        encoder_bits=np.full(2, 17.0), compliance=bent, cable_stiffness=cables,
        elasticity_freq=np.array([25.0, 32.0]), elasticity_damping=np.full(2, 0.07),
        elasticity_gain=soft, cogging_amplitude=ripple, torque_quant_bits=np.full(2, 13.0),
        thermal_tau=np.full(2, 600.0), grav_comp_error=heavy / (1.47 * np.array([3.0, 1.0])))
    true, off = dict(draw.true), draw.own.normal(size=3) * (0.02, 0.02, 0.1)
    torque = rigid(true, q + off[:2], v, a) + true['viscous'] * off[2] * v * np.abs(v)
    torque = torque + faults.add_friction(torque, v, replace(arm, viscous_friction=0.0 * warm))
    torque += faults.add_joint_elasticity(torque, a, HERTZ, arm, 0)
    torque += faults.add_torque_ripple(COUNT, q, arm, 0)
    torque += faults.add_temperature_friction_drift(torque, v, time, arm)
    torque += faults.add_cable_forces(torque, q, arm, rng=np.random.default_rng(draw.seed))
    torque += faults.add_gravity_compensation_residual(torque, q, arm)
    seen = faults.add_structural_deflection(faults.add_backlash(q, v, arm), torque, arm)
    seen, _, torque, *_ = faults.add_sensor_noise(seen, v, torque, HERTZ, draw.random, arm)
    torque = faults.add_torque_quantization(torque, arm)
    seen = faults.add_encoder_quantization(seen, arm)
    return draw.run(time, {'q': seen, 'v': v, 'a': a}, torque.T, noise=0.0)


EFFECTS = {
    'friction': hides('Coulomb friction', 3.0, torque=Parameter(0, 20)),
    'stiction': hides('Friction that falls with speed', 4.0, torque=Parameter(0, 30)),
    'backlash': hides('Backlash of the gears', 0.04, width=Parameter(0, 0.2)),
    'cogging': hides('Torque ripple', 1.5, torque=Parameter(-10, 10)),
    'elasticity': hides('Elastic joints', 0.02, size=Parameter(-0.2, 0.2)),
    'cables': hides('Cables that pull', 5.0, rate=Parameter(-2, 30), rest=Parameter(-0.5, 0.5),
                    elbow=Parameter(-0.5, 0.5), hardening=Parameter(0, 1)),
    'thermal': hides('Friction that falls as it warms', 300.0, torque=Parameter(0, 1000)),
    'gravity_error': hides('Error of the compensated gravity', 4.0, torque=Parameter(-20, 20)),
    'deflection': hides('Links that bend', 0.001, compliance=Parameter(-0.005, 0.005)),
}
SIZES = {name: effect.ordered[0].name for name, (effect, _) in EFFECTS.items()}
MACHINE = declared(
    'flobaroid', 'kjyv/FloBaRoID', 'LGPL-3.0', record, simulate,
    {name: (value, Parameter(0.3 * value, 3.0 * value)) for name, value in TRUE.items()}, EFFECTS,
    {name: Channel('N m') for name in JOINTS})
