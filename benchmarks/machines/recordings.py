"""Recordings of real machines: ball screws, discharged cells, a slide, an electronic circuit.

CRANFIELD is the folder of the csv files (doi 10.17862/cranfield.rd.5097649), BATTERIES that of
B0045.mat to B0048.mat and B0053.mat (Saha and Goebel 2007), EMPS that of DATA_EMPS.mat and
DATA_EMPS_PULSES.mat (Janot, Gautier and Brunot 2019, in forgi86/sysid-neural-continuous),
SILVERBOX that of SNLS80mV.mat (Wigren and Schoukens 2013, in biaslab/nsi-silverbox).
"""

from functools import cache
import os

import numpy as np
from scipy.io import loadmat
from scipy.signal import butter, filtfilt, resample_poly

from machines.machine import Array
from saddlering_ros.discrepancy import Run

STEP = 0.04  # s, of a screw
SLIDE_STEP, SLIDE_EVERY, SLIDE_EDGE = 0.001, 10, 100  # s; samples: kept, of the end of a filter
MOTION, FORCE = (butter(4, hertz, fs=1.0 / SLIDE_STEP) for hertz in (100.0, 20.0))
CIRCUIT_STEP, CIRCUIT_FINE = 1000.0 / 610.35, 16  # ms; values of a drive for each sample
CIRCUIT_WARM, CIRCUIT_SEEN = 600, 2000  # Samples before what is compared, and of this
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


def filtered(force: Array) -> Array:
    """A force of a slide by sample, below 20 Hz."""
    return np.asarray(filtfilt(*FORCE, force))


def slide(name: str, part: int) -> Run:
    """A third of a record: the motion by sample, and the force below 20 Hz at 100 Hz."""
    data = cells(f'{os.environ["EMPS"]}/{name}.mat', simplify_cells=True)
    place = filtfilt(*MOTION, data['qm'])
    speed = np.gradient(place, SLIDE_STEP)
    motion = {'place': place, 'speed': speed, 'rate': np.gradient(speed, SLIDE_STEP)}
    pulses = np.asarray(data.get('pulses_N', 0.0 * place), np.float64)
    every = np.array_split(np.arange(SLIDE_EDGE, place.size - SLIDE_EDGE), 3)[part]
    near, rows = slice(every[0] - SLIDE_EDGE, every[-1] + 1 + SLIDE_EDGE), every[::SLIDE_EVERY]
    return Run(f'{name} {part}', data['t'][rows], {
        key: value[near] for key, value in {**motion, 'pulses': pulses}.items()},
        {'force': data['gtau'] * filtered(data['vir'])[rows]},
        {key: value[rows] for key, value in motion.items()})


def circuit(first: int) -> Run:
    """A stretch of the record of a circuit, which is compared from sample `CIRCUIT_WARM` on."""
    data = cells(f'{os.environ["SILVERBOX"]}/SNLS80mV.mat', simplify_cells=True)
    near = slice(first, first + CIRCUIT_WARM + CIRCUIT_SEEN)
    return Run(f'from {first}', CIRCUIT_STEP * np.arange(CIRCUIT_SEEN),
               {'drive': resample_poly(data['V1'][near], CIRCUIT_FINE, 1)},
               {'output': data['V2'][near][CIRCUIT_WARM:]})
