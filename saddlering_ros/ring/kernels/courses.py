"""Load on the ring before the motion is known, and readings of the probes of a known motion."""

from __future__ import annotations

from typing import Any

import numpy as np

from saddlering_ros.ring.kernels import layout as at
from saddlering_ros.ring.kernels.extension_laws import (
    advance_series,
    load_at_ring,
    read_probes,
    series_motion,
)
from saddlering_ros.ring.kernels.integration import take_load, take_zero
from saddlering_ros.ring.kernels.options import INNER, kernel, OUTER


@kernel(**OUTER)
def load_course(models: Any, zero_load: Any, load: Any, external: Any) -> Any:
    """Fill external (N, 3) with force and moment on the ring, from rest under zero_load on."""
    m = models[0]
    s, w = np.zeros(at.STATE_SIZE), np.zeros(at.WORK_SIZE)
    load_at_rest(m, s, zero_load, w)
    for n in range(load.size):
        if n > 0:
            take_load(m, s, load[n], w)
        for i in range(3):
            external[n, i] = w[at.EXTERNAL + i]


@kernel(**INNER)
def load_at_rest(m: Any, s: Any, load: Any, w: Any) -> Any:
    """Set the load path to its state at the start, the state that `integration.rest` sets."""
    s[at.CYLINDER_Z] = s[at.CYLINDER_Z + 1] = m.cylinder_friction.initial
    s[at.BRACKET_Z] = s[at.BRACKET_Z + 1] = m.bracket_play.initial
    s[at.MEASURED_LOAD] = s[at.HIGHEST_LOAD] = load
    return load_at_ring(m, load, m.cylinder_friction.initial, m.bracket_play.initial, w)


@kernel(**OUTER)
def read_course(models: Any, zero_load: Any, time: Any, load: Any, path: Any, out: Any) -> Any:
    """Fill out (N, 4) with the readings of the probes for a known motion path (N, 3)."""
    m = models[0]
    s, w = np.zeros(at.STATE_SIZE), np.zeros(at.WORK_SIZE)
    true_load = load_at_rest(m, s, zero_load, w)
    for i in range(3):
        s[at.Q + i] = path[0, i]
    take_zero(m, s, true_load, time[0], w)
    for n in range(time.size):
        step = 0.0
        if n > 0:
            step = time[n] - time[n - 1]
            true_load = take_load(m, s, load[n], w)
            for i in range(3):
                s[at.Q + i] = path[n, i]
        series_motion(m, s, w)
        advance_series(m, s, w, step)
        read_probes(m, s, w, true_load, time[n], step, out, n)
