"""Records of Cranfield's ball screw with seeded faults (doi 10.17862/cranfield.rd.5097649).

The model is the mean of sound repetitions, and what each fault does to a screw by its description.
Repetitions 1 to 5 are for development, 6 to 10 are sealed.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import cache, partial
import os
from pathlib import Path

import numpy as np

from machines.machine import Array, Records, Trial
from saddlering_ros.discrepancy import Channel, Effect, Model, Parameter, Run

STEP, LOADS, HALF = 0.04, (20, 40, -40), 5
ASSEMBLIES = 0.022
"""Spread of the current from one assembly to the next [A], of its range of about 1 A."""

FRICTION = ('lubrication', 'balls')
TRUTH: dict[str, tuple[str, ...]] = {
    'normal': (), 'backlash1': (), **{f'spalling{stage}': () for stage in range(1, 9)},
    'backlash2': FRICTION, 'lackLubrication1': FRICTION, 'lackLubrication2': FRICTION}
"""Effects that may be named for a state. Early stages, which the authors miss too, have none; late
spalling takes friction away, which no effect does."""


@cache
def sequences(state: str) -> dict[tuple[int, int], Array]:
    """Set point [mm], position error [mm] and current [A] (3, 5, 324) by load and repetition."""
    path = Path(os.environ['CRANFIELD']) / f'{state}.csv'
    table = np.genfromtxt(path, delimiter=',', skip_header=1, usecols=(0, 1, 2, 4, 5, 7))
    return {(load, number): table[(table[:, 3] == load) & (table[:, 4] == number), :3].T.reshape(
        3, -1, 324) for load in LOADS for number in range(1, 11)}


def record(state: str, load: int, number: int) -> Run:
    """A repetition, with the mean of the sound repetitions of the development half beside it."""
    own, others = sequences(state)[load, number], sequences('normal')
    sound = np.mean([others[load, other].mean(axis=1) for other in range(1, HALF + 1)
                     if state != 'normal' or other not in (number, after(number))], axis=0)
    count = own.shape[1]
    usual = np.tile(sound, count)
    moves = np.tanh(np.gradient(usual[0], STEP) / 2.0)
    inputs = {'error': usual[1], 'current': usual[2], 'moves': moves, 'position': usual[0]}
    return Run(f'{load} kgf, {number}', STEP * np.arange(count * 324), {**inputs, 'load': load},
               {'current': own[2].ravel(), 'error': own[1].ravel()})


def after(number: int) -> int:
    """The repetition that is held out, of the same half."""
    return number + 1 if number % HALF else number - HALF + 1


def simulate(p: dict[str, float], run: Run) -> dict[str, Array]:
    moves, position, error, current = (
        np.asarray(run.inputs[name]) for name in ('moves', 'position', 'error', 'current'))
    load = float(str(run.inputs['load'])) / 40.0
    late = np.interp(run.time - p['delay'], run.time, current)
    near = np.exp(-((position - p['spall.place']) / p['spall.width']) ** 2)
    added = p['friction.current'] + p['lubrication.current'] * (load > 0.0)
    added += p['balls.current'] * max(load, 0.0) + p['spall.current'] * near
    return {'current': p['gain'] * late + p['offset'] + added * np.abs(moves)
            + p['efficiency.current'] * load * moves,
            'error': np.interp(run.time - p['delay'], run.time, error) + p['play.width'] * moves}


def added(name: str, high: float, **shape: Parameter) -> Effect:
    """A current that a fault adds; a fault takes none away."""
    return Effect(name, {'current': Parameter(0.0, high, unit='A'), **shape})


MODEL = Model(
    simulate,
    base={'gain': Parameter(1.0 - 2.0 * ASSEMBLIES, 1.0 + 2.0 * ASSEMBLIES),
          'offset': Parameter(-2.0 * ASSEMBLIES, 2.0 * ASSEMBLIES, unit='A'),
          'delay': Parameter(-0.1, 0.1, unit='s')},
    effects={
        'friction': added('Plain Coulomb friction', 0.5),
        'lubrication': added('Friction under a pushing load', 0.5),
        'balls': added('Friction in proportion to a pushing load', 0.5),
        'spall': added('Defect of the screw at one place', 0.5, width=Parameter(3, 20, unit='mm'),
                       place=Parameter(20, 140, unit='mm')),
        'efficiency': Effect('Efficiency of the screw', {
            'current': Parameter(-0.3, 0.3, unit='A')}),
        'play': Effect('Play of the nut', {'width': Parameter(-1, 1, unit='mm')}),
    },
    channels={'current': Channel('A', model_error=ASSEMBLIES), 'error': Channel('mm')},
)


def trials(number: int) -> list[Trial]:
    """Every state in this repetition, with all loads and with the pull of 40 kgf alone."""
    found = []
    for state, truth in TRUTH.items():
        whole, pulled = (
            Trial('cranfield', f'{state}{loads}', number, MODEL,
                  partial(records, state, loads, number), truth if len(loads) > 1 else ())
            for loads in (LOADS, LOADS[2:]))
        found += [whole, *whole.without_truth(), pulled]
    return found


def records(state: str, loads: Sequence[int], number: int) -> Records:
    """A repetition, and the next one of the same half, held out."""
    runs, held = ([record(state, load, each) for load in loads
                   if sequences(state)[load, each].size]  # One was not published.
                  for each in (number, after(number)))
    return runs, held
