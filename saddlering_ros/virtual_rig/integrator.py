"""Compiled numerics of the virtual rig: filters, dry friction, motion by plain sums over rollers.

The filters work on evenly spaced values and are exact for inputs straight between instants. The
laws of friction are exact updates over a short travel: a state z follows a coordinate, |z| <= 1,
and the force is the limit times z. Sources: Jenkins: A. Jenkins 1962 (elastic-plastic spring);
Dahl: P. Dahl 1968, dz/dx = (1 - sgn(dx) z) / travel; LuGre: C. Canudas de Wit et al. 1995, with a
Stribeck level and viscous part; Bouc-Wen: Y.-K. Wen 1976 with n = 2 and beta = gamma = 1/2.

The motion is integrated by Radau IIA with two stages, of third order (Hairer and Wanner, Solving
Ordinary Differential Equations II, section IV.5), which is L-stable and stiffly accurate. Newton's
method on the exact tangent finds the stage positions; a step that does not converge is halved.
"""

from dataclasses import dataclass
import math
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from saddlering_ros.compiled import Compiler
from saddlering_ros.rig import ContactParameters, Rig, RollerRow

compiled = Compiler(Path(__file__))
Floats = NDArray[np.float64]


@compiled()
def recursion(values: Floats, b: Floats, a: Floats) -> Floats:
    """Filter y_n = b_0 x_n + b_1 x_(n-1) + b_2 x_(n-2) + a_1 y_(n-1) + a_2 y_(n-2).

    values (N,); b (3,) and a (2,): the coefficients, a of the outputs one and two instants back.
    """
    output = np.empty(values.shape[0])
    x1, x2, y1, y2 = 0.0, 0.0, 0.0, 0.0
    for n in range(values.shape[0]):
        x0 = values[n]
        y0 = b[0] * x0 + b[1] * x1 + b[2] * x2 + a[0] * y1 + a[1] * y2
        output[n] = y0
        x2, x1, y2, y1 = x1, x0, y1, y0
    return output


def low_pass(values: Floats, spacing: float, time_constant: float) -> Floats:
    """First-order low-pass of values (N,) `spacing` [s] apart; starts at rest."""
    if time_constant <= 0.0:
        return values
    ratio = spacing / time_constant
    keep = np.exp(-ratio)
    mean = -np.expm1(-ratio) / ratio
    moved = recursion(values - values[0], np.array([1.0 - mean, mean - keep, 0.0]),
                      np.array([keep, 0.0]))
    return np.asarray(moved + values[0])


def second_mode(values: Floats, spacing: float, frequency: float, damping: float) -> Floats:
    """Solve y'' + 2 z w y' + w^2 y = w^2 u from rest; frequency w [rad/s]."""
    from scipy.linalg import expm

    block = np.zeros((4, 4))
    block[0, 1], block[1, 0], block[1, 1] = 1.0, -frequency**2, -2.0 * damping * frequency
    block[1, 2], block[2, 3] = frequency**2, 1.0
    flow = expm(block * spacing)
    state, held, second = flow[:2, :2], flow[:2, 2], flow[:2, 3] / spacing
    first = held - second
    cross = np.array([-state[1, 1], state[0, 1]])
    numerator = np.array([second[0], first[0] + float(cross @ second), float(cross @ first)])
    trace, determinant = float(np.trace(state)), float(np.linalg.det(state))
    moved = recursion(values - values[0], numerator, np.array([trace, -determinant]))
    return np.asarray(moved + values[0])


def slow_noise(times: Floats, rms: float, time_constant: float,
               random: np.random.Generator) -> Floats:
    """Ornstein-Uhlenbeck noise (N,) at nearly equal times [s]."""
    spacing = (times[-1] - times[0]) / max(len(times) - 1, 1)
    keep = float(np.exp(-spacing / time_constant))
    driven = random.normal(size=len(times)) * rms * np.sqrt(1.0 - keep * keep)
    driven[0] = random.normal() * rms
    return np.asarray(recursion(driven, np.array([1.0, 0.0, 0.0]), np.array([keep, 0.0])))


JENKINS, DAHL, LUGRE, BOUC_WEN = 0, 1, 2, 3

