"""A pendulum that hangs on a driven cart; records by MuJoCo with its own friction constraints."""

from __future__ import annotations

import mujoco
import numba as nb
import numpy as np

from machines.machine import Array, Draw, Machine, noisy, swings
from saddlering_ros.discrepancy import Channel, Effect, Model, Parameter, Run

STEP, SUBSTEPS, FINE = 0.02, 8, 2e-4
COUNT = 800
GRAVITY, LENGTH, RADIUS = 9.81, 0.5, 0.02
TRUE = {'cart': 1.0, 'bob': 0.3, 'cart_damping': 1.2, 'pole_damping': 0.01}
MODEL_ERROR = {'cart': 0.002, 'pole': 0.001}
"""MuJoCo holds by a soft constraint, this model by a steep line through zero speed: at the truth,
without noise, records with friction differ by so much of the range (seeds 301 to 303)."""
SCENE = """
<mujoco>
  <option timestep="{fine}" gravity="{across} 0 {down}" integrator="implicitfast"/>
  <worldbody>
    <body name="cart">
      <joint name="rail" type="slide" axis="1 0 0" damping="{cart_damping}"
             frictionloss="{rail}" stiffness="{spring}"/>
      <geom type="box" size=".1 .05 .05" mass="{cart}" contype="0" conaffinity="0"/>
      <body name="pole">
        <joint name="hinge" type="hinge" axis="0 -1 0" damping="{pole_damping}"
               frictionloss="{hinge}"/>
        <geom type="sphere" size="{radius}" pos="0 0 -{length}" mass="{bob}"
              contype="0" conaffinity="0"/>
      </body>
    </body>
  </worldbody>
</mujoco>
"""


@nb.njit(cache=True)
def roll(force, law):  # type: ignore[no-untyped-def]
    """Place of the cart and angle of the pole (2, N) by midpoint steps."""
    cart, bob, rolling, turning, rail, hinge, tilt, spring = law
    across, down = GRAVITY * np.sin(tilt), GRAVITY * np.cos(tilt)
    seen = np.empty((2, force.size))
    x = v = q = w = 0.0
    inertia = bob * (LENGTH**2 + 0.4 * RADIUS**2)
    dt = STEP / SUBSTEPS
    for n in range(force.size):
        seen[0, n], seen[1, n] = x, q
        for _ in range(SUBSTEPS):
            x0, v0, q0, w0 = x, v, q, w
            for share in (0.5, 1.0):
                sine, cosine = np.sin(q), np.cos(q)
                pull = force[n] + bob * LENGTH * sine * w * w + (cart + bob) * across
                pull -= rolling * v + spring * x + rail * np.tanh(v / 0.002)
                turn = bob * LENGTH * (across * cosine - down * sine)
                turn -= turning * w + hinge * np.tanh(w / 0.02)
                mixed = bob * LENGTH * cosine
                whole = (cart + bob) * inertia - mixed * mixed
                gain = (pull * inertia - mixed * turn) / whole
                spin = ((cart + bob) * turn - mixed * pull) / whole
                x, q = x0 + share * dt * v, q0 + share * dt * w
                v, w = v0 + share * dt * gain, w0 + share * dt * spin
    return seen


def simulate(p: dict[str, float], run: Run) -> dict[str, Array]:
    law = np.array([p['cart'], p['bob'], p['cart_damping'], p['pole_damping'], p['rail.force'],
                    p['hinge.torque'], np.deg2rad(p['tilt.angle']), p['spring.rate']])
    seen = roll(np.asarray(run.inputs['force']), law)
    return {'cart': seen[0], 'pole': seen[1]}


MODEL = Model(
    simulate,
    base={'cart': Parameter(0.4, 2, unit='kg'), 'bob': Parameter(0.1, 0.8, unit='kg'),
          'cart_damping': Parameter(0, 5, unit='N s/m'),
          'pole_damping': Parameter(0, 0.1, unit='N m s')},
    effects={
        'rail': Effect('Dry friction of the rail', {'force': Parameter(0, 3, unit='N')}),
        'hinge': Effect('Dry friction of the hinge', {'torque': Parameter(0, 0.1, unit='N m')}),
        'tilt': Effect('Rail out of level', {'angle': Parameter(-5, 5, unit='deg')}),
        'spring': Effect('Cable that pulls the cart back', {'rate': Parameter(0, 5, unit='N/m')}),
    },
    channels={'cart': Channel(unit='m', model_error=MODEL_ERROR['cart']),
              'pole': Channel(unit='rad', model_error=MODEL_ERROR['pole'])},
)
HIDDEN = {'rail': {'force': 0.3}, 'hinge': {'torque': 0.012}, 'tilt': {'angle': 0.4},
          'spring': {'rate': 0.4}}


def record(draw: Draw) -> Run:
    true, random = draw.true, draw.random
    time = STEP * np.arange(COUNT)
    force = 4.0 * swings(random, time, 0.3, 1.4)
    tilt = np.deg2rad(draw.size('tilt.angle'))
    model = mujoco.MjModel.from_xml_string(SCENE.format(
        fine=FINE, across=GRAVITY * np.sin(tilt), down=-GRAVITY * np.cos(tilt), length=LENGTH,
        radius=RADIUS, rail=draw.size('rail.force'), hinge=draw.size('hinge.torque'),
        spring=draw.size('spring.rate'), **true))
    data = mujoco.MjData(model)
    seen = np.empty((2, COUNT))
    for n in range(COUNT):
        seen[:, n] = data.qpos
        data.qfrc_applied[0] = force[n]
        for _ in range(round(STEP / FINE)):
            mujoco.mj_step(model, data)
    return draw.run(time, {'force': force},
                    {'cart': noisy(random, seen[0]), 'pole': noisy(random, seen[1])})


MACHINE = Machine('cart_pole', 'MuJoCo 4.0', 'Apache-2.0', MODEL, HIDDEN, record, TRUE)
