"""Cells that age, as NASA Ames recorded them: discharges of 1 A at 4 °C.

The model is the mean of early discharges of the same cell. Cell B0046 is for development, the
others are sealed.
"""

import numpy as np

from machines.machine import Array, recorded, Trial
from machines.recordings import discharge, discharges
from saddlering_ros.discrepancy import Channel, Effect, Model, Parameter, Run

CELLS = {161000: ('B0045', 'B0053'), 154000: ('B0047', 'B0048'), 0: ('B0046', 'B0046')}
SPREAD = 0.03  # of sound discharges, as a share of the range: 0.014 to 0.026 of B0046


def simulate(p: dict[str, float], run: Run) -> dict[str, Array]:
    charge, known, curve = (np.asarray(run.inputs[name]) for name in ('charge', 'known', 'curve'))
    volts = np.interp(charge / (1.0 - p['capacity.lost']), known, curve)
    volts -= p['resistance.ohm'] + p['polarisation.ohm'] * charge
    return {'voltage': p['offset'] + (1.0 + p['gauge.gain']) * volts}


MODEL = Model(simulate, {'offset': Parameter(-0.01, 0.01, unit='V')}, {
    'capacity': Effect('Capacity is lost', {'lost': Parameter(0, 0.5)}),
    'resistance': Effect('Resistance has grown', {'ohm': Parameter(0, 0.2, unit='ohm')}),
    'polarisation': Effect('Resistance grows with the charge drawn', {
        'ohm': Parameter(-0.1, 0.2)}),
    'gauge': Effect('Gain of the voltmeter', {'gain': Parameter(-0.05, 0.05)}),
}, {'voltage': Channel('V', model_error=SPREAD)})


def trials(number: int) -> list[Trial]:
    """A sound and an aged cell: two discharges, and the one after them held out."""
    cell = next(cells for first, cells in CELLS.items() if number >= first)[number % 2]
    random = np.random.default_rng([number, 3])
    return recorded('battery', number, MODEL, discharge, [
        (f'{cell} {state} {first}', truth, [(cell, first), (cell, first + 1)], [(cell, first + 2)])
        for state, truth, span in (('sound', (), (8, 11)),
                                   ('aged', ('capacity', 'resistance'),
                                    (20, min(66, len(discharges(cell)) - 2))))
        for first in [int(random.integers(*span))]])