LAWS = {'jenkins': JENKINS, 'dahl': DAHL, 'lugre': LUGRE, 'bouc_wen': BOUC_WEN}
"""Number of each law by the name users give."""

STRIBECK_EXCESS = 0.25
"""LuGre: static friction over sliding friction, minus 1."""


@compiled()
def follow(law: int, z: float, travel: float, presliding: float, seconds: float,
           stribeck_speed: float) -> tuple[float, float]:
    """State z after moving by `travel` in `seconds`, and its derivative by travel.

    travel and presliding share one unit [m, rad or N]; stribeck_speed is that unit per second.
    """
    if law == JENKINS:
        moved = z + travel / presliding
        if moved > 1.0:
            return 1.0, 0.0
        if moved < -1.0:
            return -1.0, 0.0
        return moved, 1.0 / presliding
    if law == BOUC_WEN:  # dz/ds = 1 while |z| falls, 1 - z^2 while it grows, in closed form.
        steps = travel / presliding
        sign = 1.0 if steps >= 0.0 else -1.0
        start, left = z * sign, abs(steps)
        if start < 0.0:
            if start + left <= 0.0:
                return sign * (start + left), 1.0 / presliding
            left += start
            start = 0.0
        after = math.tanh(math.atanh(min(start, 1.0 - 1e-12)) + left)
        return sign * after, (1.0 - after * after) / presliding
    level = 1.0
    if law == LUGRE and seconds > 0.0:
        speed = travel / seconds / stribeck_speed
        level = 1.0 + STRIBECK_EXCESS * math.exp(-speed * speed)
    goal = level if travel >= 0.0 else -level
    fade = math.exp(-abs(travel) / (presliding * level))
    after = goal + (z - goal) * fade
    return after, abs(goal - z) * fade / (presliding * level)


@compiled()
def hysteresis(law: int, values: Floats, presliding: float, initial: float) -> Floats:
    """State z (N,) of a friction element that follows `values` (N,)."""
    state = np.empty(values.shape[0])
    state[0] = initial
    for n in range(1, values.shape[0]):
        travel = values[n] - values[n - 1]
        state[n] = follow(law, state[n - 1], travel, presliding, 0.0, 1.0)[0]
    return state


# Columns of the roller table.
(BY_X, BY_Y, BY_TILT, GAP, STIFFNESS, EXPONENT, DAMPING, DAMPING_SHARE, DAMPING_EXPONENT,
 DAMPING_THRESHOLD, SOFTENING) = range(11)
ROLLER_COLUMNS = 11

# Columns of the friction table.
F_X, F_Y, F_TILT, F_LIMIT, F_PRESLIDING, F_LAW, F_STRIBECK, F_VISCOUS = range(8)
FRICTION_COLUMNS = 8

TOUCH_DOWN = 1e-6
"""Penetration [m] over which the damper is faded in."""

DAMPING_REFERENCE = 50e-6
"""Penetration [m] at which growing damping equals the constant D."""

RESIDUAL = 1e-4
"""Newton stops when no force or moment is left over by more than this [N, N m]."""

MAX_NEWTON, MAX_HALVINGS = 30, 12
"""A step that so many iterations do not solve is halved, at most to its 4096th part."""

# Inverse of the Radau IIA matrix, times the step; stage times are h/3 and h.
I00, I01, I10, I11 = 1.5, 0.5, -4.5, 2.5
S00, S01, S10, S11 = 0.0, 2.0, -18.0, 4.0


