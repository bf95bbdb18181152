"""A robot arm with the faults of FloBaRoID (kjyv/FloBaRoID, LGPL-3), by its author's own code.

FLOBAROID is the folder of its excitation/simulationEffects.py. In a sound arm the masses hang off
the axes, drag is not quite linear, and torque and angle are filtered and rounded.
"""

from dataclasses import replace
import importlib
import os
import sys

import numpy as np

from machines.machine import about, Array, declared, Draw, hides, swings
from saddlering_ros.discrepancy import Channel, Parameter, Run

sys.path.insert(0, os.environ.get('FLOBAROID', '.'))
faults = importlib.import_module('simulationEffects')
HERTZ, COUNT, JOINTS = 50.0, 450, ('shoulder', 'elbow')
WEIGHTS = np.array([1.0, 0.4])  # Sizes in both joints, by the torque that each can hold.


def rigid(p: dict[str, float], q: Array, v: Array, a: Array) -> Array:
    """Torques (N, 2) [N m] of two links that hang, with viscous friction."""
    coupling, turn = p['coupling'] * np.cos(q[:, 1]), p['coupling'] * np.sin(q[:, 1])
    lower = p['lower'] * np.sin(q.sum(axis=1))
    one = (p['inertia'] + 2.0 * coupling) * a[:, 0] + (p['elbow'] + coupling) * a[:, 1]
    one += p['gravity'] * np.sin(q[:, 0]) + lower - turn * v[:, 1] * (2.0 * v[:, 0] + v[:, 1])
    two = (p['elbow'] + coupling) * a[:, 0] + p['elbow'] * a[:, 1] + lower + turn * v[:, 0] ** 2
    return np.column_stack([one, two]) + p['viscous'] * WEIGHTS * v


def simulate(p: dict[str, float], run: Run) -> dict[str, Array]:
    q, v, a = map(np.asarray, run.inputs.values())
    sign, hours = np.tanh(v / 0.02), run.time[:, None] / 600.0
    q = q + p['backlash.width'] * sign
    q = q - p['deflection.compliance'] * rigid(p, q, v, a)
    added = p['friction.torque'] + p['stiction.torque'] * np.exp(-np.abs(v) / 0.05)
    added = (added - p['thermal.torque'] * hours) * sign + p['cogging.torque'] * np.sin(24.0 * q)
    pulled = q - np.array([p['cables.rest'], p['cables.elbow']])
    added -= p['cables.rate'] * pulled * (1.0 + p['cables.hardening'] * pulled**2)
    added += p['gravity_error.torque'] * np.sin(q)
    added += p['elasticity.size'] * np.gradient(a, 1.0 / HERTZ, axis=0)
    return dict(zip(JOINTS, (rigid(p, q, v, a) + WEIGHTS * added).T, strict=True))


def record(draw: Draw) -> Run:
    time, still = np.arange(COUNT) / HERTZ, np.zeros((COUNT, 2))
    q = 1.2 * np.column_stack([swings(draw.random, time, 0.1, 0.6) for _ in JOINTS])
    v = np.gradient(q, time, axis=0)
    a = np.gradient(v, time, axis=0)
    sizes = {field: WEIGHTS * draw.size(name) for field, name in FIELDS.items()}
    arm = faults.JointProperties(
        2, torque_limit=200.0 * WEIGHTS, torque_sensor_error=0.002, velocity_limit=5.0 * WEIGHTS,
        link_mass=np.array([0.0, 1.0 / 1.47]), elasticity_freq=np.array([25.0, 32.0]),
        elasticity_damping=np.full(2, 0.07), torque_quant_bits=np.full(2, 13.0),
        encoder_bits=np.full(2, 17.0), thermal_tau=np.full(2, 600.0), thermal_reduction=1.0,
        **sizes)
    off = draw.own.normal(size=3) * (0.02, 0.02, 0.1)
    torque = rigid(dict(draw.true), q + off[:2], v, a)
    torque += draw.true['viscous'] * off[2] * v * np.abs(v)
    torque += faults.add_friction(still, v, replace(arm, viscous_friction=np.zeros(2)))
    torque += faults.add_joint_elasticity(still, a, HERTZ, arm, 0)
    torque += faults.add_torque_ripple(COUNT, q, arm, 0)
    torque += faults.add_temperature_friction_drift(still, v, time, arm)
    torque += faults.add_cable_forces(still, q, arm, rng=np.random.default_rng(draw.seed))
    torque += faults.add_gravity_compensation_residual(still, q, arm)
    seen = faults.add_structural_deflection(faults.add_backlash(q, v, arm), torque, arm)
    seen, _, torque, *_ = faults.add_sensor_noise(seen, v, torque, HERTZ, draw.random, arm)
    torque = faults.add_torque_quantization(torque, arm)
    seen = faults.add_encoder_quantization(seen, arm)
    return draw.run(time, {'q': seen, 'v': v, 'a': a}, torque.T, noise=0.0)


FIELDS = {
    'coulomb_friction': 'friction.torque', 'stiction': 'stiction.torque',
    'backlash': 'backlash.width', 'cogging_amplitude': 'cogging.torque',
    'elasticity_gain': 'elasticity.size', 'cable_stiffness': 'cables.rate',
    'viscous_friction': 'thermal.torque', 'grav_comp_error': 'gravity_error.torque',
    'compliance': 'deflection.compliance'}
MACHINE = declared('flobaroid', 'kjyv/FloBaRoID', 'LGPL-3.0', record, simulate, {
    'inertia': about(1.6), 'elbow': about(0.35), 'coupling': about(0.3), 'gravity': about(28.0),
    'lower': about(9.0), 'viscous': about(2.0),
}, {
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
}, {name: Channel('N m') for name in JOINTS})
