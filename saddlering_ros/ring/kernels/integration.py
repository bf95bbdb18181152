"""Time steps of the ring: BDF2 with Newton on exact tangents, from a state at rest onwards."""

import math

import numpy as np

from saddlering_ros.ring.kernels import extension_laws as laws
from saddlering_ros.ring.kernels import layout as at
from saddlering_ros.ring.kernels import tangents
from saddlering_ros.ring.kernels.contact import PARTS
from saddlering_ros.ring.kernels.equilibrium import differences, equilibrium, solve3, system
from saddlering_ros.ring.kernels.layout import INNER, kernel, OUTER

STEP_TOLERANCE = 5e-11
"""Largest last Newton update [m]. Convergence is quadratic: the next would be below 1e-12 m."""

MAX_ITERATIONS = 60
"""Newton needs one or two; a step with more has met a kink and is tried in parts."""

MAX_STEP_ERROR = 5e-8
"""Largest estimated error [m] of a step, of any length. A step with more is divided, down to
MIN_FRACTION."""

USUAL_DAMPING = 0.2
"""Smallest damping ratio at which the errors of steps decay before they add up."""

MIN_DAMPING_SHARE = 1e-8
"""Smallest share that is used, also for a ring without damping."""

MIN_FRACTION = 1.0 / 256.0
"""Share of a requested step, after eight halvings, whose error is taken as it is."""

SOLVED, FAILED, TOO_COARSE = 0, -1, -2
"""Results of a step; that of TOO_COARSE has a larger error than allowed."""

MAX_PREDICTION = 5e-6
"""Largest predicted change [m] that is used. Beyond it, the step starts from the old rate."""


@kernel(**INNER)
def rest(m, rows, uniform, s, time, load, w):
    """Set state s to rest under the measured `load`, zero at `time`; False if no equilibrium."""
    for i in range(s.size):
        s[i] = 0.0
    s[at.FRACTION] = 1.0
    true_load = laws.load_at_rest(m, s, load, w)
    for i, element in enumerate((m.radial_friction, m.axial_friction, m.tilt_friction)):
        state = laws.state_at_rest(element, i, w)
        s[at.FRICTION_Z + 2 * i] = s[at.FRICTION_Z + 2 * i + 1] = state
        w[at.EXTERNAL + i] -= element.limit * state
    found, s[at.Q], s[at.Q + 1], s[at.Q + 2] = equilibrium(
        m, rows, uniform, w, math.copysign(0.5 * m.radial_clearance + 1e-5, w[at.EXTERNAL]),
        math.copysign(0.5 * m.axial_clearance + 1e-5, w[at.EXTERNAL + 1]), 0.0)
    for i in range(3):
        s[at.Q_OLD + i] = s[at.Q + i]
    take_zero(m, s, true_load, time, w)
    return found


@kernel(**INNER)
def take_zero(m, s, true_load, time, w):
    """Let the probes read zero at the motion at rest under true_load [N] at `time`."""
    laws.series_motion(m, s, w)
    for i in range(3):
        s[at.CREEP + i] = s[at.CREEP_INPUT + i] = w[at.MOTION + i]
        w[at.MOTION + i] *= 1.0 + (m.creep_radial if i == 0 else m.creep_axial)
        s[at.RESONANCE + i] = s[at.RESONANCE_INPUT + i] = w[at.MOTION + i]
        s[at.ZERO + i] = w[at.MOTION + i]
    s[at.ZERO_FORCE_X] = w[at.RESOLVED]
    s[at.ZERO_LOAD] = true_load
    s[at.START_TIME] = s[at.TIME] = time


