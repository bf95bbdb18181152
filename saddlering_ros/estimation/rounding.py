"""Rounding errors that readings at rest do not show, because all readings have the same error.

A converter of step q rounds by up to q/2. Noise of several steps makes this error new in every
reading. A quieter sensor at rest has the same error for seconds, so that its readings seem free of
noise. The hidden part has the variance (q^2 / 12) exp(-4 (pi s / q)^2) at noise s (Widrow and
Kollar, Quantization Noise, 2008, chapter 4: the error that remains with dither).
"""

import math

import numpy as np

from saddlering_ros.estimation.process import Array
from saddlering_ros.record import PROBE_TOPICS, Record
from saddlering_ros.rig import OPPOSITE

HELD_SECONDS = 1.0
"""Time [s] after which the rounding error under a held load counts as new. It is shorter than a
plateau, so that the noise of a plateau's mean includes the error."""

HELD_FACTOR = math.sqrt(2.0)
"""A mean over a plateau has the whole error; one over several times HELD_SECONDS has less."""


def hidden_rounding(resolution: float, noise: float) -> float:
    """Rms rounding error that readings at rest hide, by a converter's step and their rms."""
    if not resolution > 0.0:
        return 0.0
    dither = math.sqrt(max(noise**2 - resolution**2 / 12.0, 0.0))
    left = math.exp(-2.0 * (math.pi * dither / resolution) ** 2)
    return resolution / math.sqrt(12.0) * left


def rounding_record(rms: float, lasting: float, step: float, count: int, seed: int) -> Array:
    """An error (count,) of this rms at every `step` [s], new after each `lasting` [s]."""
    random = np.random.default_rng(seed)
    each = max(1, round(lasting / step))
    values = random.uniform(-1.0, 1.0, -(-count // each) + 1) * math.sqrt(3.0) * rms
    start = int(random.integers(each))
    return np.repeat(values, each)[start:start + count]


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
            # The time in which moving readings pass one step.
            travel = 2.0 * float(np.nanmax(run.gaps[probe]) - np.nanmin(run.gaps[probe]))
            seconds = max(float(run.time[-1] - run.time[0]), 1e-9)
            lasting = quality.resolution / max(travel / seconds, 1e-300)
        rows[probe] = rounding_record(rms, lasting, step, run.time.size, probe)
    if run.absent:
        rows[run.absent - 1] = -rows[OPPOSITE[run.absent] - 1]
    return rows if rows.any() else None
