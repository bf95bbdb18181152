"""Whether the parity of four probes is noise alone, and how it compares with the channels' noise.

The parity of the radial probes is zero for a rigid ring with any contact: where it is
noise alone, it shows the slow part of the noise over the whole record, and between stretches at
rest. It is no noise where a cause shows in it, so that a diagnosis must not read noise from it.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from saddlering_ros.estimation.allan import allan_variance, running_total

Array = NDArray[np.float64]

COMPARED_COUNTS = (4, 8)
"""Samples over which a channel's noise is compared with the parity's: longer than what
interpolation between stamps smooths, shorter than any movement of a ring at rest."""

MAX_RATIO = 10.0
"""A channel that much quieter or noisier (variance) than the parity is read by another kind."""

MAX_GROWTH = 2.0
"""The parity is noise alone if its Allan variance over the record is at most that many times what
it is at rest, and grows at most that much faster than a random walk's."""

SURE_PAIRS = 10
"""A comparison counts at averaging times at which rest shows this many differences."""


def parity_ratios(
    parities: Sequence[Array], rests: Sequence[Array], segments: Sequence[Array]
) -> Array | None:
    """Variance of each channel's noise over the parity's, shape (C,); None if the parity moves.

    parities (N_i,) of whole records sampled alike, rests (n_i,): their stretches at rest;
    segments (C, n_i): all channels there.
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
