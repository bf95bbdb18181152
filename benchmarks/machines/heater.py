"""Two coupled heaters; records by the simulator of the Temperature Control Lab, converter too."""

from __future__ import annotations

import contextlib
import io
import random as chance

import numba as nb
import numpy as np
from tclab.tclab import TCLabModel

from machines.machine import Array, Draw, Machine, steps
from saddlering_ros.discrepancy import Channel, Effect, Model, Parameter, Run

STEP, SUBSTEPS, FINE = 5.0, 5, 0.2
COUNT = 400
ROOM = 21.0
TRUE = {'power1': 200.0, 'power2': 100.0, 'loss': 1 / 20, 'exchange': 1 / 100, 'lag': 140.0}
CONSTANT = ('loss', 'exchange', 'lag')
"""Of the lab's model: rates [1/s], lag of the sensors [s]."""
PER_POWER = 5720.0
"""Percent of power that heat by 1 K/s."""


@nb.njit(cache=True)
def warm(drive, law):  # type: ignore[no-untyped-def]
    """Temperatures of the two sensors (2, N) by midpoint steps."""
    power1, power2, loss, exchange, lag, drift, radiation, crosstalk, weak = law
    seen = np.empty((2, drive.shape[1]))
    h1 = h2 = t1 = t2 = ROOM
    dt = STEP / SUBSTEPS
    base = (ROOM + 273.15) ** 4
    for n in range(drive.shape[1]):
        seen[0, n] = t1 + crosstalk * drive[0, n]
        seen[1, n] = t2
        for _ in range(SUBSTEPS):
            room = ROOM + drift * STEP * n
            a1, a2, b1, b2 = h1, h2, t1, t2
            for share in (0.5, 1.0):
                d1 = power1 * drive[0, n] * (1.0 - weak * (h1 - ROOM)) + loss * (room - h1)
                d2 = power2 * drive[1, n] + loss * (room - h2)
                d1 -= exchange * (h1 - h2) + radiation * ((h1 + 273.15) ** 4 - base)
                d2 += exchange * (h1 - h2) - radiation * ((h2 + 273.15) ** 4 - base)
                e1, e2 = (h1 - t1) / lag, (h2 - t2) / lag
                h1, h2 = a1 + share * dt * d1, a2 + share * dt * d2
                t1, t2 = b1 + share * dt * e1, b2 + share * dt * e2
    return seen


def simulate(p: dict[str, float], run: Run) -> dict[str, Array]:
    law = np.array([p['power1'] / PER_POWER, p['power2'] / PER_POWER, p['loss'], p['exchange'],
                    p['lag'], p['drift.rate'] / 3600.0, 1e-12 * p['radiation.size'],
                    p['crosstalk.size'], p['weak.share']])
    drive = np.array([run.inputs['heater1'], run.inputs['heater2']], dtype=np.float64)
    one, two = warm(drive, law)
    return {'T1': one, 'T2': two}


MODEL = Model(
    simulate,
    base={'power1': Parameter(100, 300), 'power2': Parameter(50, 150),
          'loss': Parameter(0.02, 0.1, unit='1/s'), 'exchange': Parameter(0.002, 0.03, unit='1/s'),
          'lag': Parameter(80, 220, unit='s')},
    effects={
        'drift': Effect('Room that warms up', {'rate': Parameter(-20, 20, unit='K/h')}),
        'radiation': Effect('Radiation', {'size': Parameter(0, 3000)}),
        'crosstalk': Effect('Current of heater 1 in reading 1',
                            {'size': Parameter(-0.1, 0.1, unit='K/%')}),
        'weak': Effect('Heater 1 weaker as it warms', {'share': Parameter(0, 0.02, unit='1/K')}),
    },
    channels={'T1': Channel(unit='degC', offset='free'),
              'T2': Channel(unit='degC', offset='free')},
)
HIDDEN = {'drift': {'rate': 4.0}, 'crosstalk': {'size': 0.02}, 'weak': {'share': 0.002}}
"""Radiation cannot be told from the base parameters at these temperatures: it is not hidden."""


def record(draw: Draw) -> Run:
    true, random = draw.true, draw.random
    drive = np.array([steps(random, COUNT, 5.0, 80.0, 40) for _ in range(2)])
    chance.seed(1000 * draw.seed + draw.number)
    with contextlib.redirect_stdout(io.StringIO()):
        lab = TCLabModel(synced=False)
    lab._P1, lab._P2, lab.tlast = true['power1'], true['power2'], 0.0
    radiation, weak = 1e-12 * draw.size('radiation.size'), draw.size('weak.share')
    seen = np.empty((2, COUNT))
    for n in range(COUNT):
        seen[:, n] = (
            lab.measurement(lab._T1 + draw.size('crosstalk.size') * drive[0, n]),
            lab.measurement(lab._T2))
        lab.Ta = ROOM + draw.size('drift.rate') / 3600.0 * STEP * n
        lab._Q2 = drive[1, n]
        for part in range(round(STEP / FINE)):
            lab._Q1 = drive[0, n] * (1.0 - weak * (lab._H1 - ROOM))
            lost = [radiation * ((h + 273.15) ** 4 - (ROOM + 273.15) ** 4)
                    for h in (lab._H1, lab._H2)]
            lab.update(STEP * n + FINE * (part + 1))
            lab._H1 -= FINE * lost[0]
            lab._H2 -= FINE * lost[1]
    return draw.run(STEP * np.arange(COUNT),
                    {'heater1': drive[0], 'heater2': drive[1]}, {'T1': seen[0], 'T2': seen[1]})


MACHINE = Machine('heater', 'tclab 1.0.0, TCLabModel', 'Apache-2.0', MODEL, HIDDEN, record, TRUE,
                  CONSTANT)