@kernel(**INNER)
def predict(m, s, h, c0, c1, c2, friction, w):
    """Predict the change (3,) from the last state by its stiffness and damping, without forces.

    Solves m a + K (q - q_old) + D (v - v_old) = external + F_old for the step's difference
    formulas v = c0 q + ..., a = c0 v + .... The slope of friction depends on the travel, which a
    first pass gives. The first value is False if the change is too large.
    """
    b0 = c0 * s[at.Q] + c1 * s[at.Q] + c2 * s[at.Q_OLD]
    b1 = c0 * s[at.Q + 1] + c1 * s[at.Q + 1] + c2 * s[at.Q_OLD + 1]
    b2 = c0 * s[at.Q + 2] + c1 * s[at.Q + 2] + c2 * s[at.Q_OLD + 2]
    a0 = c0 * b0 + c1 * s[at.V] + c2 * s[at.V_OLD]
    a1 = c0 * b1 + c1 * s[at.V + 1] + c2 * s[at.V_OLD + 1]
    a2 = c0 * b2 + c1 * s[at.V + 2] + c2 * s[at.V_OLD + 2]
    j0, j1, j2 = b0 - s[at.V], b1 - s[at.V + 1], b2 - s[at.V + 2]
    d = at.LAST_DAMPING
    r0 = w[at.EXTERNAL] + s[at.LAST_FORCE] - m.mass * a0 - s[d] * j0 - s[d + 1] * j2
    r1 = w[at.EXTERNAL + 1] + s[at.LAST_FORCE + 1] - m.mass * a1 - s[d + 2] * j1 - s[d + 3] * j2
    r2 = (w[at.EXTERNAL + 2] + s[at.LAST_FORCE + 2] - m.inertia * a2
          - s[d + 1] * j0 - s[d + 3] * j1 - s[d + 4] * j2)
    found, x, y, tilt = False, h * s[at.V], h * s[at.V + 1], h * s[at.V + 2]
    rubbing0 = rubbing1 = rubbing2 = 0.0
    for _ in range(2 if friction else 1):
        if friction:
            _, _, rubbing0 = laws.friction_force(m.radial_friction, s, 0, x)
            _, _, rubbing1 = laws.friction_force(m.axial_friction, s, 1, y)
            _, _, rubbing2 = laws.friction_force(m.tilt_friction, s, 2, tilt)
        found, x, y, tilt = solve3(
            *system(m, s, at.LAST_STIFFNESS, d, c0, (rubbing0, rubbing1, rubbing2)), r0, r1, r2)
    return found and max(abs(x), abs(y), abs(tilt) * m.radius) < MAX_PREDICTION, x, y, tilt


@kernel(**INNER)
def keep_step(m, s, h, c0, p, past, q, friction, w):
    """Make the solved step the state, and keep its forces and slopes for `predict`."""
    if friction:
        for i, element in enumerate((m.radial_friction, m.axial_friction, m.tilt_friction)):
            laws.advance_friction(element, s, at.FRICTION_Z + 2 * i, q[i] - s[at.Q + i])
    for i in range(3):
        v = c0 * q[i] + p[i]
        inertia = m.inertia if i == 2 else m.mass
        s[at.LAST_FORCE + i] = inertia * (c0 * v + past[i]) - w[at.EXTERNAL + i]
        s[at.Q_OLD + i], s[at.Q + i] = s[at.Q + i], q[i]
        s[at.V_OLD + i], s[at.V + i] = s[at.V + i], v
    for i in range(5):
        s[at.LAST_STIFFNESS + i] = w[at.STIFFNESS + i]
        s[at.LAST_DAMPING + i] = w[at.DAMPING + i]
    s[at.STEP_OLD] = h


