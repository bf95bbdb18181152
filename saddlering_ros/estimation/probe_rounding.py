"""The rounding errors of a run's four probes that its readings at rest hide."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from saddlering_ros.estimation.rounding import (
    crossing_seconds,
    HELD_FACTOR,
    HELD_SECONDS,
    hidden_rounding,
    rounding_record,
)
from saddlering_ros.record import PROBE_TOPICS, Record
from saddlering_ros.rig import OPPOSITE

Array = NDArray[np.float64]


def probe_rounding(run: Record) -> Array | None:
    """Errors (4, N) [m] to add to a run's probes where noise is read from them; None if none.

    Only a coarse converter hides any. The same run has the same errors every time.
    """
    rows = np.zeros(run.gaps.shape)
    step = float(np.median(np.diff(run.time)))
    for probe, topic in enumerate(PROBE_TOPICS):
        quality = run.quality.get(topic)
        if quality is None or not quality.is_coarse:
            continue
        rms = hidden_rounding(quality.resolution, quality.noise)
        if run.test == 'static':
            rms, lasting = HELD_FACTOR * rms, HELD_SECONDS
        else:
            lasting = crossing_seconds(
                quality.resolution, run.gaps[probe], float(run.time[-1] - run.time[0]))
        rows[probe] = rounding_record(rms, lasting, step, run.time.size, probe)
    if run.absent:
        rows[run.absent - 1] = -rows[OPPOSITE[run.absent] - 1]
    return rows if rows.any() else None
