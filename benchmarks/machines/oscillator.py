"""An oscillator that a force drives; its records hold a bent spring, slip and a bent sensor."""

import numba as nb
import numpy as np

from machines.machine import Draw, hides, own_machine, swings
from saddlering_ros.discrepancy import Channel, Parameter, Run

STEP, COUNT = 0.02, 800


@nb.njit(cache=True)
def swing(force, law, parts):  # type: ignore[no-untyped-def]
    """Displacement (1, N) of 1 kg by midpoint steps."""
    stiffness, damping, loop, travel, cubic, gap, dry, quadratic, bent, drag = law
    seen, dt = np.empty((1, force.size)), STEP / parts
    x = v = z = 0.0
    for n in range(force.size):
        seen[0, n] = x
        for _ in range(parts):
            x0, v0, z0 = x, v, z
            for share in (0.5, 1.0):
                spring = stiffness * (x - gap * np.tanh(x / max(gap, 1e-9))) + cubic * x**3
                spring += bent * x * x + loop * z
                slow = damping * v + quadratic * v * abs(v) + dry * np.tanh(v / 0.02)
                slow += drag * np.tanh(v / 0.2)
                slip = (v - abs(v) * abs(z) * z) / max(travel, 1e-9)
                x, v, z = (x0 + share * dt * v, v0 + share * dt * (force[n] - spring - slow),
                           min(max(z0 + share * dt * slip, -1.5), 1.5))
    return seen


def record(draw: Draw) -> Run:
    time = STEP * np.arange(COUNT)
    bent, drag, curve, gain = draw.own.normal(size=4) * (6.0, 0.15, 0.006, 0.02)
    force = 18.0 * swings(draw.random, time, 0.3, 2.5)
    seen = swing(force * (1.0 + gain * np.abs(force) / 30.0), draw.law(bent, abs(drag)), 40)
    seen = seen + curve * (seen / np.abs(seen).max()) ** 2 * np.abs(seen).max()
    return draw.run(time, {'force': force}, seen)


MACHINE = own_machine(
    'oscillator', record, swing,
    base={'stiffness': (100.0, Parameter(40, 250, unit='N/m')),
          'damping': (1.0, Parameter(0.1, 6, unit='N s/m'))},
    effects={
        'hysteresis': hides('Hysteresis', 8.0, 0.08, force=Parameter(0, 40, unit='N'),
                            travel=Parameter(0.02, 0.4, unit='m')),
        'cubic': hides('Spring that hardens', 200.0, size=Parameter(-150, 1000, unit='N/m^3')),
        'gap': hides('Dead zone', 0.06, width=Parameter(0, 0.3, unit='m')),
        'coulomb': hides('Dry friction', 1.5, force=Parameter(0, 10, unit='N')),
        'quadratic': hides('Drag by the square of speed', 0.8, size=Parameter(0, 5)),
    },
    channels={'x': Channel(unit='m')}, lacks=(0.0, 0.0), parts=4)
