"""A motor whose windings warm, magnet saturates and rotor loses; the model has none of it."""

import numba as nb
import numpy as np

from machines.machine import Draw, hides, own_machine, steps
from saddlering_ros.discrepancy import Channel, Parameter, Run

STEP, COUNT = 0.01, 800


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


def record(draw: Draw) -> Run:
    time = STEP * np.arange(COUNT)
    warm, saturation, iron = np.abs(draw.own.normal(size=3)) * (0.3, 1e-4, 1.0)
    voltage = steps(draw.random, COUNT, -12.0, 12.0, 60)
    law = draw.law(draw.own.uniform(5e-4, 2e-3), warm, saturation, iron)
    return draw.run(time, {'voltage': voltage}, spin(voltage, law, 80))


MACHINE = own_machine(
    'motor', record, spin,
    base={'resistance': (1.2, Parameter(0.5, 3, unit='Ohm')),
          'constant': (0.08, Parameter(0.03, 0.2, unit='V s')),
          'inertia': (4e-4, Parameter(1e-4, 2e-3, unit='kg m^2')),
          'viscous': (8e-4, Parameter(1e-5, 5e-3, unit='N m s'))},
    effects={
        'coulomb': hides('Dry friction', 0.04, torque=Parameter(0, 0.2, unit='N m')),
        'load': hides('A fan on the shaft', 10.0, size=Parameter(0, 60, unit='uN m s^2')),
        'brush': hides('Voltage across the brushes', 0.8, voltage=Parameter(0, 4, unit='V')),
    },
    channels={'current': Channel(unit='A'), 'speed': Channel(unit='rad/s')},
    lacks=(1e-6, 0.0, 0.0, 0.0), parts=8)
