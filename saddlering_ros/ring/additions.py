"""Additions of the user's own laws to the load at the ring and to the readings of the probes."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from saddlering_ros.effects.law import Law, LawHistory, LOAD_TARGET
from saddlering_ros.rig import Rig

Floats = NDArray[np.float64]


class Additions:
    """All laws along one record, from its zero on; their sum at the zero is zero."""

    def __init__(self, rig: Rig, laws: Sequence[Law], time: float, load: float) -> None:
        both = [(law, LawHistory(law, time, load)) for law in laws]
        self._of_load = [history for law, history in both if law.target == LOAD_TARGET]
        self._of_probes = [
            (probe_pattern(rig, law.target), history)
            for law, history in both
            if law.target != LOAD_TARGET
        ]

    def push(self, time: Floats, load: Floats) -> tuple[Floats, Floats]:
        """The load (N,) at the ring, and the additions to the increments of the probes (N, 4)."""
        at_ring = load.copy()
        for history in self._of_load:
            at_ring += history.push(time, load)
        added = np.zeros((time.size, 4))
        for pattern, history in self._of_probes:
            added += history.push(time, load)[:, None] * pattern
        return at_ring, added


def probe_pattern(rig: Rig, target: str) -> Floats:
    """Change of the four probes' increments by one unit of a channel or of one probe."""
    half = 0.5 * rig.probes.axial_span
    patterns = {
        'delta_x': (1.0, 0.0, -1.0, 0.0),
        'delta_y': (0.0, 1.0, 0.0, 1.0),
        'gamma': (0.0, half, 0.0, -half),
        'parity': (1.0, 0.0, 1.0, 0.0),
    }
    if target in patterns:
        return np.array(patterns[target])
    return np.array([float(target == f'eddy_current_{probe}') for probe in (1, 2, 3, 4)])