@compiled()
def roller_force(roller: Floats, p: float, rate: float) -> tuple[float, float, float]:
    """Force of one roller [N] at penetration p > 0 and its derivatives by p and by dp/dt."""
    exponent = roller[EXPONENT]
    elastic = roller[STIFFNESS] * p ** exponent
    slope = elastic * exponent / p
    softening = roller[SOFTENING]
    if softening != 0.0:
        weaker = 1.0 / (1.0 + softening * p)
        slope = slope * weaker - elastic * softening * weaker * weaker
        elastic *= weaker
    constant, share, threshold = roller[DAMPING], roller[DAMPING_SHARE], roller[DAMPING_THRESHOLD]
    damping, damping_slope = constant, 0.0
    if share != 0.0 and threshold > 0.0:
        ramp = min(max((p - threshold) / (0.2 * threshold) + 0.5, 0.0), 1.0)
        inside = 0.0 < ramp < 1.0
        steep = 6.0 * ramp * (1.0 - ramp) / (0.2 * threshold) if inside else 0.0
        smooth = ramp * ramp * (3.0 - 2.0 * ramp)
        damping = constant * (1.0 - share + share * smooth)
        damping_slope = constant * share * steep
    elif share != 0.0:
        power = roller[DAMPING_EXPONENT]
        grown = (p / DAMPING_REFERENCE) ** power
        damping = constant * (1.0 - share + share * grown)
        damping_slope = constant * share * power * grown / p
    fade, fade_slope = 1.0, 0.0
    if p < TOUCH_DOWN:
        u = p / TOUCH_DOWN
        fade = u * u * (3.0 - 2.0 * u)
        fade_slope = 6.0 * u * (1.0 - u) / TOUCH_DOWN
    force = elastic + fade * damping * rate
    if force <= 0.0:
        return 0.0, 0.0, 0.0
    by_p = slope + (fade_slope * damping + fade * damping_slope) * rate
    return force, by_p, fade * damping


@compiled()
def contact(rollers: Floats, q: Floats, v: Floats, force: Floats, by_q: Floats,
            by_v: Floats) -> None:
    """Force of all rollers on the upper ring (3,), and minus its derivatives (3, 3), in place."""
    force[:] = 0.0
    by_q[:] = 0.0
    by_v[:] = 0.0
    for index in range(rollers.shape[0]):
        roller = rollers[index]
        bx, by, bt = roller[BY_X], roller[BY_Y], roller[BY_TILT]
        p = bx * q[0] + by * q[1] + bt * q[2] - roller[GAP]
        if p <= 0.0:
            continue
        rate = bx * v[0] + by * v[1] + bt * v[2]
        pressed, by_p, by_rate = roller_force(roller, p, rate)
        if pressed == 0.0:
            continue
        for row in range(3):
            across = roller[row]
            if across == 0.0:
                continue
            force[row] -= across * pressed
            for column in range(3):
                by_q[row, column] += across * by_p * roller[column]
                by_v[row, column] += across * by_rate * roller[column]


@compiled()
def _add_friction(friction: Floats, z: Floats, moved: Floats, v: Floats, seconds: float,
                  force: Floats, by_q: Floats, by_v: Floats) -> None:
    """Add the friction elements' forces after moving by `moved` (3,) from where z holds."""
    for element in range(friction.shape[0]):
        row = friction[element]
        travel = row[0] * moved[0] + row[1] * moved[1] + row[2] * moved[2]
        law = int(row[F_LAW])
        state, slope = follow(law, z[element], travel, row[F_PRESLIDING], seconds, row[F_STRIBECK])
        limit = row[F_LIMIT]
        viscous = row[F_VISCOUS] if law == LUGRE else 0.0
        speed = row[0] * v[0] + row[1] * v[1] + row[2] * v[2]
        total = limit * state + viscous * speed
        for i in range(3):
            force[i] -= row[i] * total
            for j in range(3):
                by_q[i, j] += row[i] * limit * slope * row[j]
                by_v[i, j] += row[i] * viscous * row[j]