@kernel(**INNER)
def implicit_step(m, rows, uniform, s, h, friction, allowed, recorder, w):
    """One BDF2 step of h seconds (backward Euler after a start or a jump in h).

    The unknown is q; v and a follow from the difference formulas. friction: whether the ring has
    friction. Returns SOLVED, FAILED if Newton fails, TOO_COARSE if the error exceeds `allowed`
    [m]. Unless it is solved the state is unchanged. recorder: None, or (records (S, width), parts
    (3, PARTS), last v (3,), grows) of `tangents.keep_record`.
    """
    c0, c1, c2 = differences(h, s[at.STEP_OLD])
    p0 = c1 * s[at.Q] + c2 * s[at.Q_OLD]
    p1 = c1 * s[at.Q + 1] + c2 * s[at.Q_OLD + 1]
    p2 = c1 * s[at.Q + 2] + c2 * s[at.Q_OLD + 2]
    past0 = c1 * s[at.V] + c2 * s[at.V_OLD]
    past1 = c1 * s[at.V + 1] + c2 * s[at.V_OLD + 1]
    past2 = c1 * s[at.V + 2] + c2 * s[at.V_OLD + 2]
    move0 = move1 = move2 = 0.0
    if c2 != 0.0:
        trusted, move0, move1, move2 = predict(m, s, h, c0, c1, c2, friction, w)
        if not trusted:
            ahead = min(h, 0.01)
            move0, move1, move2 = ahead * s[at.V], ahead * s[at.V + 1], ahead * s[at.V + 2]
    q0, q1, q2 = s[at.Q] + move0, s[at.Q + 1] + move1, s[at.Q + 2] + move2
    previous, damp = 1e300, 1.0
    for iteration in range(MAX_ITERATIONS):
        v0, v1, v2 = c0 * q0 + p0, c0 * q1 + p1, c0 * q2 + p2
        tangents.forces_of_step(m, rows, uniform, (q0, q1, q2), (v0, v1, v2), recorder, w)
        r0 = w[at.EXTERNAL] + w[at.FORCE] - m.mass * (c0 * v0 + past0)
        r1 = w[at.EXTERNAL + 1] + w[at.FORCE + 1] - m.mass * (c0 * v1 + past1)
        r2 = w[at.EXTERNAL + 2] + w[at.FORCE + 2] - m.inertia * (c0 * v2 + past2)
        rubbing0 = rubbing1 = rubbing2 = 0.0
        if friction:
            held, rubbing0, _ = laws.friction_force(m.radial_friction, s, 0, q0 - s[at.Q])
            r0 -= held
            held, rubbing1, _ = laws.friction_force(m.axial_friction, s, 1, q1 - s[at.Q + 1])
            r1 -= held
            held, rubbing2, _ = laws.friction_force(m.tilt_friction, s, 2, q2 - s[at.Q + 2])
            r2 -= held
        found, step0, step1, step2 = solve3(
            *system(m, w, at.STIFFNESS, at.DAMPING, c0, (rubbing0, rubbing1, rubbing2)),
            r0, r1, r2)
        if not found:
            return FAILED
        size = max(abs(step0), abs(step1), abs(step2) * m.radius)
        if not size < 1e300:
            return FAILED
        # A long Newton step can cycle about a kink: halve the step until the update shrinks.
        damp = max(0.1, 0.5 * damp) if size > 0.9 * previous else min(1.0, 2.0 * damp)
        limit = min(damp, 1e-4 / size) if size > 1e-4 else damp
        q0, q1, q2 = q0 + limit * step0, q1 + limit * step1, q2 + limit * step2
        previous = size
        if size < STEP_TOLERANCE and limit == 1.0:
            error = step_error(m, s, h, q0, q1, q2) * ringing(m, w)
            if error > allowed:
                return TOO_COARSE
            s[at.STEP_ERROR] = error
            s[at.ITERATIONS] += iteration + 1.0
            keep_step(m, s, h, c0, (p0, p1, p2), (past0, past1, past2), (q0, q1, q2), friction, w)
            return SOLVED
    return FAILED


@kernel(**INNER)
def step_error(m, s, h, q0, q1, q2):
    """Estimated error [m] of q by one step of h, from the difference to an explicit step.

    For smooth motions the explicit step q + h v + h^2 a / 2 differs from BDF2 by 5/12 h^3 d3q/dt3,
    and the error of BDF2 is about half of that. A tilt counts at the pitch radius.
    """
    bend = 0.5 * h * h / s[at.STEP_OLD] if s[at.STEP_OLD] > 0.0 else 0.0
    e0 = q0 - s[at.Q] - h * s[at.V] - bend * (s[at.V] - s[at.V_OLD])
    e1 = q1 - s[at.Q + 1] - h * s[at.V + 1] - bend * (s[at.V + 1] - s[at.V_OLD + 1])
    e2 = q2 - s[at.Q + 2] - h * s[at.V + 2] - bend * (s[at.V + 2] - s[at.V_OLD + 2])
    return 0.5 * max(abs(e0), abs(e1), abs(e2) * m.radius)


