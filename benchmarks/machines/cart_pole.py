"""A pendulum that hangs on a driven cart; records by MuJoCo with its own friction constraints."""

import mujoco
import numba as nb
import numpy as np

from machines.machine import Draw, hides, own_machine, swings
from saddlering_ros.discrepancy import Channel, Parameter, Run

STEP, FINE, COUNT, GRAVITY, LENGTH, RADIUS = 0.02, 2e-4, 800, 9.81, 0.5, 0.02
SCENE = """<mujoco><option timestep="{8}" integrator="implicitfast"/><worldbody><body euler="0 {6}
0"><joint type="slide" axis="1 0 0" damping="{2}" frictionloss="{4}" stiffness="{7}"/><geom
size=".1" mass="{0}"/><body><joint axis="0 -1 0" damping="{3}" frictionloss="{5}"/><geom size="{9}"
pos="0 0 -{10}" mass="{1}"/></body></body></worldbody></mujoco>"""


@nb.njit(cache=True)
def roll(force, law, parts):  # type: ignore[no-untyped-def]
    """Place of the cart and angle of the pole (2, N) by midpoint steps."""
    cart, bob, rolling, turning, rail, hinge, tilt, spring = law
    lean, heavy, inertia = np.deg2rad(tilt), bob * LENGTH, bob * (LENGTH**2 + 0.4 * RADIUS**2)
    seen, dt, x, v, q, w = np.empty((2, len(force))), STEP / parts, 0.0, 0.0, 0.0, 0.0
    for n in range(len(force)):
        seen[0, n], seen[1, n] = x, q
        for _ in range(parts):
            x0, v0, q0, w0 = x, v, q, w
            for share in (0.5, 1.0):
                pull = (cart + bob) * GRAVITY * np.sin(lean) + heavy * np.sin(q) * w * w
                pull += force[n] - rolling * v - spring * x - rail * np.tanh(v / 0.002)
                turn = heavy * GRAVITY * np.sin(lean - q) - turning * w - hinge * np.tanh(w / 0.02)
                mixed = heavy * np.cos(q)
                step = share * dt / ((cart + bob) * inertia - mixed * mixed)
                x, q = x0 + share * dt * v, q0 + share * dt * w
                v = v0 + step * (pull * inertia - mixed * turn)
                w = w0 + step * ((cart + bob) * turn - mixed * pull)
    return seen


def record(draw: Draw) -> Run:
    time, seen = STEP * np.arange(COUNT), np.empty((2, COUNT))
    force = 4.0 * swings(draw.random, time, 0.3, 1.4)
    model = mujoco.MjModel.from_xml_string(SCENE.format(*draw.law(), FINE, RADIUS, LENGTH))
    data = mujoco.MjData(model)
    for n in range(COUNT):
        seen[:, n], data.qfrc_applied[0] = data.qpos, force[n]
        mujoco.mj_step(model, data, round(STEP / FINE))
    return draw.run(time, {'force': force}, seen)


MACHINE = own_machine('cart_pole', record, roll, source='MuJoCo 4.0', licence='Apache-2.0', base={
    'cart': (1.0, Parameter(0.4, 2, unit='kg')), 'bob': (0.3, Parameter(0.1, 0.8, unit='kg')),
    'cart_damping': (1.2, Parameter(0, 5)), 'pole_damping': (0.01, Parameter(0, 0.1)),
}, effects={
    'rail': hides('Dry friction of the rail', 0.3, force=Parameter(0, 3, unit='N')),
    'hinge': hides('Dry friction of the hinge', 0.012, torque=Parameter(0, 0.1, unit='N m')),
    'tilt': hides('Rail out of level', 0.4, angle=Parameter(-5, 5, unit='deg')),
    'spring': hides('Cable that pulls the cart back', 0.4, rate=Parameter(0, 5, unit='N/m')),
    # MuJoCo's soft friction and this steep line differ by so much at the truth (seeds 301 ff.).
}, channels={'cart': Channel('m', model_error=0.002), 'pole': Channel('rad', model_error=0.001)})
