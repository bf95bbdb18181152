"""A belt drive under a torque; its records hold ripple, a lag of the current and a soft belt."""

from __future__ import annotations

import numba as nb
import numpy as np

from machines.machine import Array, Draw, Machine, noisy, swings
from saddlering_ros.discrepancy import Channel, Effect, Model, Parameter, Run

STEP, COUNT = 0.01, 900
TRUE = {'inertia': 0.02, 'viscous': 0.05}
NAMES = ('coulomb.torque', 'stribeck.torque', 'stribeck.speed', 'ripple.torque', 'unequal.share',
         'spring.rate')


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


def simulate(p: dict[str, float], run: Run) -> dict[str, Array]:
    law = np.array([p['inertia'], p['viscous'], *(p[name] for name in NAMES), 0.0, 0.0, 0.0, 0.0])
    speed, angle = turn(np.asarray(run.inputs['torque']), law, 2)
    return {'speed': speed, 'angle': angle}


MODEL = Model(
    simulate,
    base={'inertia': Parameter(0.005, 0.06, unit='kg m^2'),
          'viscous': Parameter(0.005, 0.3, unit='N m s/rad')},
    effects={
        'coulomb': Effect('Dry friction', {'torque': Parameter(0, 0.4, unit='N m')}),
        'stribeck': Effect('Friction that falls with speed', {
            'torque': Parameter(0, 0.4, unit='N m'), 'speed': Parameter(0.2, 6, unit='rad/s')},
            contains=('coulomb',)),
        'ripple': Effect('Torque ripple', {'torque': Parameter(-0.4, 0.4, unit='N m')}),
        'unequal': Effect('Loss unlike in both directions', {'share': Parameter(-0.9, 0.9)}),
        'spring': Effect('Cable that pulls', {'rate': Parameter(-0.05, 0.2, unit='N m/rad')}),
    },
    channels={'speed': Channel(unit='rad/s'), 'angle': Channel(unit='rad')},
)
HIDDEN = {'coulomb': {'torque': 0.06}, 'stribeck': {'torque': 0.12, 'speed': 1.5},
          'ripple': {'torque': 0.12}, 'unequal': {'share': 0.25}, 'spring': {'rate': 0.02}}


def record(draw: Draw) -> Run:
    time, own = STEP * np.arange(COUNT), np.random.default_rng([draw.seed, 7])
    cog, heavy, heat = own.normal(size=3) * (0.006, 0.006, 0.04)
    torque = 0.45 * swings(draw.random, time, 0.15, 2.0)
    law = np.array([draw.true['inertia'], draw.true['viscous'],
                    *(draw.size(name) for name in NAMES), own.uniform(0.002, 0.01), cog, heavy,
                    heat])
    speed, angle = turn(torque, law, 20)
    return draw.run(time, {'torque': torque}, {'speed': noisy(draw.random, speed),
                                               'angle': noisy(draw.random, angle)})


MACHINE = Machine('drive', 'written for this benchmark', 'of this repository', MODEL, HIDDEN,
                  record, TRUE)
