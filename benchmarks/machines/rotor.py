"""A rotor on two bearings: records are beams and faults of ross, the model two discs."""

import numba as nb
import numpy as np

from machines.machine import about, hides, own_machine
from machines.simulators import COUNT, EARLY, rotor, STEP
from saddlering_ros.discrepancy import Channel, Parameter

SHAFT = np.array([[2.288, 1.914], [1.914, 2.288]])  # what both discs yield by the shaft [um/N]
LEVER = np.array([[0.7, 0.3], [0.3, 0.7]])


@nb.njit(cache=True)
def whirl(speed, law, parts):  # type: ignore[no-untyped-def]
    """Displacements (4, N) [um] of both discs, x and y of each, from where they hang at rest."""
    near_x, near_y, far_x, far_y, mass, damping, heavy, angle, bow, to = law[:10]
    pull, way, tilt, mix, loss, place, push, gap, loose = law[10:]
    across = np.linalg.inv(SHAFT + (LEVER / np.array([near_x, far_x])) @ LEVER)
    along = np.linalg.inv(SHAFT + (LEVER / np.array([near_y, far_y])) @ LEVER)
    seen, dt, q, v = np.empty((4, COUNT)), STEP / parts, np.zeros(2, nb.c16), np.zeros(2, nb.c16)
    for n in range((EARLY + COUNT) * parts):
        if n % parts == 0 and n >= EARLY * parts:
            seen[::2, n // parts - EARLY], seen[1::2, n // parts - EARLY] = q.real, q.imag
        turn, middle, facing = speed * n * dt, q.mean(), np.exp(1j * (speed * n * dt + place))
        moment = facing.real * (across @ q.real.copy()).sum()
        moment += facing.imag * ((along @ q.imag.copy()).sum() - 19.62 * mass)
        bent = q - 0.5 * loss * (1.0 - facing.imag) * moment * facing  # weight opens a crack below
        once = 1e-4 * heavy * speed**2 * np.exp(1j * (turn + angle))
        once += bow * np.exp(1j * (turn + to))
        twice = pull * (np.cos(2.0 * turn + way) * np.cos(tilt)
                        + 1j * np.sin(2.0 * turn + way) * np.sin(tilt))
        force = np.array([np.cos(mix) * twice + once, np.sin(mix) * twice])
        force -= 0.5 * push * max(1.0 - gap / max(abs(middle), 1e-9), 0.0) * (1.0 + 0.3j) * middle
        held = 1.0 - loose * (middle.imag > 0.0)
        force -= across @ bent.real.copy() + 1j * held * (along @ bent.imag.copy())
        v += dt * (1e6 * force - damping * v) / mass
        q += dt * v
    return seen


MACHINE = own_machine(
    'rotor', rotor, whirl, source='ross-rotordynamics 2.3.0', licence='MIT', base={
    'near_x': about(0.85), 'near_y': about(1.2), 'far_x': about(0.5), 'far_y': about(0.6),
    'mass': about(3.1), 'damping': (200.0, Parameter(20.0, 900.0, unit='N s/m')),
    'unbalance': about(4.0), 'angle': (0.3, Parameter(-1.5, 1.5)),
}, effects={
    'bow': hides('Bent shaft', 4.0, force=Parameter(0.0, 20), angle=Parameter.angle()),
    'misaligned': hides('Coupling out of line', 8.0, force=Parameter(0.0, 20),
                        **dict.fromkeys(('angle', 'axes', 'discs'), Parameter.angle())),
    'crack': hides('Crack that breathes', loss=Parameter(0.0, 0.5), place=Parameter.angle()),
    'rub': hides('Rub at the middle', 0.1, stiffness=Parameter(0, 1),
                 gap=Parameter(5, 200, unit='um')),
    'loose': hides('Loose foot', share=Parameter(0.0, 0.8)),
}, channels={probe: Channel('um', offset='free') for probe in ('x4', 'y4', 'x8', 'y8')}, parts=4)
