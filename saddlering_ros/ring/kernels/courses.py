"""Load on the ring before the motion is known, and readings of the probes of a known motion."""


import numpy as np

from saddlering_ros.ring.kernels import extension_laws as laws
from saddlering_ros.ring.kernels import layout as at
from saddlering_ros.ring.kernels.integration import take_load, take_zero
from saddlering_ros.ring.kernels.layout import kernel, OUTER

UNCHANGED = np.empty((0, 3, 0)), np.array([-1])
"""`changes` and `moved` of `read_courses` for one model with the motion itself."""


@kernel(**OUTER)
def load_course(models, zero_load, load, external):
    """Fill external (N, 3) with force and moment on the ring, from rest under zero_load on."""
    m = models[0]
    s, w = np.zeros(at.STATE_SIZE), np.zeros(at.WORK_SIZE)
    laws.load_at_rest(m, s, zero_load, w)
    for n in range(load.size):
        if n > 0:
            take_load(m, s, load[n], w)
        for i in range(3):
            external[n, i] = w[at.EXTERNAL + i]


@kernel(**OUTER)
def read_courses(models, zero_load, time, load, motion, changes, moved, out):
    """Fill out (P, N, 4) with the readings of models (P,) of a motion (N, 3) with a change each.

    changes (N, 3, S); moved (P,): the change of each model, -1 for none.
    """
    s, w = np.zeros(at.STATE_SIZE), np.zeros(at.WORK_SIZE)
    for k in range(models.size):
        m = models[k]
        s[:] = 0.0
        true_load = laws.load_at_rest(m, s, zero_load, w)
        for n in range(time.size):
            step = 0.0
            if n > 0:
                step = time[n] - time[n - 1]
                true_load = take_load(m, s, load[n], w)
            for i in range(3):
                change = changes[n, i, moved[k]] if moved[k] >= 0 else 0.0
                s[at.Q + i] = motion[n, i] + change
            if n == 0:
                take_zero(m, s, true_load, time[0], w)
            laws.series_motion(m, s, w)
            laws.advance_series(m, s, w, step)
            laws.read_probes(m, s, w, true_load, time[n], step, out[k], n)


@kernel(**OUTER)
def steps_of_record(record, time, max_step, step_time, step_load, motion, samples):
    """From the record of `integration.careful_step` the steps (S + 1,) after the rest at the zero.

    step_time, step_load and motion (S + 1, 3) are filled from place 1 on; samples (N,): the step
    that ends at each of the times (N,).
    """
    steps = step_time.size - 1
    step_time[0] = reached = time[0]
    elapsed, place = 0.0, 0
    while place < time.size and time[place] - 1e-6 * max_step <= time[0]:
        samples[place] = 0
        place += 1
    total = 0.0
    for n in range(1, steps + 1):
        length = record[n, 0]
        total += length
        while place < time.size and time[place] - 1e-6 * max_step <= time[0] + total:
            samples[place] = n
            place += 1
        # A step twice the one before is still of second order: rounding must not make it more.
        if n > 1 and length > 1.5 * record[n - 1, 0]:
            length *= 1.0 - 1e-8
        elapsed += length
        reached = time[0] + elapsed
        step_time[n] = reached
        step_load[n] = record[n, 1]
        for i in range(3):
            motion[n, i] = record[n, 2 + i]
    while place < time.size:
        samples[place] = steps
        place += 1


@kernel(**OUTER)
def block_means(readings, starts, stops, out):
    """Fill out (P, 4, B): means of readings (P, N, 4) over the blocks [start, stop)."""
    for k in range(readings.shape[0]):
        for b in range(starts.size):
            for i in range(4):
                total = 0.0
                for n in range(starts[b], stops[b]):
                    total += readings[k, n, i]
                out[k, i, b] = total / (stops[b] - starts[b])


@kernel(**OUTER)
def plain_changes(models, changes, samples, moved, starts, stops, out):
    """Fill out (P, 4, B): block means of readings of changes (M, 3, S) that add nothing else.

    samples (N,): the step of each sample; moved (P,): the change of each row, -1 for none.
    """
    height, half_span = models[0].probe_plane_height, 0.5 * models[0].axial_span
    for k in range(moved.size):
        j = moved[k]
        if j < 0:
            out[k] = 0.0
            continue
        zero_x, zero_y, zero_tilt = changes[0, 0, j], changes[0, 1, j], changes[0, 2, j]
        for b in range(starts.size):
            x = y = tilt = 0.0
            for n in range(starts[b], stops[b]):
                x += changes[samples[n], 0, j]
                y += changes[samples[n], 1, j]
                tilt += changes[samples[n], 2, j]
            share = 1.0 / (stops[b] - starts[b])
            tilt = tilt * share - zero_tilt
            radial, axial = x * share - zero_x + height * tilt, y * share - zero_y
            out[k, 0, b], out[k, 2, b] = radial, -radial
            out[k, 1, b], out[k, 3, b] = axial + half_span * tilt, axial - half_span * tilt
