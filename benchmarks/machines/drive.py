"""A belt drive under a torque; its records hold ripple, a lag of the current and a soft belt."""

import numba as nb
import numpy as np

from machines.machine import Draw, hides, own_machine, swings
from saddlering_ros.discrepancy import Channel, Parameter, Run

STEP, COUNT = 0.01, 900


@nb.njit(cache=True)
def turn(torque, law, parts):  # type: ignore[no-untyped-def]
    """Speed and angle of the load (2, N) [rad/s, rad]."""
    inertia, viscous, dry, extra, fall, ripple, unequal, rate, lag, cog, heavy, heat = law
    seen, dt = np.empty((2, torque.size)), STEP / parts
    w = a = given = 0.0
    for n in range(torque.size):
        seen[0, n], seen[1, n] = w, a
        for _ in range(parts):
            given += (torque[n] - given) * (dt / lag if lag > dt else 1.0)
            w0, a0 = w, a
            for share in (0.5, 1.0):
                friction = dry + extra * np.exp(-(w / max(fall, 1e-3)) ** 2)
                lost = viscous * (1.0 - heat * n / torque.size) * w + friction * np.tanh(w / 0.1)
                lost += unequal * viscous * abs(w) + rate * a + ripple * np.sin(6.0 * a)
                lost += cog * np.sin(14.0 * a + 1.0) + heavy * np.sin(a)
                w, a = w0 + share * dt * (given - lost) / inertia, a0 + share * dt * w
    return seen


def record(draw: Draw) -> Run:
    time = STEP * np.arange(COUNT)
    cog, heavy, heat = draw.own.normal(size=3) * (0.006, 0.006, 0.04)
    torque = 0.45 * swings(draw.random, time, 0.15, 2.0)
    law = draw.law(draw.own.uniform(0.002, 0.01), cog, heavy, heat)
    return draw.run(time, {'torque': torque}, turn(torque, law, 20))


MACHINE = own_machine(
    'drive', record, turn,
    base={'inertia': (0.02, Parameter(0.005, 0.06, unit='kg m^2')),
          'viscous': (0.05, Parameter(0.005, 0.3, unit='N m s/rad'))},
    effects={
        'coulomb': hides('Dry friction', 0.06, torque=Parameter(0, 0.4, unit='N m')),
        'stribeck': hides('Friction that falls with speed', 0.12, 1.5, contains=('coulomb',),
                          torque=Parameter(0, 0.4, unit='N m'),
                          speed=Parameter(0.2, 6, unit='rad/s')),
        'ripple': hides('Torque ripple', 0.12, torque=Parameter(-0.4, 0.4, unit='N m')),
        'unequal': hides('Loss unlike in both directions', 0.25, share=Parameter(-0.9, 0.9)),
        'spring': hides('Cable that pulls', 0.02, rate=Parameter(-0.05, 0.2, unit='N m/rad')),
    },
    channels={'speed': Channel(unit='rad/s'), 'angle': Channel(unit='rad')},
    lacks=(0.0, 0.0, 0.0, 0.0), parts=2)
