"""A torque-driven pendulum; records by gymnasium's Pendulum-v1 at steps of 0.5 ms."""

from __future__ import annotations

from gymnasium.envs.classic_control.pendulum import PendulumEnv
import numba as nb
import numpy as np

from machines.machine import Array, Draw, Machine, noisy, swings
from saddlering_ros.discrepancy import Channel, Effect, Model, Parameter, Run

STEP, SUBSTEPS, FINE = 0.02, 8, 5e-4
COUNT = 1000
TRUE = {'gravity': 15.0, 'gain': 3.0, 'viscous': 0.35}


@nb.njit(cache=True)
def swing(torque, law):  # type: ignore[no-untyped-def]
    """Angle from hanging (N,): midpoint steps, the torque held between samples."""
    gravity, gain, viscous, friction, drag, spring, bias = law
    angle = np.empty(torque.size)
    place = speed = 0.0
    dt = STEP / SUBSTEPS
    for n in range(torque.size):
        angle[n] = place
        for _ in range(SUBSTEPS):
            old_place, old_speed = place, speed
            for share in (0.5, 1.0):
                force = gain * torque[n] - gravity * np.sin(place) - viscous * speed
                force += bias - spring * place - drag * speed * abs(speed)
                force -= friction * np.tanh(speed / 0.01)
                place = old_place + share * dt * speed
                speed = old_speed + share * dt * force
    return angle


def simulate(p: dict[str, float], run: Run) -> dict[str, Array]:
    law = np.array([p['gravity'], p['gain'], p['viscous'], p['friction.torque'], p['drag.size'],
                    p['spring.rate'], p['bias.torque']])
    return {'angle': swing(np.asarray(run.inputs['torque']), law)}


MODEL = Model(
    simulate,
    base={'gravity': Parameter(8, 25, unit='1/s^2'), 'gain': Parameter(1, 6),
          'viscous': Parameter(0, 2, unit='1/s')},
    effects={
        'friction': Effect('Dry friction of the bearing', {'torque': Parameter(0, 4)}),
        'drag': Effect('Drag that grows with the square of speed', {'size': Parameter(0, 1)}),
        'spring': Effect('Cable that winds up', {'rate': Parameter(0, 10)}),
        'bias': Effect('Torque beside the one commanded', {'torque': Parameter(-3, 3)}),
    },
    channels={'angle': Channel(unit='rad')},
)
HIDDEN = {'friction': {'torque': 0.4}, 'drag': {'size': 0.12}, 'spring': {'rate': 1.5},
          'bias': {'torque': 0.3}}


def record(draw: Draw) -> Run:
    true, random = draw.true, draw.random
    time = STEP * np.arange(COUNT)
    torque = 1.1 * swings(random, time, 0.15, 0.9)
    environment = PendulumEnv()
    environment.max_torque = environment.max_speed = 1e6
    environment.dt, environment.l, environment.m = FINE, 1.0, 1.0
    environment.g = true['gravity'] * 2.0 / 3.0
    environment.state, environment.last_u = np.array([np.pi, 0.0]), 0.0
    angle = np.empty(COUNT)
    for n in range(COUNT):
        angle[n] = environment.state[0] - np.pi
        for _ in range(round(STEP / FINE)):
            place, speed = environment.state[0] - np.pi, environment.state[1]
            pull = true['gain'] * torque[n] + draw.size('bias.torque')
            pull -= true['viscous'] * speed + draw.size('spring.rate') * place
            pull -= draw.size('drag.size') * speed * abs(speed)
            grip = speed / FINE + pull - true['gravity'] * np.sin(place)  # would stop it
            limit = draw.size('friction.torque')
            pull -= min(max(grip, -limit), limit)
            environment.step(np.array([pull / 3.0]))
    return draw.run(time, {'torque': torque}, {'angle': noisy(random, angle)})


MACHINE = Machine('pendulum', 'gymnasium 1.4.0, Pendulum-v1', 'MIT', MODEL, HIDDEN, record, TRUE)
