"""A ring simulator of its own: written from the equations of the ring model and of nothing else.

It shares no code with `saddlering_ros.ring` and the virtual rig. 304 rollers are summed one by
one, each with its own stiffness and gap; a stiffly accurate Runge-Kutta method of two stages
(SDIRK2, gamma = 1 - 1/sqrt(2)) steps static and dynamic tests alike. Every fault has a form of
its own, richer than that of the catalogue: friction is a sum of sliders, creep has three
relaxations, a worn arc is a cosine, saturation is soft. SI units.
"""

from collections.abc import Callable
from dataclasses import dataclass, field, replace
import math

import numba
import numpy as np
from numpy.typing import NDArray

from saddlering_ros.rig import default_rig, Rig

Array = NDArray[np.float64]
GAMMA = 1.0 - 1.0 / math.sqrt(2.0)
TOUCH = 1e-6
"""Penetration [m] over which damping sets in."""
SLIDERS = 12


@dataclass(frozen=True)
class Sliders:
    """Dry friction against one coordinate: sliders in parallel that yield one after another."""

    total: float = 0.0
    travel: float = 1.0

    def springs(self) -> tuple[Array, Array]:
        """Stiffness and yield force of each slider; they yield from 0.2 to 1.8 times `travel`."""
        share = np.full(SLIDERS, 1.0 / SLIDERS) * self.total
        return share / (self.travel * np.linspace(0.2, 1.8, SLIDERS)), share


Adding = Callable[['Motion'], Array]


@dataclass(frozen=True)
class Fault:
    """What is wrong with a rig. Neutral by default.

    ring_load maps the measured load to the load at the ring (time and load as arguments);
    turn: angle of the load line from the record by time and load [rad]; series: what joints add
    to (delta_x, delta_y, gamma) of the rollers, (samples, 3); readings: what probes add,
    (samples, 4);
    gap_axial: what is added to the gaps of both axial rows; gap_lower: to that of the lower one;
    late: how much later [s] each probe is stamped; lag: time constant [s] of each probe.
    """

    ring_load: Callable[[Array, Array], Array] | None = None
    turn: Callable[[Array, Array], Array] | None = None
    arm: float = 0.0
    clearance: tuple[float, float] = (0.0, 0.0)
    lower_row: float = 1.0
    gap_axial: Callable[[Array], Array] | None = None
    gap_lower: Callable[[Array], Array] | None = None
    gap_radial: Callable[[Array], Array] | None = None
    friction_x: Sliders = Sliders()
    friction_y: Sliders = Sliders()
    friction_tilt: Sliders = Sliders()
    damping_exponent: float = 0.0
    series: tuple[Adding, ...] = ()
    readings: tuple[Adding, ...] = ()
    late: tuple[float, ...] = (0.0,) * 4
    lag: tuple[float, ...] = (0.0,) * 4


@dataclass(frozen=True)
class Motion:
    """One run: time [s], measured load [N], forces on the ring (N, 3), motion of C (N, 3) from
    zero.

    d: increments of the four probes (N, 4), where they are known.
    """

    rig: Rig
    time: Array
    load: Array
    forces: Array
    motion: Array
    d: Array = field(default_factory=lambda: np.zeros((0, 4)))


@dataclass(frozen=True)
class Ring:
    """Contact of one ring: K [N/m^n], n, D [N s/m] of both kinds of row; scatter of rollers.

    phases: angle of the first axial and radial rollers, as a share of the pitch between two.
    """

    K1: float = 1.29e8
    n1: float = 10.0 / 9.0
    D1: float = 3e6
    K2: float = 1.29e8
    n2: float = 10.0 / 9.0
    D2: float = 3e6
    scatter: float = 0.01
    seed: int = 0
    phases: tuple[float, float] = (0.0, 0.0)


@numba.njit(cache=False)
def _row(out, jq, jv, w, rate, wq, K, n, D, power, gap, sign):  # type: ignore[no-untyped-def]
    """Add one roller: w its motion, wq the gradient of w by q, sign the side of its gap."""
    p = sign * w - gap
    if p <= 0.0:
        return
    pdot = sign * rate
    s = 1.0
    ds = 0.0
    if p < TOUCH:
        u = p / TOUCH
        s = u * u * (3.0 - 2.0 * u)
        ds = 6.0 * u * (1.0 - u) / TOUCH
    grown = 1.0
    dgrown = 0.0
    if power > 0.0:
        grown = (p / 4e-5) ** power
        dgrown = power * grown / p
    damp = D * s * grown
    force = K * p**n + damp * pdot
    if force <= 0.0:
        return
    dp = n * K * p ** (n - 1.0) + D * (ds * grown + s * dgrown) * pdot
    for i in range(3):
        out[i] -= sign * force * wq[i]
        for k in range(3):
            jq[i, k] -= dp * wq[i] * wq[k]
            jv[i, k] -= damp * wq[i] * wq[k]


