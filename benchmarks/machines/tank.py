"""Two tanks in a row; the pump of the records bends, lags and tires, and no valve is ideal."""

import numba as nb
import numpy as np

from machines.machine import Draw, hides, own_machine, steps
from saddlering_ros.discrepancy import Channel, Parameter, Run

STEP, COUNT = 2.0, 700


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


def record(draw: Draw) -> Run:
    time = STEP * np.arange(COUNT)
    bend, tired, power = draw.own.normal(size=3) * (0.02, 0.01, 0.01)
    drive = steps(draw.random, COUNT, 0.1, 1.0, 40)
    law = draw.law(draw.own.uniform(0.5, 4.0), bend, tired, power)
    return draw.run(time, {'drive': drive}, fill(drive, law, 20))


MACHINE = own_machine(
    'tank', record, fill,
    base={'pump': (0.02, Parameter(0.005, 0.06)), 'between': (0.012, Parameter(0.004, 0.04)),
          'outlet': (0.011, Parameter(0.004, 0.04))},
    effects={
        'leak': hides('Leak of the upper tank', 0.0015, area=Parameter(0, 0.01)),
        'clog': hides('Valve that clogs with the level', 0.2, share=Parameter(-0.3, 0.8)),
        'gauge': hides('Gain of the lower gauge', 0.08, gain=Parameter(-0.3, 0.3)),
        'offset': hides('Flow from elsewhere', 0.0008,
                        flow=Parameter(-0.004, 0.004, unit='m^3/s')),
    },
    channels={'upper': Channel(unit='m'), 'lower': Channel(unit='m')},
    lacks=(0.0, 0.0, 0.0, 0.0), parts=2)
