"""Two tanks in a row; the pump of the records bends, lags and tires, and no valve is ideal."""

from __future__ import annotations

import numba as nb
import numpy as np

from machines.machine import Array, Draw, Machine, noisy, steps
from saddlering_ros.discrepancy import Channel, Effect, Model, Parameter, Run

STEP, COUNT = 2.0, 700
TRUE = {'pump': 0.02, 'between': 0.012, 'outlet': 0.011}
NAMES = ('leak.area', 'clog.share', 'gauge.gain', 'offset.flow')


@nb.njit(cache=True)
def fill(drive, law, parts):  # type: ignore[no-untyped-def]
    """Levels of both tanks (2, N) [m]; each has 1 m^2."""
    pump, between, outlet, leak, clog, gauge, more, lag, bend, tired, power = law
    seen, dt = np.empty((2, drive.size)), STEP / parts
    one, two, given = 0.5, 0.4, drive[0]
    for n in range(drive.size):
        seen[0, n], seen[1, n] = one, two * (1.0 + gauge)
        for _ in range(parts):
            given += (drive[n] - given) * (min(1.0, dt / lag) if lag > 0.0 else 1.0)
            flow = pump * given * (1.0 + bend * given) * (1.0 - tired * n / drive.size) + more
            high, low = max(one, 0.0), max(two, 0.0)
            middle = between * (1.0 - clog * min(high, 1.0)) * high ** (0.5 + power)
            one += dt * (flow - middle - leak * high**0.5)
            two += dt * (middle - outlet * low ** (0.5 + power))
    return seen


def simulate(p: dict[str, float], run: Run) -> dict[str, Array]:
    law = np.array([p['pump'], p['between'], p['outlet'], *(p[name] for name in NAMES),
                    0.0, 0.0, 0.0, 0.0])
    one, two = fill(np.asarray(run.inputs['drive']), law, 2)
    return {'upper': one, 'lower': two}


MODEL = Model(
    simulate,
    base={'pump': Parameter(0.005, 0.06), 'between': Parameter(0.004, 0.04),
          'outlet': Parameter(0.004, 0.04)},
    effects={
        'leak': Effect('Leak of the upper tank', {'area': Parameter(0, 0.01)}),
        'clog': Effect('Valve that clogs with the level', {'share': Parameter(-0.3, 0.8)}),
        'gauge': Effect('Gain of the lower gauge', {'gain': Parameter(-0.3, 0.3)}),
        'offset': Effect('Flow from elsewhere', {'flow': Parameter(-0.004, 0.004, unit='m^3/s')}),
    },
    channels={'upper': Channel(unit='m'), 'lower': Channel(unit='m')},
)
HIDDEN = {'leak': {'area': 0.0015}, 'clog': {'share': 0.2}, 'gauge': {'gain': 0.08},
          'offset': {'flow': 0.0008}}


def record(draw: Draw) -> Run:
    time, own = STEP * np.arange(COUNT), np.random.default_rng([draw.seed, 7])
    bend, tired, power = own.normal(size=3) * (0.02, 0.01, 0.01)
    drive = steps(draw.random, COUNT, 0.1, 1.0, 40)
    law = np.array([*(draw.true[name] for name in TRUE), *(draw.size(name) for name in NAMES),
                    own.uniform(0.5, 4.0), bend, tired, power])
    upper, lower = fill(drive, law, 20)
    return draw.run(time, {'drive': drive}, {'upper': noisy(draw.random, upper),
                                             'lower': noisy(draw.random, lower)})


MACHINE = Machine('tank', 'written for this benchmark', 'of this repository', MODEL, HIDDEN,
                  record, TRUE)
