"""A cooled stirred reactor; records by pcgym's cstr under scipy's LSODA."""

from __future__ import annotations

import numba as nb
import numpy as np
from scipy.integrate import solve_ivp

from machines.chemistry import process_models
from machines.machine import Array, Draw, Machine, noisy, steps
from saddlering_ros.discrepancy import Channel, Effect, Model, Parameter, Run

STEP, SUBSTEPS = 0.05, 4
COUNT = 500
FLOW, VOLUME, HEAT_CAPACITY, HEAT, ACTIVATION = 100.0, 100.0, 239.0, 5.0e4, 8750.0
"""Litres a minute, litres, J / l K, J / mol, K."""
ROOM = 295.0
TRUE = {'rate': 7.2, 'cooling': 5.0, 'feed': 350.0}
"""Rate constant [1e10 / min], conductance to the coolant [1e4 J / min K], temperature [K]."""
LINES = process_models()


@nb.njit(cache=True)
def react(coolant, start, law):  # type: ignore[no-untyped-def]
    """Concentration, temperature and its thermometer (3, N) by midpoint steps."""
    constant, conductance, feed, fouling, decay, loss, lag = law
    seen = np.empty((3, coolant.size))
    c, t = start
    s = t
    dt = STEP / SUBSTEPS
    for n in range(coolant.size):
        seen[0, n], seen[1, n], seen[2, n] = c, t, s
        age = STEP * n
        clean = conductance / (1.0 + fouling * age)
        alive = constant * np.exp(-decay * age)
        for _ in range(SUBSTEPS):
            c0, t0, s0 = c, t, s
            for share in (0.5, 1.0):
                burnt = alive * np.exp(-ACTIVATION / t) * c
                heat = FLOW / VOLUME * (feed - t) + HEAT / HEAT_CAPACITY * burnt
                heat += clean / (HEAT_CAPACITY * VOLUME) * (coolant[n] - t)
                heat -= loss / (HEAT_CAPACITY * VOLUME) * (t - ROOM)
                used = FLOW / VOLUME * (1.0 - c) - burnt
                late = (t - s) / lag if lag > 0.02 else (t - s) / 0.02
                c, t, s = c0 + share * dt * used, t0 + share * dt * heat, s0 + share * dt * late
    return seen


def simulate(p: dict[str, float], run: Run) -> dict[str, Array]:
    law = np.array([1e10 * p['rate'], 1e4 * p['cooling'], p['feed'], p['fouling.rate'],
                    p['decay.rate'], 1e4 * p['loss.conductance'], p['lag.time']])
    seen = react(np.asarray(run.inputs['coolant']), np.asarray(run.inputs['start']), law)
    return {'concentration': seen[0], 'temperature': seen[2 if p['lag.time'] > 0.0 else 1]}


MODEL = Model(
    simulate,
    base={'rate': Parameter(3, 15, scale='log'), 'cooling': Parameter(2, 10),
          'feed': Parameter(340, 360, unit='K')},
    effects={
        'fouling': Effect('Fouling of the cooling', {'rate': Parameter(0, 0.05, unit='1/min')}),
        'decay': Effect('Catalyst that wears', {'rate': Parameter(0, 0.05, unit='1/min')}),
        'loss': Effect('Heat lost to the room', {'conductance': Parameter(0, 2)}),
        'lag': Effect('Slow thermometer', {'time': Parameter(0, 2, unit='min')}),
    },
    channels={'concentration': Channel(unit='mol/l'), 'temperature': Channel(unit='K')},
)
HIDDEN = {'fouling': {'rate': 0.004}, 'decay': {'rate': 0.003}, 'loss': {'conductance': 0.4},
          'lag': {'time': 0.25}}


def record(draw: Draw) -> Run:
    true, random = draw.true, draw.random
    coolant = steps(random, COUNT, 285.0, 299.0, 60)
    plant = LINES.cstr(int_method='numpy')
    reached = start = np.array([0.9, 322.0])
    seen = np.empty((2, COUNT))
    loss = 1e4 * draw.size('loss.conductance') / (HEAT_CAPACITY * VOLUME)
    for n in range(COUNT):
        seen[:, n] = reached
        age = STEP * n
        plant.UA = 1e4 * true['cooling'] / (1.0 + draw.size('fouling.rate') * age)
        plant.k0 = 1e10 * true['rate'] * np.exp(-draw.size('decay.rate') * age)
        drive = np.array([coolant[n], true['feed'], 1.0])

        def change(_: float, now: Array, drive: Array = drive) -> Array:
            rate = np.array(plant(now, drive))
            rate[1] -= loss * (now[1] - ROOM)
            return rate

        reached = solve_ivp(change, (0.0, STEP), reached, 'LSODA', rtol=1e-8, atol=1e-9).y[:, -1]
    lag, temperature = draw.size('lag.time'), seen[1]
    if lag > 0.0:  # the exact answer of a first-order lag to a course that is straight by parts
        keep = np.exp(-STEP / lag)
        slope = np.diff(temperature)
        shown = temperature.copy()
        for n in range(1, COUNT):
            ahead = slope[n - 1] * lag / STEP
            shown[n] = temperature[n] - ahead + keep * (shown[n - 1] - temperature[n - 1] + ahead)
        temperature = shown
    return draw.run(STEP * np.arange(COUNT), {'coolant': coolant, 'start': start},
                    {'concentration': noisy(random, seen[0]),
                    'temperature': noisy(random, temperature)})


MACHINE = Machine('reactor', 'pcgym 0.1.8, cstr', 'MIT', MODEL, HIDDEN, record, TRUE,
                  constant=('feed',))
