"""Laws that effects add to the ring: load path, friction, series motion, readings of probes."""

import math

from saddlering_ros.ring.kernels import layout as at
from saddlering_ros.ring.kernels.layout import INNER, kernel


@kernel(**INNER)
def hysteron(z_smooth, z_sharp, travel, presliding, sharpness):
    """Rate-independent friction after `travel`: (z_smooth, z_sharp, z, dz/dtravel).

    z_smooth follows Dahl's law dz/dx = (1 - sgn(dx) z)/presliding, solved exactly over the step.
    z_sharp is the elastic-plastic (Jenkins) element with the same initial slope.
    """
    sign = 1.0 if travel >= 0.0 else -1.0
    decay = math.exp(-abs(travel) / presliding)
    smooth = sign - (sign - z_smooth) * decay
    smooth_slope = (1.0 - sign * z_smooth) * decay / presliding
    trial = z_sharp + travel / presliding
    sharp = min(1.0, max(-1.0, trial))
    sharp_slope = 1.0 / presliding if -1.0 < trial < 1.0 else 0.0
    return (smooth, sharp, sharpness * sharp + (1.0 - sharpness) * smooth,
            sharpness * sharp_slope + (1.0 - sharpness) * smooth_slope)


HELD_SHARE = 0.99
"""Largest share of the radial load that friction takes at rest. Friction cannot push the ring:
with more, the ring would begin on the other side of its clearance."""


@kernel(**INNER)
def state_at_rest(element, i, w):
    """State of friction i at rest under w[EXTERNAL]; radial friction takes no more than a share.

    The cylinder loads a ring in one radial direction only. A tilt can be held after a load the
    other way.
    """
    load = w[at.EXTERNAL + i]
    if i == 0 and load > 0.0 and element.limit * element.initial > HELD_SHARE * load:
        return HELD_SHARE * load / element.limit
    return element.initial


@kernel(**INNER)
def friction_force(element, s, i, travel):
    """Force [N or N m] of friction i after `travel` [m or rad], its slope, its mean slope."""
    if element.limit == 0.0:
        return 0.0, 0.0, 0.0
    z_smooth, z_sharp = s[at.FRICTION_Z + 2 * i], s[at.FRICTION_Z + 2 * i + 1]
    _, _, z, slope = hysteron(z_smooth, z_sharp, travel, element.presliding, element.sharpness)
    secant = slope
    if abs(travel) > 1e-6 * element.presliding:
        before = element.sharpness * z_sharp + (1.0 - element.sharpness) * z_smooth
        secant = (z - before) / travel
    return element.limit * z, element.limit * slope, element.limit * secant


@kernel(**INNER)
def advance_friction(element, s, place, travel):
    """Advance the two states of a friction at a place of s over `travel`; its z."""
    s[place], s[place + 1], z, _ = hysteron(
        s[place], s[place + 1], travel, element.presliding, element.sharpness)
    return z


@kernel(**INNER)
def load_at_ring(m, measured, z_cylinder, z_bracket, w):
    """Set w[EXTERNAL] (3,), with dead weight, and w[RESOLVED], without, by the load `measured`.

    Resolved: F_x, F_y, M of the load alone, by which series compliances deform. Returns P.
    """
    full_scale = m.full_scale
    load = measured / (1.0 + m.load_gain) - m.load_offset
    load += 4.0 * m.load_nonlinearity * measured * (full_scale - measured) / full_scale
    load -= m.cylinder_friction.limit * z_cylinder
    cosine, sine = m.cosine, m.sine
    if m.bracket_play.limit != 0.0:
        elevation = m.elevation + m.elevation_error + m.bracket_play.limit * z_bracket
        cosine, sine = math.cos(elevation), math.sin(elevation)
    w[at.RESOLVED] = load * cosine
    w[at.RESOLVED + 1] = -load * sine
    w[at.RESOLVED + 2] = load * ((m.trunnion_y + m.moment_arm) * cosine
                                 + m.trunnion_x * sine)
    w[at.EXTERNAL] = w[at.RESOLVED]
    w[at.EXTERNAL + 1] = w[at.RESOLVED + 1] - m.weight
    w[at.EXTERNAL + 2] = w[at.RESOLVED + 2] + m.weight * m.weight_x
    return load


@kernel(**INNER)
def load_at_rest(m, s, load, w):
    """Set the load path to its state at the start; the load at the ring."""
    s[at.CYLINDER_Z] = s[at.CYLINDER_Z + 1] = m.cylinder_friction.initial
    s[at.BRACKET_Z] = s[at.BRACKET_Z + 1] = m.bracket_play.initial
    s[at.MEASURED_LOAD] = s[at.HIGHEST_LOAD] = load
    return load_at_ring(m, load, m.cylinder_friction.initial, m.bracket_play.initial, w)


@kernel(**INNER)
def low_pass(state, old, new, dt, time_constant):
    """State of a first-order low-pass after dt; exact for an input linear from `old` to `new`."""
    if time_constant <= 0.0:
        return new
    ratio = dt / time_constant
    decay = math.exp(-ratio)
    if ratio < 1e-6:
        mean_weight = 0.5 * ratio
    else:
        mean_weight = 1.0 - (1.0 - decay) / ratio
    return state * decay + old * (1.0 - decay - mean_weight) + new * mean_weight