@kernel(**INNER)
def ringing(m, w):
    """Factor by which the errors of steps add up in a ring that oscillates; 1 with much damping.

    The smallest damping ratio of the three directions counts, each direction by itself. Errors add
    up while a motion lasts, and its duration grows as the inverse of the ratio. The number of
    steps grows too, because a step shrinks with the cube root of the allowed error. Together they
    give the power of 3/2.
    """
    least = 1.0
    for i, inertia in ((0, m.mass), (2, m.mass), (4, m.inertia)):
        stiffness, damping = w[at.STIFFNESS + i], w[at.DAMPING + i]
        if stiffness > 0.0:
            # The square of the damping ratio, as a share of that of USUAL_DAMPING.
            share = damping * damping / (4.0 * USUAL_DAMPING**2 * stiffness * inertia)
            least = min(least, share)
    return 1.0 if least >= 1.0 else max(least, MIN_DAMPING_SHARE) ** -0.75


@kernel(**INNER)
def careful_step(m, rows, uniform, s, h, load, friction, recorder, w):
    """A step of h to a measured load [N], divided where its error is too large.

    The load is linear in between. The first fraction is the fraction at which the last step
    ended. A fraction is halved if its error is too large, and doubled if its error is small
    enough, so that BDF2 continues. Returns the load at the ring [N]. recorder: None, or that of
    `tangents.keep_record`.
    """
    before = s[at.MEASURED_LOAD]
    fraction, done, true_load = s[at.FRACTION], 0.0, 0.0
    while done < 1.0:
        for i in range(at.LOAD_STATES):
            w[at.LOAD_BACKUP + i] = s[at.MEASURED_LOAD + i]
        reached = done + fraction
        aim = load if reached >= 1.0 else before + (load - before) * reached
        true_load = take_load(m, s, aim, w)
        allowed = MAX_STEP_ERROR if fraction > MIN_FRACTION else math.inf
        result = robust_step(m, rows, uniform, s, h * fraction, friction, allowed, recorder, w)
        if result == TOO_COARSE:
            for i in range(at.LOAD_STATES):
                s[at.MEASURED_LOAD + i] = w[at.LOAD_BACKUP + i]
            fraction *= 0.5
            continue
        if result == FAILED:  # Count it, and continue from the equilibrium.
            s[at.FAILED_STEPS] += 1.0
            s[at.STEP_OLD] = 0.0
            found, x, y, tilt = equilibrium(m, rows, uniform, w, s[at.Q], s[at.Q + 1], s[at.Q + 2])
            if found:
                s[at.Q], s[at.Q + 1], s[at.Q + 2] = x, y, tilt
            for i in range(3):
                s[at.V + i] = s[at.V_OLD + i] = 0.0
                s[at.Q_OLD + i] = s[at.Q + i]
        done = reached
        if recorder is not None:
            tangents.keep_record(m, recorder, h * fraction, aim, s, w)
        # A step of twice the length has eight times the error.
        if (fraction < 1.0 and s[at.STEP_ERROR] < 0.05 * MAX_STEP_ERROR
                and done % (2.0 * fraction) == 0.0):
            fraction *= 2.0
    s[at.FRACTION] = fraction
    return true_load


@kernel(**INNER)
def robust_step(m, rows, uniform, s, h, friction, allowed, recorder, w):
    """One implicit step; if Newton fails at a kink, the same step in 4, 16 ... 4096 parts."""
    result = implicit_step(m, rows, uniform, s, h, friction, allowed, recorder, w)
    if result != FAILED:
        return result
    for i in range(at.STATE_SIZE):
        w[at.BACKUP + i] = s[i]
    pieces = 1
    while pieces < 4096:
        pieces *= 4
        for _ in range(pieces):
            result = implicit_step(m, rows, uniform, s, h / pieces, friction, math.inf, recorder,
                                   w)
            if result == FAILED:
                break
        if result == SOLVED:
            return SOLVED
        for i in range(at.STATE_SIZE):
            s[i] = w[at.BACKUP + i]
    return FAILED


@kernel(**INNER)
def take_load(m, s, measured, w):
    """Set the measured load [N] to its next value and advance the friction of the load path."""
    change = measured - s[at.MEASURED_LOAD]
    z_cylinder = z_bracket = 0.0
    if m.cylinder_friction.limit != 0.0:
        z_cylinder = laws.advance_friction(m.cylinder_friction, s, at.CYLINDER_Z, change)
    if m.bracket_play.limit != 0.0:
        z_bracket = laws.advance_friction(m.bracket_play, s, at.BRACKET_Z, change)
    s[at.MEASURED_LOAD] = measured
    s[at.HIGHEST_LOAD] = max(s[at.HIGHEST_LOAD], measured)
    return laws.load_at_ring(m, measured, z_cylinder, z_bracket, w)