@compiled()
def _stage_residual(rollers: Floats, friction: Floats, z: Floats, mass: Floats, q: Floats,
                    v: Floats, h: float, load: Floats, stages: Floats, residual: Floats,
                    matrix: Floats, scratch: Floats) -> float:
    """Residual (6,) of both stages at positions `stages` (2, 3), its matrix, its largest."""
    rate = np.empty((2, 3))
    for i in range(3):
        first, second = stages[0, i] - q[i], stages[1, i] - q[i]
        rate[0, i] = (I00 * first + I01 * second) / h
        rate[1, i] = (I10 * first + I11 * second) / h
    force, by_q, by_v = scratch[0], scratch[1:4], scratch[4:7]
    largest = 0.0
    moved = np.empty(3)
    for stage in range(2):
        contact(rollers, stages[stage], rate[stage], force, by_q, by_v)
        for i in range(3):
            moved[i] = stages[stage, i] - q[i]
        seconds = h / 3.0 if stage == 0 else h
        _add_friction(friction, z, moved, rate[stage], seconds, force, by_q, by_v)
        a, b = (I00, I01) if stage == 0 else (I10, I11)
        c, d = (S00, S01) if stage == 0 else (S10, S11)
        for i in range(3):
            acceleration = (a * (rate[0, i] - v[i]) + b * (rate[1, i] - v[i])) / h
            left = mass[i] * acceleration - force[i] - load[stage, i]
            residual[3 * stage + i] = left
            largest = max(largest, abs(left))
            for j in range(3):
                inertia = mass[i] / (h * h) if i == j else 0.0
                first = c * inertia + a / h * by_v[i, j]
                second = d * inertia + b / h * by_v[i, j]
                if stage == 0:
                    first += by_q[i, j]
                else:
                    second += by_q[i, j]
                matrix[3 * stage + i, j] = first
                matrix[3 * stage + i, 3 + j] = second
    return largest


@compiled()
def _try_step(rollers: Floats, friction: Floats, z: Floats, mass: Floats, q: Floats, v: Floats,
              h: float, load: Floats, stages: Floats) -> bool:
    """Find the two stage positions (2, 3), starting from those given."""
    residual, trial_residual, scratch = np.empty(6), np.empty(6), np.empty((7, 3))
    matrix, trial_matrix, trial = np.empty((6, 6)), np.empty((6, 6)), np.empty((2, 3))
    error = _stage_residual(rollers, friction, z, mass, q, v, h, load, stages, residual, matrix,
                            scratch)
    for _ in range(MAX_NEWTON):
        if error < RESIDUAL:
            return True
        residual[:] = np.linalg.solve(matrix, residual)
        largest = np.abs(residual).max()
        if not largest < 1.0:
            return False
        share, trial_error = 1.0, math.inf
        for _ in range(8):
            trial[:] = stages - share * residual.reshape(2, 3)
            trial_error = _stage_residual(rollers, friction, z, mass, q, v, h, load, trial,
                                          trial_residual, trial_matrix, scratch)
            if trial_error < error or largest * share < 1e-14:
                break
            share *= 0.5
        stages[:] = trial
        residual[:] = trial_residual
        matrix[:] = trial_matrix
        error = trial_error
        if largest < 1e-13:
            return True
    return False


@compiled()
def _advance(rollers: Floats, friction: Floats, z: Floats, mass: Floats, q: Floats, v: Floats,
             seconds: float, before: Floats, middle: Floats, after: Floats) -> int:
    """Advance q, v, z in place by `seconds`, loads (3,) given at its start, third and end."""
    left, halvings, failed_steps = 1.0, 0, 0
    load, stages = np.empty((2, 3)), np.empty((2, 3))
    while left > 1e-12:
        share = min(left, 0.5 ** halvings)
        h = share * seconds
        done = 1.0 - left
        for i in range(3):
            load[0, i] = _between(before[i], middle[i], after[i], done + share / 3.0)
            load[1, i] = _between(before[i], middle[i], after[i], done + share)
            stages[0, i] = q[i] + v[i] * h / 3.0
            stages[1, i] = q[i] + v[i] * h
        good = _try_step(rollers, friction, z, mass, q, v, h, load, stages)
        if not good and halvings < MAX_HALVINGS:
            halvings += 1
            continue
        if not good:
            failed_steps += 1
        for element in range(friction.shape[0]):
            row = friction[element]
            travel = 0.0
            for i in range(3):
                travel += row[i] * (stages[1, i] - q[i])
            z[element] = follow(int(row[F_LAW]), z[element], travel, row[F_PRESLIDING], h,
                                row[F_STRIBECK])[0]
        for i in range(3):
            first, second = stages[0, i] - q[i], stages[1, i] - q[i]
            v[i] = (I10 * first + I11 * second) / h
            q[i] = stages[1, i]
        left -= share
    return failed_steps


@compiled()
def _between(before: float, middle: float, after: float, share: float) -> float:
    """The parabola through values at 0, 1/3 and 1, at `share`."""
    first = (middle - before) * 3.0
    second = (after - middle) * 1.5
    return before + share * (first + (share - 1.0 / 3.0) * (second - first))


