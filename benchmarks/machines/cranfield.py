"""Cranfield's ball screw with seeded faults.

The model is the mean of sound repetitions, and what each fault does to a screw by its description.
Repetitions 6 to 10 are sealed.
"""

import numpy as np

from machines.machine import Array, recorded, Trial
from machines.recordings import after, repetition
from saddlering_ros.discrepancy import Channel, Effect, Model, Parameter, Run

LOADS = (20, 40, -40)  # kgf
ASSEMBLIES, PLACES = 0.022, 0.14  # Spread of sound repetitions 1 to 5: current [A], error [mm].
# Early stages have no name, as for the authors. Late spalling takes friction away: no effect does.
UNNAMED = ('normal', 'backlash1', *(f'spalling{stage}' for stage in range(1, 9)))
NAMED = ('backlash2', 'lackLubrication1', 'lackLubrication2')
FRICTION = ('lubrication', 'balls')  # Either is right for these.


def simulate(p: dict[str, float], run: Run) -> dict[str, Array]:
    error, current, moves, position, load = map(np.asarray, run.inputs.values())
    late, pushing = run.time - p['delay'], max(float(load) / 40.0, 0.0)
    near = np.exp(-((position - p['spall.place']) / p['spall.width']) ** 2)
    added = p['friction.current'] + p['lubrication.current'] * (pushing > 0.0)
    added += p['balls.current'] * pushing + p['spall.current'] * near
    added = added * np.abs(moves) + p['efficiency.current'] * load / 40.0 * moves
    return {'current': p['gain'] * np.interp(late, run.time, current) + p['offset'] + added,
            'error': np.interp(late, run.time, error) + p['play.width'] * moves}


ADDED = {'current': Parameter(0, 0.5, unit='A')}  # A fault takes none away.
MODEL = Model(simulate, {
    'gain': Parameter(1.0 - 2.0 * ASSEMBLIES, 1.0 + 2.0 * ASSEMBLIES),
    'offset': Parameter(-2.0 * ASSEMBLIES, 2.0 * ASSEMBLIES, unit='A'),
    'delay': Parameter(-0.1, 0.1, unit='s'),
}, {
    'friction': Effect('Plain Coulomb friction', ADDED),
    'lubrication': Effect('Friction under a pushing load', ADDED),
    'balls': Effect('Friction in proportion to a pushing load', ADDED),
    'spall': Effect('Defect of the screw at one place', {
        **ADDED, 'width': Parameter(3, 20, unit='mm'), 'place': Parameter(20, 140, unit='mm')}),
    'efficiency': Effect('Efficiency of the screw', {'current': Parameter(-0.3, 0.3, unit='A')}),
    'play': Effect('Play of the nut', {'width': Parameter(-1, 1, unit='mm')}),
}, {'current': Channel('A', model_error=ASSEMBLIES), 'error': Channel('mm', model_error=PLACES)})


def trials(number: int) -> list[Trial]:
    """Every state with all loads, and with the pull of 40 kgf alone."""
    return recorded('cranfield', number, MODEL, repetition, [
        (f'{state}{loads}', FRICTION if state in NAMED and loads == LOADS else (),
         *([(state, load, each) for load in loads] for each in (number, after(number))))
        for state in (*UNNAMED, *NAMED) for loads in (LOADS, LOADS[2:])])
