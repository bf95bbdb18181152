"""Whether the parity of four probes is noise alone, and its ratio to the noise of the channels.

The parity of the radial probes is zero for a rigid ring with any contact. If the parity is noise
alone, it shows the slow noise of the whole record, also between stretches at rest. If a cause
shows in the parity, it is no noise; a diagnosis must therefore not read noise from it.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from saddlering_ros.estimation.allan import RowTotals

Array = NDArray[np.float64]

COMPARED_COUNTS = (4, 8)
"""Samples over which the noise of a channel is compared with that of the parity: longer than the
smoothing by interpolation between stamps, shorter than any movement of a ring at rest."""

MAX_RATIO = 10.0
"""Ratio of variances of channel and parity above which another kind of sensor reads the
channel."""

MAX_GROWTH = 2.0
"""The parity is noise alone if its Allan variance over the record is at most this multiple of that
at rest, and grows at most this much faster than that of a random walk."""

SURE_PAIRS = 10
"""Smallest number of differences at rest for a comparison at an averaging time."""


def parity_ratios(
    parities: Sequence[Array], rests: Sequence[Array], segments: Sequence[Array]
) -> Array | None:
    """Variance of the noise of each channel over that of the parity (C,).

    None if the parity moves. parities (N_i,) of whole records with equal sampling; rests
    (n_i,): their stretches at rest; segments (C, n_i): all channels there.
    """
    if not segments:
        return None
    records = RowTotals(parities)
    whole = np.array([_pooled(records, count)[0] for count in COMPARED_COUNTS])
    at_rest = [RowTotals([part[row] for part in segments]) for row in range(len(segments[0]))]
    channels = np.array(
        [[_pooled(one, count)[0] for count in COMPARED_COUNTS] for one in at_rest])
    if not (np.all(np.isfinite(channels)) and np.all(whole > 0.0)):
        return None
    ratios = np.mean(channels / whole, axis=1)
    if np.any(ratios < 1.0 / MAX_RATIO) or np.any(ratios > MAX_RATIO):
        return None
    return None if _moves(records, RowTotals(rests)) else np.asarray(ratios)


def _moves(parities: RowTotals, rests: RowTotals) -> bool:
    """Whether parities move by more than their noise at rest."""
    last, longest = 0, int(parities.sizes.max()) // 8
    walk = np.inf
    count = 1
    while count <= max(longest, 1):
        whole, _ = _pooled(parities, count)
        at_rest, pairs = _pooled(rests, count)
        if pairs >= SURE_PAIRS:
            if whole > MAX_GROWTH * at_rest:
                return True
            last, walk = count, whole
        elif last and whole > MAX_GROWTH * walk * count / last:
            return True
        count *= 2
    return not last


def _pooled(rows: RowTotals, count: int) -> tuple[float, int]:
    """Allan variance of rows at means over `count`, and its number of differences."""
    weighted, pairs = rows.weighted_variance(count)
    return (weighted / pairs if pairs else np.nan), pairs
