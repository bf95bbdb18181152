"""A torque-driven pendulum; records by gymnasium's Pendulum-v1 at steps of 0.5 ms."""

from gymnasium.envs.classic_control.pendulum import PendulumEnv
import numba as nb
import numpy as np

from machines.machine import Draw, hides, own_machine, swings
from saddlering_ros.discrepancy import Channel, Parameter, Run

STEP, FINE, COUNT = 0.02, 5e-4, 1000


@nb.njit(cache=True)
def swing(torque, law, parts):  # type: ignore[no-untyped-def]
    """Angle from hanging (1, N): midpoint steps, the torque held between samples."""
    gravity, gain, viscous, friction, drag, spring, bias = law
    angle, dt = np.empty((1, torque.size)), STEP / parts
    place = speed = 0.0
    for n in range(torque.size):
        angle[0, n] = place
        for _ in range(parts):
            old_place, old_speed = place, speed
            for share in (0.5, 1.0):
                force = gain * torque[n] - gravity * np.sin(place) - viscous * speed
                force += bias - spring * place - drag * speed * abs(speed)
                force -= friction * np.tanh(speed / 0.01)
                place, speed = old_place + share * dt * speed, old_speed + share * dt * force
    return angle


def record(draw: Draw) -> Run:
    time, environment, angle = STEP * np.arange(COUNT), PendulumEnv(), np.empty((1, COUNT))
    gravity, gain, viscous, friction, drag, spring, bias = draw.law()
    torque = 1.1 * swings(draw.random, time, 0.15, 0.9)
    environment.max_torque = environment.max_speed = 1e6
    environment.dt, environment.l, environment.m, environment.g = FINE, 1.0, 1.0, gravity * 2 / 3
    environment.state, environment.last_u = np.array([np.pi, 0.0]), 0.0
    for n in range(COUNT):
        angle[0, n] = environment.state[0] - np.pi
        for _ in range(round(STEP / FINE)):
            place, speed = environment.state[0] - np.pi, environment.state[1]
            pull = gain * torque[n] + bias - (viscous * speed + spring * place)
            pull -= drag * speed * abs(speed)
            grip = speed / FINE + pull - gravity * np.sin(place)  # would stop it
            environment.step(np.array([(pull - min(max(grip, -friction), friction)) / 3.0]))
    return draw.run(time, {'torque': torque}, angle)


MACHINE = own_machine(
    'pendulum', record, swing, source='gymnasium 1.4.0, Pendulum-v1', licence='MIT',
    base={'gravity': (15.0, Parameter(8, 25, unit='1/s^2')), 'gain': (3.0, Parameter(1, 6)),
          'viscous': (0.35, Parameter(0, 2, unit='1/s'))},
    effects={
        'friction': hides('Dry friction of the bearing', 0.4, torque=Parameter(0, 4)),
        'drag': hides('Drag that grows with the square of speed', 0.12, size=Parameter(0, 1)),
        'spring': hides('Cable that winds up', 1.5, rate=Parameter(0, 10)),
        'bias': hides('Torque beside the one commanded', 0.3, torque=Parameter(-3, 3)),
    },
    channels={'angle': Channel(unit='rad')}, lacks=(), parts=8)