@kernel(**INNER)
def follow(m, rows, uniform, s, time, load, max_step, q_out, d_out, recorder, w):
    """Advance state s over the samples time (N,), load (N,); q_out (N, 3) and d_out (N, 4) filled.

    The state itself gives a sample that is not later than the state. s[ITERATIONS] counts Newton
    iterations, s[FAILED_STEPS] the steps that did not converge; their samples are NaN, and the
    state restarts there at equilibrium. Nodes and commands call this function, for one sample or
    for a million.
    """
    friction = (m.radial_friction.limit != 0.0 or m.axial_friction.limit != 0.0
                or m.tilt_friction.limit != 0.0)
    true_load = take_load(m, s, s[at.MEASURED_LOAD], w)
    for n in range(time.size):
        before = s[at.FAILED_STEPS]
        total = time[n] - s[at.TIME]
        if total > 0.0:
            substeps = max(1, int(math.ceil(total / max_step - 1e-6)))
            h = total / substeps
            load_old = s[at.MEASURED_LOAD]
            for k in range(1, substeps + 1):
                measured = load[n]
                if k < substeps:
                    measured = load_old + (load[n] - load_old) * k / substeps
                true_load = careful_step(m, rows, uniform, s, h, measured, friction, recorder, w)
            s[at.TIME] = time[n]
        laws.series_motion(m, s, w)
        laws.advance_series(m, s, w, max(total, 0.0))
        laws.read_probes(m, s, w, true_load, time[n], max(total, 0.0), d_out, n)
        for i in range(3):
            q_out[n, i] = s[at.Q + i]
        if s[at.FAILED_STEPS] != before:
            q_out[n, :] = math.nan
            d_out[n, :] = math.nan


@kernel(**OUTER)
def start(models, rows, uniform, s, time, load):
    """`rest` for models (1,): Numba accepts an array in a twentieth of the time of a record."""
    return rest(models[0], rows, uniform, s, time, load, np.zeros(at.WORK_SIZE))


@kernel(**OUTER)
def advance(models, rows, uniform, s, time, load, max_step, q_out, d_out):
    """`follow` for models (1,)."""
    follow(models[0], rows, uniform, s, time, load, max_step, q_out, d_out, None,
           np.zeros(at.WORK_SIZE))


@kernel(**OUTER)
def run_recorded(models, rows, uniform, time, load, zero_load, max_step, q_out, d_out, records,
                 grows):
    """`run_batch` for models (1,) with records (S, width) of every step, the first at rest.

    grows: with the sums of growing damping.
    """
    m = models[0]
    s, w = np.zeros(at.STATE_SIZE), np.zeros(at.WORK_SIZE)
    parts = np.zeros((3, PARTS))
    recorder = (records, parts, np.zeros(3), grows)
    rest(m, rows, uniform, s, time[0], zero_load, w)
    q, v = s[at.Q:at.Q + 3], s[at.V:at.V + 3]
    tangents.forces_of_step(m, rows, uniform, q, v, recorder, w)
    records[0] = 0.0
    tangents.keep_sums(records[0], parts, w)
    follow(m, rows, uniform, s, time, load, max_step, q_out, d_out, recorder, w)


@kernel(**OUTER)
def run_batch(m, rows, uniform, time, load, zero_load, max_step, q_out, d_out):
    """Simulate each of the models m (B,) over one record.

    Samples that did not converge are NaN. rows (R, 9 J), uniform (R, 3) with R = B or 1;
    q_out (B, N, 3), d_out (B, N, 4).
    """
    s, w = np.zeros(at.STATE_SIZE), np.zeros(at.WORK_SIZE)
    for b in range(m.shape[0]):
        r = b if rows.shape[0] > 1 else 0
        found = rest(m[b], rows[r], uniform[r], s, time[0], zero_load, w)
        follow(m[b], rows[r], uniform[r], s, time, load, max_step, q_out[b], d_out[b], None, w)
        if not found:
            q_out[b] = math.nan
            d_out[b] = math.nan
