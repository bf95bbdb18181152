"""A long run as averages over blocks of samples: input of a fit in bounded memory."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from saddlering_ros.record.record import Record
from saddlering_ros.record.scratch import BLOCK, blocks, spread_changes
from saddlering_ros.rig import Rig

Floats = NDArray[np.float64]

FIT_ROWS = 1 << 19
"""Samples of all runs together that a fit holds in memory."""

MIN_BLOCK_SHARE = 0.5
"""Smallest share of the samples of a block with a reading of a probe."""

MAX_BLOCK_SECONDS = 1.5
"""Length of a block, in usual lengths, beyond which it lies across a gap."""

SPAN_MARGIN = 1e-4
"""Distance from an end of the span, as a share of the span, within which a reading is at a
limit."""


def fit_limit(runs: Sequence[Record], rows: int = FIT_ROWS) -> int:
    """Largest number of samples that each of the runs of one fit may have.

    With this limit they have `rows` samples in all, so that the memory of a fit depends neither
    on the length of the runs nor on their number. Short runs are kept whole.
    """
    left, counts = rows, sorted(len(run.stamps) for run in runs)
    for shorter, count in enumerate(counts):
        share = left // (len(counts) - shorter)
        if count > share:
            return max(share, 1)
        left -= count
    return rows


def condensed(run: Record, rig: Rig, limit: int = FIT_ROWS) -> Record:
    """The run itself, or one of at most `limit` averages with a note if it is longer.

    Only sound readings count: none that is a spike, lies across a refused reading, or is at a
    limit of the probes' span. Load and probes are averaged alike, so that a simulation of the
    averages is the average of a simulation.
    """
    count = len(run.stamps)
    size = -(-count // limit)
    if size <= 1:
        return run
    period = float(np.median(spread_changes(run.stamps)))
    rows = count // size
    stamps, load = np.empty(rows, np.int64), np.empty(rows)
    gaps = np.empty((len(run.gaps), rows))
    per_part = max(1, BLOCK // size)
    for part in blocks(rows, run.stamps, run.time, run.load, run.gaps, size=per_part):
        samples = slice(part.start * size, part.stop * size)
        taken = run.stamps[samples].reshape(-1, size)
        stamps[part] = taken[:, 0] + (taken - taken[:, :1]).mean(axis=1).astype(np.int64)
        load[part] = _sound_load(run, samples).reshape(-1, size).mean(axis=1)
        for probe, averages in enumerate(gaps):
            averages[part] = _means(_sound_gaps(run, rig, probe, samples).reshape(-1, size))
        is_long = taken[:, -1] - taken[:, 0] > MAX_BLOCK_SECONDS * size * period
        gaps[:, part][:, is_long] = np.nan
    note = (f'{count} samples every {period * 1e-6:.3g} ms are averaged over {size} samples each, '
            'because the record is long')
    return replace(
        run, stamps=stamps, time=(stamps - stamps[0]) * 1e-9, load=load, gaps=gaps, others={},
        notes=[*run.notes, note], spikes=None, used=None, published=None,
        probe_marks=None, load_marks=None)


def _sound_load(run: Record, samples: slice) -> Floats:
    load, time = run.load[samples], run.time[samples]
    struck = run.is_load_doubtful(samples)
    if run.spikes is not None:
        struck = struck | run.spikes[0, samples]
    if not struck.any() or struck.all():
        return load
    load = load.copy()
    load[struck] = np.interp(time[struck], time[~struck], load[~struck])
    return load


def _sound_gaps(run: Record, rig: Rig, probe: int, samples: slice) -> Floats:
    low, high = rig.probes.min_range, rig.probes.max_range
    margin = SPAN_MARGIN * (high - low)
    gaps = run.gaps[probe, samples].copy()
    with np.errstate(invalid='ignore'):
        gaps[(gaps <= low + margin) | (gaps >= high - margin)] = np.nan
    if run.spikes is not None:
        gaps[run.spikes[1 + probe, samples]] = np.nan
    gaps[run.are_gaps_doubtful(samples)] = np.nan
    return gaps


def _means(gaps: Floats) -> Floats:
    """Mean of each row (M, size); NaN where too few readings are known."""
    known = np.isfinite(gaps)
    counts = known.sum(axis=1)
    enough = counts >= MIN_BLOCK_SHARE * gaps.shape[1]
    sums = np.where(known, gaps, 0.0).sum(axis=1)
    return np.where(enough, sums / np.maximum(counts, 1), np.nan)