@numba.njit(cache=False)
def _sum(q, v, out, jq, jv, cosa, Ka, gup, glow, Klow, cosm, Km, gm, law, geo):  # type: ignore[no-untyped-def]
    """Forces of all rollers on the upper ring, with their derivatives by q and v."""
    out[:] = 0.0
    jq[:] = 0.0
    jv[:] = 0.0
    wq = np.zeros(3)
    for i in range(cosa.size):
        wq[0], wq[1], wq[2] = 0.0, 1.0, -geo[0] * cosa[i]
        w = q[1] + wq[2] * q[2]
        rate = v[1] + wq[2] * v[2]
        _row(out, jq, jv, w, rate, wq, Ka[i], law[0], law[1], law[4], gup[i], 1.0)
        _row(out, jq, jv, w, rate, wq, Klow[i], law[0], law[1], law[4], glow[i], -1.0)
    for i in range(cosm.size):
        wq[0], wq[1], wq[2] = cosm[i], 0.0, geo[1] * cosm[i]
        w = q[0] * wq[0] + q[2] * wq[2]
        rate = v[0] * wq[0] + v[2] * wq[2]
        _row(out, jq, jv, w, rate, wq, Km[i], law[2], law[3], law[4], gm[i], 1.0)


@numba.njit(cache=False)
def _run(steps, forces_a, forces_b, q0, mass, rows, sliders, law, geo):  # type: ignore[no-untyped-def]
    """SDIRK2 over all steps; forces_a and forces_b are the loads at the two stages of each."""
    cosa, Ka, gup, glow, Klow, cosm, Km, gm = rows
    stiff, limit = sliders
    held = np.zeros(stiff.shape)
    count = steps.size
    track = np.zeros((count + 1, 3))
    q, v = q0.copy(), np.zeros(3)
    track[0] = q
    out, jq, jv = np.zeros(3), np.zeros((3, 3)), np.zeros((3, 3))
    for step in range(count):
        h = steps[step]
        a1, v1 = np.zeros(3), np.zeros(3)
        qs, vs = q.copy(), v.copy()
        for stage in range(2):
            load = forces_a[step] if stage == 0 else forces_b[step]
            qb, vb = q.copy(), v.copy()
            if stage == 1:
                qb = q + h * (1.0 - GAMMA) * v1
                vb = v + h * (1.0 - GAMMA) * a1
            g = h * GAMMA
            acc = np.zeros(3)
            for _ in range(60):
                qs = qb + g * vs
                _sum(qs, vs, out, jq, jv, cosa, Ka, gup, glow, Klow, cosm, Km, gm, law, geo)
                for axis in range(3):
                    for j in range(stiff.shape[1]):
                        trial = held[axis, j] + stiff[axis, j] * (qs[axis] - q[axis])
                        if trial > limit[axis, j]:
                            trial = limit[axis, j]
                        elif trial < -limit[axis, j]:
                            trial = -limit[axis, j]
                        else:
                            jq[axis, axis] -= stiff[axis, j]
                        out[axis] -= trial
                acc = (load + out) / mass
                left = vs - vb - g * acc
                matrix = np.eye(3)
                for i in range(3):
                    for k in range(3):
                        matrix[i, k] -= g * (g * jq[i, k] + jv[i, k]) / mass[i]
                change = np.linalg.solve(matrix, left)
                vs = vs - change
                if np.max(np.abs(change)) * g < 1e-14:
                    break
            qs = qb + g * vs
            acc = (vs - vb) / g
            if stage == 0:
                v1, a1 = vs.copy(), acc.copy()
        for axis in range(3):
            for j in range(stiff.shape[1]):
                trial = held[axis, j] + stiff[axis, j] * (qs[axis] - q[axis])
                held[axis, j] = min(max(trial, -limit[axis, j]), limit[axis, j])
        q, v = qs, vs
        track[step + 1] = q
    return track