@compiled()
def settle(rollers: Floats, friction: Floats, z: Floats, mass: Floats, load: Floats,
           start: Floats) -> tuple[Floats, int]:
    """Rest position (3,) under a constant load (3,), friction held at z; steps grow to minutes."""
    q, v, held = start.copy(), np.zeros(3), load.copy()
    for element in range(friction.shape[0]):
        held -= friction[element, :3] * friction[element, F_LIMIT] * z[element]
    failed_steps, h = 0, 1e-4
    for _ in range(60):
        failed_steps += _advance(rollers, friction[:0], z, mass, q, v, h, held, held, held)
        h = min(h * 1.4, 100.0)
    return q, failed_steps


@compiled()
def integrate(rollers: Floats, friction: Floats, z: Floats, mass: Floats, start: Floats,
              step: float, loads: Floats) -> tuple[Floats, int]:
    """Motion under loads (3 N + 1, 3) given at thirds of N equal steps, from rest at `start`.

    Returns positions (N + 1, 3), and how many steps did not converge.
    """
    positions = np.empty(((loads.shape[0] - 1) // 3 + 1, 3))
    q, v, z = start.copy(), np.zeros(3), z.copy()
    positions[0] = q
    failed_steps = 0
    for n in range(1, positions.shape[0]):
        failed_steps += _advance(rollers, friction, z, mass, q, v, step, loads[3 * n - 3],
                                 loads[3 * n - 2], loads[3 * n])
        positions[n] = q
    return positions, failed_steps


@dataclass(frozen=True)
class Scatter:
    """How rollers differ: rms of their gaps [m] and of their stiffness (share)."""

    gap: float = 0.7e-6
    stiffness: float = 0.02


@dataclass
class Rollers:
    """Rollers of all three rows."""

    table: Floats  # (N, ROLLER_COLUMNS)
    spans: dict[str, slice]  # rows of the table of 'upper', 'lower' and 'middle'
    random: np.random.Generator  # for effects that deal rollers out, the same for a rig

    def of(self, row: str) -> Floats:
        """The part of the table that holds this row (a view)."""
        return self.table[self.spans[row]]

    def angles(self, row: str) -> Floats:
        """Angle phi of this row's rollers [rad], 0 at the rear."""
        count = len(self.of(row))
        return 2.0 * np.pi * np.arange(count) / count


def make_rollers(rig: Rig, contact: ContactParameters, scatter: Scatter, seed: int) -> Rollers:
    """The rollers of one rig; the same `seed` is the same rig."""
    random = np.random.default_rng([seed, 304])
    axial = (contact.K1, contact.n1, contact.D1)
    radial = (contact.K2, contact.n2, contact.D2)
    parts = {
        'upper': _row(rig.axial_rows, axial, 1.0), 'lower': _row(rig.axial_rows, axial, -1.0),
        'middle': _row(rig.radial_row, radial, 0.0)}
    spans, start = {}, 0
    for name, table in parts.items():
        spans[name] = slice(start, start + len(table))
        start += len(table)
        table[:, GAP] += scatter.gap * random.normal(size=len(table))
        table[:, STIFFNESS] *= np.maximum(
            1.0 + scatter.stiffness * random.normal(size=len(table)), 0.1)
    return Rollers(np.concatenate(list(parts.values())), spans, random)


def _row(row: RollerRow, law: tuple[float, float, float], side: float) -> Floats:
    """One row: side +1 upper, -1 lower, 0 middle; penetration = b . (x, y, tilt) - gap."""
    table = np.zeros((row.rollers, ROLLER_COLUMNS))
    cosine = np.cos(2.0 * np.pi * np.arange(row.rollers) / row.rollers)
    if side == 0.0:
        table[:, BY_X], table[:, BY_TILT] = cosine, row.height * cosine
    else:
        table[:, BY_Y], table[:, BY_TILT] = side, -side * row.pitch_radius * cosine
    table[:, GAP] = 0.5 * row.clearance
    table[:, STIFFNESS], table[:, EXPONENT], table[:, DAMPING] = law
    return table
