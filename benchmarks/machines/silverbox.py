"""An electronic circuit after Duffing (Silverbox), as its authors recorded it: voltages.

Their spring hardens with the cube. The limit `MIN_BENT` of a freed law was chosen beside it.
"""

import numba as nb
import numpy as np

from machines.machine import Array, known, recorded, Trial
from machines.recordings import circuit, CIRCUIT_FINE, CIRCUIT_STEP, CIRCUIT_WARM
from saddlering_ros.discrepancy import Channel, Effect, Model, Parameter, Run

FIRST, EVERY, WAVES, ARROW = 39990, 8692, 10, 30000  # Samples: multisines; of a growing drive
NAMES = ('gain', 'rate', 'damping', 'zero', 'cubic.rate', 'square.rate', 'wide.rate', 'drag.size',
         'dry.size', 'clip.size')


@nb.njit(cache=True)
def swing(drive, law):  # type: ignore[no-untyped-def]
    """The output [V] at every sample of a drive with `CIRCUIT_FINE` values for each."""
    gain, rate, damping, zero, cubic, square, wide, drag, dry, clip = law
    seen, dt, y, v = np.zeros(drive.size), 2.0 * CIRCUIT_STEP / CIRCUIT_FINE, 0.0, 0.0
    for n in range(0, drive.size - 2, 2):
        seen[n], a, b = y, y, v
        for half in (1, 2):  # The midpoint, then the end of the step
            u = drive[n + half - 1] - zero
            force = (rate + square * a + cubic * a * a + wide * abs(a)) * a
            force += (damping + drag * abs(b)) * b + dry * np.tanh(b / 1e-3)
            force -= gain * (u - clip * u**3)
            a, b = y + 0.5 * half * dt * b, v - 0.5 * half * dt * force
        y, v = a, b
    return seen[::CIRCUIT_FINE]


def simulate(p: dict[str, float], run: Run) -> dict[str, Array]:
    seen = swing(np.asarray(run.inputs['drive']), np.array([p[name] for name in NAMES]))
    return {'output': seen[CIRCUIT_WARM:] + p['meter.offset']}


MODEL = Model(simulate, {  # ms and V
    'gain': Parameter(0.01, 1), 'rate': Parameter(0.1, 0.4), 'damping': Parameter(0.002, 0.2),
    'zero': Parameter(-0.02, 0.02, unit='V'),
}, {
    'cubic': Effect('Spring that hardens with the cube', {'rate': Parameter(-3, 3)}),
    'square': Effect('Spring that is unlike on both sides', {'rate': Parameter(-1, 1)}),
    'wide': Effect('Spring that hardens with the square', {'rate': Parameter(-1, 1)}),
    'drag': Effect('Damping that grows with the speed', {'size': Parameter(-1, 1)}),
    'dry': Effect('Dry friction', {'size': Parameter(0, 0.02)}),
    'clip': Effect('Drive that saturates', {'size': Parameter(-5, 10)}),
    'meter': Effect('Offset of the output', {'offset': Parameter(-0.02, 0.02, unit='V')}),
}, {'output': Channel('V')})


def trials(number: int) -> list[Trial]:
    """Three multisines, and a fourth or the end of a growing drive held out."""
    waves = [(FIRST + EVERY * ((number + each) % WAVES),) for each in range(4)]
    split = waves[:3], waves[3:] if number % 2 else [(ARROW,)]
    cases = [(MODEL, 'cubic', ('cubic',)), (known(MODEL, 'cubic'), 'sound', ())]
    return [trial for model, name, truth in cases for trial in recorded(
        'silverbox', number, model, circuit, [(name, truth, *split)])]