def forces_of(rig: Rig, fault: Fault, degrees: float, time: Array, load: Array) -> Array:
    """F_x, F_y and M on the upper ring, (samples, 3)."""
    at_ring = load if fault.ring_load is None else fault.ring_load(time, load)
    angle = math.radians(degrees) + (0.0 if fault.turn is None else fault.turn(time, load))
    cos, sin = np.cos(angle), np.sin(angle)
    arm = (rig.trunnion.y + fault.arm) * cos + rig.trunnion.x * sin
    carriage = rig.carriage
    return np.stack([at_ring * cos, -at_ring * sin - carriage.weight,
                     at_ring * arm + carriage.weight * carriage.weight_x], axis=1)


def simulate(ring: Ring, fault: Fault, degrees: float, time: Array, load: Array,
             rig: Rig | None = None) -> Motion:
    """The motion of C from its place at time[0], where the ring has settled."""
    rig = rig or default_rig()
    draw = np.random.default_rng(ring.seed)
    axial, middle = rig.axial_rows, rig.radial_row
    phia, phim = (2.0 * np.pi * (np.arange(row.rollers) + phase) / row.rollers
                  for row, phase in zip((axial, middle), ring.phases, strict=True))

    def scattered(value: float, count: int) -> Array:
        return np.asarray(value * (1.0 + ring.scatter * draw.standard_normal(count)))

    half_axial = 0.5 * (axial.clearance + fault.clearance[0]) + np.zeros(axial.rollers)
    half_middle = 0.5 * (middle.clearance + fault.clearance[1]) + np.zeros(middle.rollers)
    if fault.gap_axial is not None:
        half_axial = half_axial + fault.gap_axial(phia)
    half_lower = half_axial + (0.0 if fault.gap_lower is None else fault.gap_lower(phia))
    if fault.gap_radial is not None:
        half_middle = half_middle + fault.gap_radial(phim)
    upper = scattered(ring.K1, axial.rollers)
    lower = scattered(ring.K1 * fault.lower_row, axial.rollers)
    rows = (np.cos(phia), upper, half_axial, half_lower, lower,
            np.cos(phim), scattered(ring.K2, middle.rollers), half_middle)
    springs = [own.springs() for own in (fault.friction_x, fault.friction_y, fault.friction_tilt)]
    sliders = (np.stack([item[0] for item in springs]), np.stack([item[1] for item in springs]))
    law = np.array([ring.n1, ring.D1, ring.n2, ring.D2, fault.damping_exponent])
    geo = np.array([axial.pitch_radius, middle.height])
    mass = np.array([rig.carriage.mass, rig.carriage.mass, rig.carriage.inertia])

    settle = np.full(60, 1.0)  # from rest off the ring to its place, before the record begins
    steps = np.concatenate([settle, np.diff(time)])
    whole = np.concatenate([time[0] - 60.0 + np.arange(60), time])
    loads = np.concatenate([np.full(60, load[0]), load])
    points_a = whole[:-1] + GAMMA * steps
    first = forces_of(rig, fault, degrees, points_a, np.interp(points_a, whole, loads))
    second = forces_of(rig, fault, degrees, whole[1:], loads[1:])
    track = _run(steps, first, second, np.array([2e-5, -2e-5, 2e-5]), mass, rows, sliders, law,
                 geo)[60:]
    motion = Motion(rig, time, load, forces_of(rig, fault, degrees, time, load), track)
    own = track.copy()
    for adding in fault.series:
        own = own + adding(motion)
    return replace(motion, motion=own - own[0])


def increments(motion: Motion, fault: Fault) -> Array:
    """What the four probes read as increments, (samples, 4)."""
    probes = motion.rig.probes
    dx, dy, tilt = motion.motion.T
    half = 0.5 * probes.axial_span
    radial = dx + tilt * probes.radial_height
    d = np.stack([radial, dy + half * tilt, -radial, dy - half * tilt], axis=1)
    for adding in fault.readings:
        d = d + adding(replace(motion, d=d))
    for number, constant in enumerate(fault.lag):
        if constant > 0.0:
            d[:, number] = low_pass(motion.time, d[:, number], constant)
    return np.asarray(d - d[0])


