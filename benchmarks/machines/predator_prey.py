"""Prey and predators; records of the Rosenzweig-MacArthur equations by scipy's LSODA."""

import numba as nb
import numpy as np
from scipy.integrate import solve_ivp

from machines.machine import Array, Draw, hides, own_machine
from saddlering_ros.discrepancy import Channel, Parameter, Run

STEP, COUNT = 0.1, 250


@nb.njit(cache=True)
def live(prey, predators, law, parts):  # type: ignore[no-untyped-def]
    """Prey and predators (2, N) by midpoint steps from their first numbers."""
    birth, attack, gain, death, crowding, handling, catch, arrival = law
    seen, dt = np.empty((2, COUNT)), STEP / parts
    x, y = prey, predators
    for n in range(COUNT):
        seen[0, n], seen[1, n] = x, y
        for _ in range(parts):
            x0, y0 = x, y
            for share in (0.5, 1.0):
                eaten = attack * x * y / (1.0 + attack * handling * x)
                grown = birth * x * (1.0 - crowding * x) - eaten + arrival
                bred = gain * eaten - death * y - catch
                x, y = x0 + share * dt * grown, y0 + share * dt * bred
    return seen


def record(draw: Draw) -> Run:
    start = np.array([draw.random.uniform(18.0, 45.0), draw.random.uniform(10.0, 25.0)])
    birth, attack, gain, death, crowding, handling, catch, arrival = draw.law()

    def change(_: float, logs: Array) -> list[float]:
        """Growth of the logarithms: half saturation and capacity as ecologists write them."""
        prey, predators = np.exp(logs)
        hunted = attack * predators / (1.0 + attack * handling * prey)
        return [birth * (1.0 - crowding * prey) - hunted + arrival / prey,
                gain * hunted / predators * prey - death - catch / predators]

    time = STEP * np.arange(COUNT)
    found = solve_ivp(change, (0.0, time[-1]), np.log(start), 'LSODA', time, rtol=1e-9, atol=1e-10)
    return draw.run(time, {'prey': start[0], 'predators': start[1]}, np.exp(found.y), noise=0.01)


MACHINE = own_machine(
    'predator_prey', record, live, licence='equations',
    source='Rosenzweig and MacArthur, American Naturalist 97 (1963) 209; scipy LSODA',
    base={'birth': (0.9, Parameter(0.3, 2, unit='1/year')),
          'attack': (0.05, Parameter(0.02, 0.12, scale='log')),
          'gain': (0.5, Parameter(0.2, 1.2)), 'death': (0.6, Parameter(0.2, 1.5, unit='1/year'))},
    effects={
        'crowding': hides('Prey limited by its food', 0.0015, size=Parameter(0, 0.02)),
        'handling': hides('Predators that have enough', 0.08, time=Parameter(0, 1, unit='year')),
        'catch': hides('Predators that are caught', 0.3, rate=Parameter(0, 4, unit='1/year')),
        'arrival': hides('Prey that comes in', 0.5, rate=Parameter(0, 6, unit='1/year')),
    },
    channels={'prey': Channel(), 'predators': Channel()}, lacks=(), parts=4)
