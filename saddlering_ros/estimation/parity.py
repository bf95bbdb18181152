"""Whether the parity of four probes is noise alone, and its ratio to the noise of the channels.

The parity of the radial probes is zero for a rigid ring with any contact. If the parity is noise
alone, it shows the slow noise of the whole record, also between stretches at rest. If a cause
shows in the parity, it is no noise; a diagnosis must therefore not read noise from it.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from saddlering_ros.estimation.allan import allan_variance, running_total

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
    whole = np.array([_pooled(parities, count)[0] for count in COMPARED_COUNTS])
    channels = np.array([
        [_pooled([part[row] for part in segments], count)[0] for count in COMPARED_COUNTS]
        for row in range(len(segments[0]))
    ])
    if not (np.all(np.isfinite(channels)) and np.all(whole > 0.0)):
        return None
    ratios = np.mean(channels / whole, axis=1)
    if np.any(ratios < 1.0 / MAX_RATIO) or np.any(ratios > MAX_RATIO):
        return None
    return None if _moves(parities, rests) else np.asarray(ratios)


def _moves(parities: Sequence[Array], rests: Sequence[Array]) -> bool:
    """Whether parities move by more than their noise at rest."""
    last, longest = 0, max(parity.size for parity in parities) // 8
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


def _pooled(rows: Sequence[Array], count: int) -> tuple[float, int]:
    """Allan variance of rows (n_i,) at means over `count`, and its number of differences."""
    pairs = [max(0, row.size // count - 1) for row in rows]
    if not any(pairs):
        return np.nan, 0
    total = sum(number * allan_variance(running_total(row), count)
                for row, number in zip(rows, pairs, strict=True) if number)
    return total / sum(pairs), sum(pairs)
