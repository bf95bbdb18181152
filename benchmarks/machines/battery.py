"""Cells that age, as NASA Ames recorded them (Saha and Goebel 2007): discharges of 1 A at 4 °C.

BATTERIES is the folder of B0045.mat to B0048.mat and B0053.mat. The model is the mean of early
discharges of the same cell. Cell B0046 is for development, the others are sealed.
"""

from __future__ import annotations

from functools import cache, partial
import os
from pathlib import Path

import numpy as np
from scipy.io import loadmat

from machines.machine import Array, Records, Trial
from saddlering_ros.discrepancy import Channel, Effect, Model, Parameter, Run

CELLS = {161000: ('B0045', 'B0053'), 154000: ('B0047', 'B0048'), 0: ('B0046', 'B0046')}
"""Cells by the first number of their trials."""

NEW, SOUND, AGED = range(4, 8), (8, 11), (20, 66)
"""Discharges of the template, and first and last discharge of a sound and of an aged cell."""

POINTS, STOP = 200, 3.0
"""Samples of a run, and the voltage [V] at which it ends: below it the cell is empty."""

SPREAD = 0.03
"""Spread of sound discharges, as a share of the range: 0.014 to 0.026 of B0046."""


@cache
def discharges(cell: str) -> list[tuple[Array, Array, Array]]:
    """Time [s], current [A] and voltage [V] under load, of each discharge."""
    cycles = loadmat(Path(os.environ['BATTERIES']) / f'{cell}.mat', simplify_cells=True)[cell]
    found = []
    for data in (each['data'] for each in cycles['cycle'] if each['type'] == 'discharge'):
        volts, current = data['Voltage_measured'], -data['Current_measured']
        loaded = np.flatnonzero(current > 0.5)
        loaded = loaded[: np.argmax(volts[loaded] < STOP) or None]
        found.append(tuple(values[loaded] for values in (data['Time'], current, volts)))
    return found


@cache
def template(cell: str) -> tuple[Array, Array]:
    """Charge [A h] and mean voltage of the first discharges."""
    charge = np.linspace(0.02, 1.6, 300)
    curves = []
    for number in NEW:
        time, current, volts = discharges(cell)[number]
        curves.append(np.interp(charge, (time - time[0]) * current.mean() / 3600.0, volts))
    return charge, np.mean(curves, axis=0)


def record(cell: str, number: int) -> Run:
    time, current, volts = discharges(cell)[number]
    even = np.linspace(time[0] + 120.0, time[-1], POINTS)
    charge = (even - time[0]) * current.mean() / 3600.0
    known, curve = template(cell)
    return Run(f'discharge {number}', even - time[0],
               {'charge': charge, 'known': known, 'curve': curve},
               {'voltage': np.interp(even, time, volts)}, {'charge': charge})


def simulate(p: dict[str, float], run: Run) -> dict[str, Array]:
    charge, known, curve = (np.asarray(run.inputs[name]) for name in ('charge', 'known', 'curve'))
    volts = np.interp(charge / (1.0 - p['capacity.lost']), known, curve)
    volts = volts - (p['resistance.ohm'] + p['polarisation.ohm'] * charge)
    return {'voltage': p['offset'] + (1.0 + p['gauge.gain']) * volts}


MODEL = Model(
    simulate,
    base={'offset': Parameter(-0.01, 0.01, unit='V')},
    effects={
        'capacity': Effect('Capacity is lost', {'lost': Parameter(0.0, 0.5)}),
        'resistance': Effect('Resistance has grown', {'ohm': Parameter(0.0, 0.2, unit='ohm')}),
        'polarisation': Effect('Resistance grows with the charge drawn', {
            'ohm': Parameter(-0.1, 0.2)}),
        'gauge': Effect('Gain of the voltmeter', {'gain': Parameter(-0.05, 0.05)}),
    },
    channels={'voltage': Channel('V', model_error=SPREAD)},
)


def trials(number: int) -> list[Trial]:
    """A sound and an aged discharge, the aged one also without the laws of ageing."""
    cell = next(cells for first, cells in CELLS.items() if number >= first)[number % 2]
    random = np.random.default_rng([number, 3])
    sound, aged = (int(random.integers(*span)) for span in (SOUND, AGED))
    old = Trial('battery', f'{cell} aged {aged}', number, MODEL, partial(records, cell, aged),
                ('capacity', 'resistance'))
    new = Trial('battery', f'{cell} sound {sound}', number, MODEL, partial(records, cell, sound))
    return [new, old, *old.without_truth()]


def records(cell: str, number: int) -> Records:
    """Two discharges, and the one after them held out."""
    runs = [record(cell, number + later) for later in range(3)]
    return runs[:2], runs[2:]
