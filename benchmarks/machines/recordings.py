"""Recordings of real machines: ball screws of Cranfield, discharged cells of NASA Ames.

CRANFIELD is the folder of the csv files (doi 10.17862/cranfield.rd.5097649), BATTERIES that of
B0045.mat to B0048.mat and B0053.mat (Saha and Goebel 2007).
"""

from functools import cache
import os

import numpy as np
from scipy.io import loadmat

from machines.machine import Array
from saddlering_ros.discrepancy import Run

STEP = 0.04  # s, of a screw
table, cells = cache(np.genfromtxt), cache(loadmat)


def screw(state: str, load: int, number: int) -> Array:
    """Set point [mm], position error [mm] and current [A] of a screw (3, 5, 324), or empty."""
    every = table(f'{os.environ["CRANFIELD"]}/{state}.csv', delimiter=',', skip_header=1,
                  usecols=(0, 1, 2, 4, 5))
    own = (every[:, 3] == load) & (every[:, 4] == number)
    return np.asarray(every[own, :3].T.reshape(3, -1, 324))


def after(number: int) -> int:
    """The repetition of a screw that is held out, of the same half: 1 to 5 or 6 to 10."""
    return number + 1 if number % 5 else number - 4


def repetition(state: str, load: int, number: int) -> Run | None:
    """A repetition, with the mean of other sound ones; None for one that was not published."""
    tried = (number, after(number)) if state == 'normal' else ()
    sound = np.mean([screw('normal', load, other).mean(axis=1)
                     for other in range(1, 6) if other not in tried], axis=0)
    own = screw(state, load, number)
    if not own.size:
        return None
    position, error, current = np.tile(sound, own.shape[1])
    moves = np.tanh(np.gradient(position, STEP) / 2.0)
    inputs = {'error': error, 'current': current, 'moves': moves, 'position': position}
    return Run(f'{load} kgf, {number}', STEP * np.arange(moves.size), {**inputs, 'load': load},
               {'current': own[2].ravel(), 'error': own[1].ravel()})


def discharges(cell: str) -> list[dict[str, Array]]:
    """Every discharge of a cell, as recorded."""
    every = cells(f'{os.environ["BATTERIES"]}/{cell}.mat', simplify_cells=True)[cell]['cycle']
    return [each['data'] for each in every if each['type'] == 'discharge']


def emptied(cell: str, number: int) -> tuple[Array, Array, Array]:
    """Time [s], charge [A h] and voltage, down to 3 V, at which a cell is empty."""
    data = discharges(cell)[number]
    volts, current = data['Voltage_measured'], -data['Current_measured']
    loaded = np.flatnonzero(current > 0.5)
    loaded = loaded[: np.argmax(volts[loaded] < 3.0) or None]
    time = data['Time'][loaded] - data['Time'][loaded[0]]
    return time, time * current[loaded].mean() / 3600.0, volts[loaded]


def discharge(cell: str, number: int) -> Run:
    """A discharge, with the mean of early ones of the same cell over the charge drawn."""
    time, charge, volts = emptied(cell, number)
    even, known = np.linspace(120.0, time[-1], 200), np.linspace(0.02, 1.6, 300)
    curve = np.mean([np.interp(known, *emptied(cell, new)[1:]) for new in range(4, 8)], axis=0)
    drawn = np.interp(even, time, charge)
    return Run(f'discharge {number}', even, {'charge': drawn, 'known': known, 'curve': curve},
               {'voltage': np.interp(even, time, volts)}, {'charge': drawn})