def low_pass(time: Array, signal: Array, constant: float) -> Array:
    """First-order low-pass, exact for a signal that is straight between its samples."""
    out = signal.copy()
    for i in range(1, time.size):
        h = time[i] - time[i - 1]
        decay = math.exp(-h / constant)
        slope = (signal[i] - signal[i - 1]) / h
        out[i] = (signal[i] - slope * constant
                  + (out[i - 1] - signal[i - 1] + slope * constant) * decay)
    return out


@dataclass(frozen=True)
class Course:
    """A test: its kind, elevation, sampling rate [Hz] and corners (times [s], loads [N])."""

    name: str
    test: str
    degrees: float
    rate: float
    corners: tuple[tuple[float, float], ...]

    def samples(self) -> tuple[Array, Array]:
        """Stamps [s] and loads [N]."""
        at, value = np.array(self.corners).T
        time = np.arange(0.0, at[-1], 1.0 / self.rate)
        return time, np.interp(time, at, value)


def static_course(degrees: float, rig: Rig, rate: float = 20.0) -> Course:
    """Up and down in steps of 1/25 of full scale, each held for 5 s; moved within 1 s."""
    levels = np.linspace(rig.preload, rig.full_scale_load, 26)
    corners = [(0.0, rig.preload)]
    at = 0.0
    for level in [*levels, *levels[-2::-1]]:
        corners += [(at + 1.0, float(level)), (at + 6.0, float(level))]
        at += 6.0
    return Course(f'static_{degrees:g}', 'static', degrees, rate, tuple(corners))


def ramp_course(degrees: float, rig: Rig, ramp: float, name: str, rate: float = 1000.0) -> Course:
    """Rest, up, rest, down, rest."""
    low, high = rig.preload, rig.full_scale_load
    stay = 1.5
    corners = ((0.0, low), (stay, low), (stay + ramp, high), (2 * stay + ramp, high),
               (2 * stay + 2 * ramp, low), (3 * stay + 2 * ramp, low))
    return Course(name, 'dynamic', degrees, rate, corners)


def usual_courses(rig: Rig) -> tuple[Course, ...]:
    """Four courses to fit and one to hold out (the last)."""
    return (static_course(50.0, rig), ramp_course(50.0, rig, 5.0, 'dynamic_50'),
            ramp_course(50.0, rig, 1.25, 'dynamic_50_fast'), static_course(70.0, rig),
            ramp_course(70.0, rig, 4.0, 'dynamic_70'))


def other_courses(rig: Rig) -> tuple[Course, ...]:
    """Fresh data of the same rig, by other tests: three to fit and one to hold out."""
    return (static_course(60.0, rig), ramp_course(60.0, rig, 4.0, 'dynamic_60'),
            ramp_course(45.0, rig, 2.0, 'dynamic_45'), ramp_course(65.0, rig, 3.0, 'dynamic_65'))


@dataclass(frozen=True)
class Noise:
    """Instruments: load [N] and probes [m], white and slow (rms), and how long slow lasts [s]."""

    load: float = 40.0
    probe: float = 1.2e-7
    slow: float = 3e-8
    lasting: float = 0.4


def coloured(draw: np.random.Generator, noise: Noise, count: int, rate: float) -> Array:
    """White noise and a slow part of one probe."""
    keep = math.exp(-1.0 / (rate * noise.lasting))
    kicks = draw.standard_normal(count) * noise.slow * math.sqrt(1.0 - keep * keep)
    slow = np.zeros(count)
    last = noise.slow * draw.standard_normal()
    for i in range(count):
        last = keep * last + kicks[i]
        slow[i] = last
    return slow + noise.probe * draw.standard_normal(count)


@dataclass(frozen=True)
class Record:
    """One run as recorded: stamps [s] of load and of each probe, load [N], increments (N, 4)."""

    course: Course
    time: Array
    load: Array
    probe_times: tuple[Array, ...]
    d: Array


def record(ring: Ring, fault: Fault, course: Course, seed: int, noise: Noise | None = None,
           rig: Rig | None = None) -> Record:
    """Simulate one course and add noise and stamps."""
    noise = noise or Noise()
    rig = rig or default_rig()
    time, load = course.samples()
    motion = simulate(ring, fault, course.degrees, time, load, rig)
    d = increments(motion, fault)
    draw = np.random.default_rng([seed, 77])
    d = d + np.stack([coloured(draw, noise, time.size, course.rate) for _ in range(4)], axis=1)
    shown = load + noise.load * draw.standard_normal(time.size)
    times = tuple(time + own for own in fault.late)
    return Record(course, time, shown, times, d)
