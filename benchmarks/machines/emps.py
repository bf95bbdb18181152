"""A slide on a ball screw (EMPS), as its authors recorded it: force of the motor over the motion.

Their model has a mass, viscous and dry friction and an offset. In the second record pulses of a
further force act. The limit `MIN_BENT` of a freed law was chosen beside it.
"""

import numpy as np

from machines.machine import Array, known, recorded, Trial
from machines.recordings import filtered, slide, SLIDE_EDGE, SLIDE_EVERY, SLIDE_STEP
from saddlering_ros.discrepancy import Channel, Effect, Model, Parameter, Run

RECORDS, PARTS = ('DATA_EMPS', 'DATA_EMPS_PULSES'), 3
RESTS = 0.001  # m/s, below which the slide may stand


def simulate(p: dict[str, float], run: Run) -> dict[str, Array]:
    place, speed, rate, pulses = map(np.asarray, run.inputs.values())
    sign = np.tanh(speed / RESTS)
    dry = p['friction.force'] + p['sticking.force'] * np.exp(-np.abs(speed) / p['sticking.speed'])
    force = p['mass'] * rate + p['viscous'] * speed + p['drag.size'] * speed * np.abs(speed)
    force += (dry + p['pressed.mass'] * np.abs(rate)) * sign + p['pulses.force'] * pulses
    force += p['offset.force'] + p['lean.force'] * sign**2
    force += p['spring.rate'] * (place - p['spring.rest'])
    number = np.arange(force.size)
    late = np.interp(number - p['delay.time'] / SLIDE_STEP, number, force)
    return {'force': filtered(late)[SLIDE_EDGE : force.size - SLIDE_EDGE : SLIDE_EVERY]}


FORCE = Parameter(-60, 60, unit='N')
MODEL = Model(simulate, {'mass': Parameter(30, 300, unit='kg'), 'viscous': Parameter(0, 1000)}, {
    'friction': Effect('Dry friction', {'force': Parameter(0, 60, unit='N')}),
    'sticking': Effect('Friction that falls with speed', {
        'force': FORCE, 'speed': Parameter(0.001, 0.02, unit='m/s')}),
    'pressed': Effect('Friction that grows with the thrust', {'mass': Parameter(-50, 50)}),
    'drag': Effect('Drag by the square of the speed', {'size': Parameter(-5000, 5000)}),
    'offset': Effect('Offset of the force', {'force': FORCE}),
    'lean': Effect('Friction that is larger in one direction', {'force': FORCE}),
    'spring': Effect('Cables that pull', {
        'rate': Parameter(-500, 500), 'rest': Parameter(0, 0.25, unit='m')}),
    'pulses': Effect('Pulses of a further force', {'force': Parameter(-50, 50, unit='N')}),
    'delay': Effect('Delay of the record', {'time': Parameter(-0.02, 0.02, unit='s')}),
}, {'force': Channel('N')})


def trials(number: int) -> list[Trial]:
    """Each third of a record held out in turn, the offset an effect or a parameter of the base."""
    name, held = RECORDS[number // PARTS % 2], number % PARTS
    split = [(name, part) for part in range(PARTS) if part != held], [(name, held)]
    return [trial for title, truth, fitted in (
                ('friction', ('friction',), ()), ('offset fitted', ('friction',), ('offset',)),
                ('sound', (), ('offset', 'friction')))
            for trial in recorded('emps', number, known(MODEL, *fitted), slide, [
                (title, truth, *split)])]
