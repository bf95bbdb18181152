"""An oscillator that a force drives; its records hold a bent spring, slip and a bent sensor."""

from __future__ import annotations

import numba as nb
import numpy as np

from machines.machine import Array, Draw, Machine, noisy, swings
from saddlering_ros.discrepancy import Channel, Effect, Model, Parameter, Run

STEP, COUNT = 0.02, 800
TRUE = {'stiffness': 100.0, 'damping': 1.0}
NAMES = ('hysteresis.force', 'hysteresis.travel', 'cubic.size', 'gap.width', 'coulomb.force',
         'quadratic.size')


@nb.njit(cache=True)
def swing(force, law, parts):  # type: ignore[no-untyped-def]
    """Displacement (N,) of 1 kg by midpoint steps."""
    stiffness, damping, loop, travel, cubic, gap, dry, quadratic, bent, drag = law
    seen, dt = np.empty(force.size), STEP / parts
    x = v = z = 0.0
    for n in range(force.size):
        seen[n] = x
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


def simulate(p: dict[str, float], run: Run) -> dict[str, Array]:
    law = np.array([p['stiffness'], p['damping'], *(p[name] for name in NAMES), 0.0, 0.0])
    return {'x': swing(np.asarray(run.inputs['force']), law, 4)}


MODEL = Model(
    simulate,
    base={'stiffness': Parameter(40, 250, unit='N/m'), 'damping': Parameter(0.1, 6, unit='N s/m')},
    effects={
        'hysteresis': Effect('Hysteresis', {
            'force': Parameter(0, 40, unit='N'), 'travel': Parameter(0.02, 0.4, unit='m')}),
        'cubic': Effect('Spring that hardens', {'size': Parameter(-150, 1000, unit='N/m^3')}),
        'gap': Effect('Dead zone', {'width': Parameter(0, 0.3, unit='m')}),
        'coulomb': Effect('Dry friction', {'force': Parameter(0, 10, unit='N')}),
        'quadratic': Effect('Drag by the square of speed', {'size': Parameter(0, 5)}),
    },
    channels={'x': Channel(unit='m')},
)
HIDDEN = {'hysteresis': {'force': 8.0, 'travel': 0.08}, 'cubic': {'size': 200.0},
          'gap': {'width': 0.06}, 'coulomb': {'force': 1.5}, 'quadratic': {'size': 0.8}}


def record(draw: Draw) -> Run:
    time, own = STEP * np.arange(COUNT), np.random.default_rng([draw.seed, 7])
    bent, drag, curve, gain = own.normal(size=4) * (6.0, 0.15, 0.006, 0.02)
    force = 18.0 * swings(draw.random, time, 0.3, 2.5)
    law = np.array([draw.true['stiffness'], draw.true['damping'],
                    *(draw.size(name) for name in NAMES), bent, abs(drag)])
    seen = swing(force * (1.0 + gain * np.abs(force) / 30.0), law, 40)
    seen = seen + curve * (seen / np.abs(seen).max()) ** 2 * np.abs(seen).max()
    return draw.run(time, {'force': force}, {'x': noisy(draw.random, seen)})


MACHINE = Machine('oscillator', 'written for this benchmark', 'of this repository', MODEL, HIDDEN,
                  record, TRUE)
