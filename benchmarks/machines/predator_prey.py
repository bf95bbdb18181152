"""Prey and predators; records of the Rosenzweig-MacArthur equations by scipy's LSODA."""

from __future__ import annotations

import numba as nb
import numpy as np
from scipy.integrate import solve_ivp

from machines.machine import Array, Draw, Machine, noisy
from saddlering_ros.discrepancy import Channel, Effect, Model, Parameter, Run

STEP, SUBSTEPS = 0.1, 4
COUNT = 250
TRUE = {'birth': 0.9, 'attack': 0.05, 'gain': 0.5, 'death': 0.6}


@nb.njit(cache=True)
def live(start, law):  # type: ignore[no-untyped-def]
    """Prey and predators (2, N) by midpoint steps."""
    birth, attack, gain, death, crowding, handling, catch, arrival = law
    seen = np.empty((2, COUNT))
    x, y = start
    dt = STEP / SUBSTEPS
    for n in range(COUNT):
        seen[0, n], seen[1, n] = x, y
        for _ in range(SUBSTEPS):
            x0, y0 = x, y
            for share in (0.5, 1.0):
                eaten = attack * x * y / (1.0 + attack * handling * x)
                grown = birth * x * (1.0 - crowding * x) - eaten + arrival
                bred = gain * eaten - death * y - catch
                x, y = x0 + share * dt * grown, y0 + share * dt * bred
    return seen


def simulate(p: dict[str, float], run: Run) -> dict[str, Array]:
    law = np.array([p['birth'], p['attack'], p['gain'], p['death'], p['crowding.size'],
                    p['handling.time'], p['catch.rate'], p['arrival.rate']])
    start = np.array([float(str(run.inputs[name])) for name in ('prey', 'predators')])
    seen = live(start, law)
    return {'prey': seen[0], 'predators': seen[1]}


MODEL = Model(
    simulate,
    base={'birth': Parameter(0.3, 2, unit='1/year'), 'attack': Parameter(0.02, 0.12, scale='log'),
          'gain': Parameter(0.2, 1.2), 'death': Parameter(0.2, 1.5, unit='1/year')},
    effects={
        'crowding': Effect('Prey limited by its food', {'size': Parameter(0, 0.02)}),
        'handling': Effect('Predators that have enough', {'time': Parameter(0, 1, unit='year')}),
        'catch': Effect('Predators that are caught', {'rate': Parameter(0, 4, unit='1/year')}),
        'arrival': Effect('Prey that comes in', {'rate': Parameter(0, 6, unit='1/year')}),
    },
    channels={'prey': Channel(), 'predators': Channel()},
)
HIDDEN = {'crowding': {'size': 0.0015}, 'handling': {'time': 0.08}, 'catch': {'rate': 0.3},
          'arrival': {'rate': 0.5}}


def record(draw: Draw) -> Run:
    true, random = draw.true, draw.random
    start = np.array([random.uniform(18.0, 45.0), random.uniform(10.0, 25.0)])
    crowding, handling, catch, arrival = (draw.size(name) for name in (
        'crowding.size', 'handling.time', 'catch.rate', 'arrival.rate'))

    def change(_: float, logs: Array) -> list[float]:
        """Growth of the logarithms: half saturation and capacity as ecologists write them."""
        prey, predators = np.exp(logs)
        hunted = true['attack'] * predators / (1.0 + true['attack'] * handling * prey)
        fed = true['gain'] * hunted / predators * prey
        return [true['birth'] * (1.0 - crowding * prey) - hunted + arrival / prey,
                fed - true['death'] - catch / predators]

    time = STEP * np.arange(COUNT)
    found = solve_ivp(change, (0.0, time[-1]), np.log(start), 'LSODA', time, rtol=1e-9, atol=1e-10)
    prey, predators = np.exp(found.y)
    return draw.run(time, {'prey': start[0], 'predators': start[1]},
                    {'prey': noisy(random, prey, 0.01),
                     'predators': noisy(random, predators, 0.01)})


MACHINE = Machine(
    'predator_prey', 'Rosenzweig and MacArthur, American Naturalist 97 (1963) 209; scipy LSODA',
    'equations', MODEL, HIDDEN, record, TRUE)
