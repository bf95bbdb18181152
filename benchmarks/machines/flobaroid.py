"""A robot arm with the faults of FloBaRoID (kjyv/FloBaRoID, LGPL-3), by its author's own code."""

from functools import partial

import numpy as np

from machines.machine import about, Array, declared, hides
from machines.simulators import arm, HERTZ, WEIGHTS
from saddlering_ros.discrepancy import Channel, Parameter, Run

JOINTS = ('shoulder', 'elbow')


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


record = partial(arm, rigid=rigid)
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