@kernel(**INNER)
def opened(beyond, spread):
    """Mean of max(0, beyond - s) over s from -spread to spread [N m]: bolts open one by one."""
    if spread <= 0.0:
        return max(0.0, beyond)
    inside = min(max(beyond + spread, 0.0), 2.0 * spread)
    return inside * inside / (4.0 * spread) + max(0.0, beyond - spread)


@kernel(**INNER)
def series_motion(m, s, w):
    """Set w[MOTION] (3,): contact motion, series compliances, settling; no creep or resonance.

    A joint opens at one moment of load and dead weight together.
    """
    highest = s[at.HIGHEST_LOAD]
    moment = w[at.RESOLVED + 2]
    w[at.MOTION] = (s[at.Q] + m.radial_compliance * w[at.RESOLVED]
                    + m.settling_x * highest)
    w[at.MOTION + 1] = (s[at.Q + 1] + m.axial_compliance * w[at.RESOLVED + 1]
                        + m.settling_y * highest)
    w[at.MOTION + 2] = (s[at.Q + 2] + m.tilt_compliance * moment
                        + m.settling_tilt * highest
                        + m.opening_compliance * opened(
                            moment + m.weight * m.weight_x - m.opening_moment,
                            m.opening_spread))


@kernel(**INNER)
def advance_series(m, s, w, dt):
    """Add creep and second mode to w[MOTION] over dt; their states are in s."""
    for i in range(3):
        amount = m.creep_radial if i == 0 else m.creep_axial
        if amount != 0.0:
            s[at.CREEP + i] = low_pass(s[at.CREEP + i], s[at.CREEP_INPUT + i], w[at.MOTION + i],
                                       dt, m.creep_time)
            s[at.CREEP_INPUT + i] = w[at.MOTION + i]
            w[at.MOTION + i] += amount * s[at.CREEP + i]
    frequency = m.resonance_frequency
    if frequency <= 0.0:
        return
    zeta = min(m.resonance_damping, 0.999)
    damped = frequency * math.sqrt(1.0 - zeta * zeta)
    decay = math.exp(-zeta * frequency * dt)
    cosine, sine = math.cos(damped * dt), math.sin(damped * dt)
    for i in range(3):
        old, new = s[at.RESONANCE_INPUT + i], w[at.MOTION + i]
        slope = (new - old) / dt if dt > 0.0 else 0.0
        lag = 2.0 * zeta / frequency * slope     # distance behind a ramp
        x = s[at.RESONANCE + i] - (old - lag)
        rate = s[at.RESONANCE_RATE + i] - slope
        swing = (rate + zeta * frequency * x) / damped
        x_new = decay * (x * cosine + swing * sine)
        rate_new = -zeta * frequency * x_new + decay * damped * (swing * cosine - x * sine)
        s[at.RESONANCE + i] = x_new + new - lag
        s[at.RESONANCE_RATE + i] = rate_new + slope
        s[at.RESONANCE_INPUT + i] = new
        w[at.MOTION + i] = new + m.resonance_share[i] * (s[at.RESONANCE + i] - new)


@kernel(**INNER)
def read_probes(m, s, w, load, time, dt, out, n):
    """Set probe increments out[n] (4,) [m] from w[MOTION], with the effects of the measurement."""
    half_span = 0.5 * m.axial_span
    x = w[at.MOTION] - s[at.ZERO]
    y = w[at.MOTION + 1] - s[at.ZERO + 1]
    tilt = w[at.MOTION + 2] - s[at.ZERO + 2]
    radial = x + (m.probe_plane_height + m.probe_height) * tilt
    oval = m.ovalisation * (w[at.RESOLVED] - s[at.ZERO_FORCE_X])
    out[n, 0] = radial + oval
    out[n, 1] = y + tilt * half_span
    out[n, 2] = -radial + oval
    out[n, 3] = y - tilt * half_span
    elapsed = time - s[at.START_TIME]
    angle = 2.0 * math.pi * m.pickup_frequency * elapsed
    for i in range(4):
        d = out[n, i] + m.probe_bracket[i] * (load - s[at.ZERO_LOAD])
        d = d * (1.0 + m.probe_gain[i]) + m.probe_nonlinearity[i] * d * d
        lag = m.probe_lag[i]
        if lag > 0.0:
            second = lag * m.probe_lag_second[i]
            old = s[at.LAGGED + i]
            s[at.LAGGED + i] = low_pass(old, s[at.LAG_INPUT + i], d, dt, lag - second)
            s[at.LAG_INPUT + i] = d
            d = low_pass(s[at.LAGGED_TWICE + i], old, s[at.LAGGED + i], dt, second)
            s[at.LAGGED_TWICE + i] = d
        d += m.probe_drift[i] * elapsed
        if m.pickup_cosine[i] != 0.0 or m.pickup_sine[i] != 0.0:
            d += (m.pickup_cosine[i] * math.cos(angle)
                  + m.pickup_sine[i] * math.sin(angle))
        out[n, i] = min(max(d, m.saturation_low[i]), m.saturation_high[i])
