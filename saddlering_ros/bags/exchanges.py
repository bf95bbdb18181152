"""Two probes that exchange their readings within a record: a cable or channel was moved."""

from __future__ import annotations

from itertools import combinations

import numpy as np
from numpy.typing import NDArray

from saddlering_ros.record.scratch import blocks, spread
from saddlering_ros.rig import Rig

Floats = NDArray[np.float64]

ROWS = 2
"""Rows over which readings are compared. One of them may be interpolated across the exchange."""

USUAL_SHARE = 0.99
MIN_SIZE = 8.0
"""Smallest change of each reading at an exchange, as a multiple of the change over ROWS that this
share of the rows does not exceed."""

MATCH = 0.1
"""Largest difference from the earlier reading of the other probe, as a share of the change."""


def exchange_notes(rig: Rig, time: Floats, load: Floats, gaps: Floats) -> list[str]:
    """A line for each pair of probes (of gaps (4, N)) that exchange their readings at rest."""
    found: dict[tuple[int, int], float] = {}
    usual = [_usual_change(row) for row in gaps]
    for part in blocks(len(load) - ROWS, time, load, gaps):
        rows = slice(part.start, part.stop + ROWS)
        still = np.abs(load[rows][ROWS:] - load[rows][:-ROWS]) < rig.limits.level_step
        for pair in combinations(range(len(gaps)), 2):
            first, second = (gaps[probe, rows] for probe in pair)
            size = MIN_SIZE * max(usual[pair[0]], usual[pair[1]])
            places = np.flatnonzero(still & _exchanged(first, second, size))
            if len(places):
                found.setdefault(pair, float(time[part.start + int(places[0]) + 1]))
    return [f'probes {one + 1} and {other + 1} exchange their readings at {at:.3f} s while the '
            'load stands still: a cable or a channel was moved: repeat the test'
            for (one, other), at in found.items()]


def _usual_change(values: Floats) -> float:
    sample = spread(values)
    changes = np.abs(sample[ROWS:] - sample[:-ROWS])
    known = changes[np.isfinite(changes)]
    return float(np.quantile(known, USUAL_SHARE)) if len(known) else np.inf


def _exchanged(first: Floats, second: Floats, size: float) -> NDArray[np.bool_]:
    """Places where each of two probes reads, ROWS later, the earlier value of the other."""
    with np.errstate(invalid='ignore'):
        change = np.minimum(np.abs(first[ROWS:] - first[:-ROWS]),
                            np.abs(second[ROWS:] - second[:-ROWS]))
        away = np.maximum(np.abs(first[ROWS:] - second[:-ROWS]),
                          np.abs(second[ROWS:] - first[:-ROWS]))
        return np.asarray((change > size) & (away < MATCH * change))
