"""A motor whose windings warm, magnet saturates and rotor loses; the model has none of it."""

from __future__ import annotations

import numba as nb
import numpy as np

from machines.machine import Array, Draw, Machine, noisy, steps
from saddlering_ros.discrepancy import Channel, Effect, Model, Parameter, Run

STEP, COUNT = 0.01, 800
TRUE = {'resistance': 1.2, 'constant': 0.08, 'inertia': 4e-4, 'viscous': 8e-4}
NAMES = ('coulomb.torque', 'load.size', 'brush.voltage')


@nb.njit(cache=True)
def spin(voltage, law, parts):  # type: ignore[no-untyped-def]
    """Current and speed (2, N) [A, rad/s]."""
    r, k, inertia, viscous, dry, fan, brush, henry, warm, saturation, iron = law
    seen, dt = np.empty((2, voltage.size)), STEP / parts
    i = w = heat = 0.0
    for n in range(voltage.size):
        for _ in range(parts):
            ohm = r * (1.0 + heat)
            flux = k / (1.0 + saturation * i * i)
            drives = voltage[n] - flux * w
            steady = (drives - min(max(drives, -brush), brush)) / ohm
            i += (steady - i) * min(1.0, dt * ohm / henry)
            lost = viscous * w + dry * np.tanh(w / 2.0) + 1e-6 * (fan + iron) * w * abs(w)
            w += dt * (flux * i - lost) / inertia
            heat += dt * warm * (0.02 * ohm * i * i - heat)
        seen[0, n], seen[1, n] = i, w
    return seen


def simulate(p: dict[str, float], run: Run) -> dict[str, Array]:
    law = np.array([p['resistance'], p['constant'], p['inertia'], p['viscous'],
                    *(p[name] for name in NAMES), 1e-6, 0.0, 0.0, 0.0])
    current, speed = spin(np.asarray(run.inputs['voltage']), law, 8)
    return {'current': current, 'speed': speed}


MODEL = Model(
    simulate,
    base={'resistance': Parameter(0.5, 3, unit='Ohm'),
          'constant': Parameter(0.03, 0.2, unit='V s'),
          'inertia': Parameter(1e-4, 2e-3, unit='kg m^2'),
          'viscous': Parameter(1e-5, 5e-3, unit='N m s')},
    effects={
        'coulomb': Effect('Dry friction', {'torque': Parameter(0, 0.2, unit='N m')}),
        'load': Effect('A fan on the shaft', {'size': Parameter(0, 60, unit='uN m s^2')}),
        'brush': Effect('Voltage across the brushes', {'voltage': Parameter(0, 4, unit='V')}),
    },
    channels={'current': Channel(unit='A'), 'speed': Channel(unit='rad/s')},
)
HIDDEN = {'coulomb': {'torque': 0.04}, 'load': {'size': 10.0}, 'brush': {'voltage': 0.8}}


def record(draw: Draw) -> Run:
    time, own = STEP * np.arange(COUNT), np.random.default_rng([draw.seed, 7])
    warm, saturation, iron = np.abs(own.normal(size=3)) * (0.3, 1e-4, 1.0)
    voltage = steps(draw.random, COUNT, -12.0, 12.0, 60)
    law = np.array([*(draw.true[name] for name in TRUE), *(draw.size(name) for name in NAMES),
                    own.uniform(5e-4, 2e-3), warm, saturation, iron])
    current, speed = spin(voltage, law, 80)
    return draw.run(time, {'voltage': voltage}, {'current': noisy(draw.random, current),
                                                 'speed': noisy(draw.random, speed)})


MACHINE = Machine('motor', 'written for this benchmark', 'of this repository', MODEL, HIDDEN,
                  record, TRUE)
