"""First guess at the cause of an alarm: the quantity that the residual follows."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

FIRST_GUESSES = {
    'load': 'stiffness or exponent of a contact row, geometry, or the gain of a probe or of the '
            'load cell',
    'rate': 'damping, or a delay between load and probes',
    'direction': 'friction or play in a row, or hysteresis of the load cell',
    'time': 'drift of a probe, of the temperature or of the load cell',
    'offset': 'a probe that slipped or was touched, or a zero that was not at rest',
    'one direction': 'friction or play in a row, hysteresis of the load cell, or a probe that '
                     'slipped: the load has moved in one direction only since then',
    'unclear': 'none of load, rate, direction and time alone: record the test and run '
               '`saddlering diagnose`',
}
"""Frequent causes of a residual that follows each of these."""

MIN_BLOCKS = 10
STEADY_SHARE = 0.35
"""A residual whose scatter is below this share of its mean is an offset."""

ONE_WAY = 0.9
"""Mean direction (-1 to 1) of a load from which on it moves in one direction only."""

MIN_CORRELATION = 0.5
SPAN = 2
"""Blocks to either side over which the rate of the load is taken."""


def first_guess(residual: Array, load: Array, time: Array, rest_band: float) -> str:
    """Which key of FIRST_GUESSES the residual (N,) follows; '' if it is too short for a guess.

    load (N,) [N]; time (N,) [s]; rest_band [N]: the load has no direction while it moves by less.
    """
    if residual.size < MIN_BLOCKS:
        return ''
    change = np.zeros_like(load)
    change[SPAN:-SPAN] = load[2 * SPAN:] - load[:-2 * SPAN]
    change[:SPAN], change[-SPAN:] = change[SPAN], change[-SPAN - 1]
    direction = np.where(np.abs(change) > rest_band, np.sign(change), 0.0)
    if residual.std() < STEADY_SHARE * abs(residual.mean()):
        # Friction after the load has turned is an offset too, until the load turns again.
        return 'one direction' if abs(direction.mean()) > ONE_WAY else 'offset'
    regressors = {'load': load, 'rate': change, 'direction': direction, 'time': time}
    strength = {
        name: abs(float(np.corrcoef(residual, values)[0, 1]))
        for name, values in regressors.items() if np.ptp(values) > 0.0}
    best = max(strength, key=lambda name: strength[name], default='unclear')
    return best if strength.get(best, 0.0) > MIN_CORRELATION else 'unclear'
