"""Uncertainty of identified parameters: covariance, determination, imperfections.

The residuals are whitened by the noise the runs show at rest, autocorrelation included, so that
covariance = (J^T J)^-1 in the search coordinates (ln K, n, ln D). Where the run that fits worst
fits worse than that noise, it is widened by that run's mean square residual (Birge ratio). The
effect of unequal rollers is added: the estimate is G r with G = J^+, so that residuals r of
covariance I + S S^T (S: small_errors.py) give it the covariance G G^T + G S S^T G^T. So is that of
waves of the raceways, where the misfit shows them (ring_errors.py).
"""

from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass
from itertools import combinations, compress
import math
from typing import Any

import numpy as np

from saddlering_ros.estimation.least_squares import covariance, SearchSpace
from saddlering_ros.estimation.process import Array
from saddlering_ros.identification.objective import Refinement, WeightedObjective
from saddlering_ros.identification.ring_errors import degrees_of_freedom, RingErrors, unlike, Waves
from saddlering_ros.quantities import compact, WIDTH_95
from saddlering_ros.rig import PARAMETER_NAMES, Rig
from saddlering_ros.ring.small_errors import certified_errors, SmallError, with_error

DELAY = 1e-3
"""Delay [s] of the probes whose effect is reported."""

IMPERFECTIONS: Mapping[str, SmallError] = {
    'load_nonlinearity': {'load_nonlinearity': {'curvature': 1e-3}},
    'axial_clearance': {'axial_clearance': {'change': 5e-6}},
    'radial_clearance': {'radial_clearance': {'change': 5e-6}},
    'elevation': {'elevation_error': {'angle': float(np.radians(0.1))}},
    'load_gain': {'load_gain': {'gain': -0.005}}, 'delay': {'clock_offset': {'offset': DELAY}},
    'probe_gains': {'probe_gain': {'probe': 0.0, 'gain': 0.005}}}  # 0: of all four
"""Small errors that no fit can detect; the change of the parameters by each is reported."""

def usual_errors(rig: Rig) -> list[SmallError]:
    """One deviation of each small error of a rig of which no certificate states another one."""
    errors: list[SmallError] = [
        *IMPERFECTIONS.values(), {'moment_arm': {'offset': MOMENT_ARM}},
        {'load_offset': {'offset': LOAD_OFFSET * rig.full_scale_load}},
        *({'probe_lag': {'probe': float(probe), 'time': DELAY}} for probe in rig.probes.present)]
    stated = {name for error in certified_errors(rig).values() for name in error}
    return [error for error in errors if not stated & error.keys()]


MOMENT_ARM, LOAD_OFFSET = 2e-3, 5e-4
"""Usual errors of the height of the trunnion [m], and of the zero of a load cell as a share of
full scale."""

IMPERFECTION_WORDS = {
    'load_nonlinearity': '0.1 % of full scale load nonlinearity',
    'axial_clearance': '5 µm of axial clearance', 'radial_clearance': '5 µm of radial clearance',
    'elevation': '0.1 deg of elevation', 'load_gain': '0.5 % of load gain',
    'delay': '1 ms between the clocks of load and probes',
    'probe_gains': '0.5 % of gain of all four probes alike'}


@dataclass(frozen=True)
class Uncertainty:
    """Uncertainty of one result; arrays over the six parameters, NaN if held."""

    std: Array  # in the parameters' units
    covariance: Array  # (6, 6)
    noise_covariance: Array  # (6, 6), by noise alone: changes by another test of the same ring
    correlation: Array  # (6, 6)
    intervals: dict[str, tuple[float, float] | None]  # 95 %, in the units; None if open
    systematic: dict[str, Array]  # shift (6,) in coordinates by imperfection
    reasons: dict[str, str]  # why a parameter is open, by name
    reasons_even: dict[str, str]  # the same if the raceways were even
    waves: Waves  # of the raceways, as far as the misfit shows them
    collinearity: dict[str, float]  # by subset of names ('K1,n1')
    reduced_chi_square: float  # per degree of freedom, 1 if the misfit equals the noise
    sound_factor: float  # rms misfit over that of noise and small errors of a sound ring together
    budget: dict[str, dict[str, float]]  # per free parameter the share of its variance by source
    joint: dict[str, dict[str, Any]]  # by 'K1,n1', 'K2,n2': `joint_axes`, bounds

    @property
    def determined(self) -> dict[str, bool]:
        """Whether the data determine a parameter, by name."""
        return {name: name not in self.reasons for name in PARAMETER_NAMES}


def assess(objective: WeightedObjective, space: SearchSpace, best: Refinement, errors: RingErrors,
           bounds: dict[str, tuple[float, float]], misfit_advice: str, *,
           is_minimum: bool = True) -> Uncertainty:
    """Judge a fit in its `space`; misfit_advice: remedy for a misfit.

    is_minimum: whether it was refined; else the linear step to the minimum is an error, too.
    """
    reduced = best.chi_square / degrees_of_freedom(objective, best)
    widening = max(1.0, reduced, *objective.mean_squares(best.contact))
    inverse = np.asarray(np.linalg.pinv(best.jacobian, rcond=1e-9), dtype=np.float64)
    certified = certified_errors(objective.rig)
    changes = objective.changes(best.contact, [
        with_error(objective.rig, one) for one in (*IMPERFECTIONS.values(), *certified.values())])
    shifts = objective.whiten(changes) @ inverse.T
    systematic = {name: _spread_over_six(shift, space)
                  for name, shift in zip(IMPERFECTIONS, shifts, strict=False)}
    of_instruments = dict(zip(certified, shifts[len(IMPERFECTIONS):], strict=True))
    # Delay of logger and filters between load and probes, within the limits from the readings.
    lag = max(one.doubtful_lag for one in objective.observations)
    late = systematic['delay'][space.free] * lag / DELAY
    at_noise = covariance(best.jacobian)
    if objective.common is not None:  # The part of the readings alone.
        of_readings = objective.common.apply(inverse.T)
        at_noise = of_readings.T @ of_readings
    step = inverse @ objective.residuals(best.contact[None])[0] * (not is_minimum)
    by_noise = at_noise * widening + np.outer(late, late)
    by_rollers, by_waves, by_others = (moved @ moved.T for moved in (
        inverse @ each.T for each in (errors.rollers, errors.each_wave, errors.others)))
    of_misfit = np.outer(step, step)
    even = by_noise + of_misfit + by_rollers + by_others + sum(
        (np.outer(shift, shift) for shift in of_instruments.values()), np.zeros_like(by_noise))
    inner = even + by_waves
    total, on_even, of_noise, without_misfit = (
        _spread_over_six(np.sqrt(np.diag(matrix)), space) for matrix in (
            inner, even, by_noise, even - of_misfit - at_noise * (widening - 1.0)))
    scale = space.scale(best.contact)
    whole = _with_bounds_alone(inner * np.outer(scale, scale), space, bounds)
    std = np.sqrt(np.diag(whole))
    elevations = distinct_elevations(one.elevation for one in objective.observations)
    reasons, reasons_even = (
        _reasons(space, best, systematic, [in_all, of_noise, without_misfit], elevations,
                 misfit_advice) for in_all in (total, on_even))
    # Shares of the variance by source: GUM, JCGM 100, 5.1.
    variances = {'noise': np.diag(by_noise + of_misfit), 'unequal_rollers': np.diag(by_rollers),
                 **({'raceway_waves': np.diag(by_waves)} if errors.waves.rms else {}),
                 **({'other_errors': np.diag(by_others)} if len(errors.others) else {}),
                 **{name: shift**2 for name, shift in of_instruments.items()}}
    variance = sum(variances.values(), np.zeros(len(space.free)))
    return Uncertainty(
        std=np.where([name not in reasons for name in PARAMETER_NAMES], std, np.nan),
        covariance=whole,
        noise_covariance=_with_bounds_alone(by_noise * np.outer(scale, scale), space, bounds),
        correlation=np.asarray(whole / np.outer(std, std)),
        intervals=_intervals(space, best, total, reasons),
        systematic=systematic,
        reasons=reasons,
        reasons_even=reasons_even,
        waves=errors.waves,
        collinearity=collinearity(best.jacobian, space.names),
        reduced_chi_square=float(reduced),
        sound_factor=_sound_factor(objective, best, errors.sound),
        budget={name: {source: float(part[position] / variance[position])
                       for source, part in variances.items()}
                for position, name in enumerate(space.names)},
        joint={f'K{row},n{row}': _joint_entry(row, best.contact, whole, bounds)
               for row in (1, 2) if {f'K{row}', f'n{row}'} <= set(space.names)})


JOINT_RADIUS = math.sqrt(-2.0 * math.log(0.05))
"""Radius [standard deviations] of the joint 95 % region of two parameters: the root of the 95 %
quantile of chi square with two degrees of freedom."""


def joint_axes(covariance: Array) -> Array:
    """Half axes (2, 2) of the joint 95 % ellipse, a row each, the longest first."""
    variances, directions = np.linalg.eigh(covariance)
    half_axes = JOINT_RADIUS * np.sqrt(np.maximum(variances, 0.0)) * directions
    return np.asarray(half_axes.T[::-1])


def _joint_entry(row: int, contact: Array, whole: Array,
                 bounds: dict[str, tuple[float, float]]) -> dict[str, Any]:
    """The ellipse of a row in (ln K, n), where the uncertainty of K is symmetric."""
    names = [f'K{row}', f'n{row}']
    pair = [PARAMETER_NAMES.index(name) for name in names]
    scale = np.array([1.0 / contact[pair[0]], 1.0])
    return {'half_axes': joint_axes(whole[np.ix_(pair, pair)] * np.outer(scale, scale)).tolist(),
            'coordinates': [f'ln {names[0]}', names[1]],
            'bounds': {name: list(bounds[name]) for name in names}}


def joint_outline(stiffness: float, exponent: float, entry: Mapping[str, Any]) -> Array:
    """Outline (2, P) of a joint region in K and n about the estimate, within the bounds."""
    angle = np.linspace(0.0, 2.0 * np.pi, 181)
    log_change, change = np.asarray(entry['half_axes']).T @ [np.cos(angle), np.sin(angle)]
    of_stiffness, of_exponent = entry['bounds'].values()
    log_stiffness = np.clip(math.log(stiffness) + log_change,
                            *np.log(np.maximum(of_stiffness, 1e-9)))
    return np.stack([np.exp(log_stiffness), np.clip(exponent + change, *of_exponent)])


STATIC_ALONE = '{} needs a dynamic run: a static reading does not depend on it'
ONE_ELEVATION = ('{} from one elevation depends on the curvature only{}; add a run at another '
                 'elevation')

MAX_LEVERAGE, MAX_OVER_MEAN = 0.5, 20.0
"""Leverage of one reading, and its multiple of the mean, beyond which a fit has no linear errors.
Ten fits of shipped bags, sound or scaled, have 0.06 to 0.23. A simulated ring that the load turns
within its clearance has 0.97: it flies from wall to wall, at a time that every parameter moves."""

LONE_READING = ('the simulated ring crosses its clearance there: see to zero, sign and unit of '
                'the load')


def _reasons(space: SearchSpace, best: Refinement, systematic: dict[str, Array],
             deviations: Sequence[Array], elevations: int, misfit_advice: str) -> dict[str, str]:
    """Why the data leave a parameter open, by its name.

    deviations (6,) in coordinates: in all, by noise alone, in all if the misfit were the noise.
    """
    reasons: dict[str, str | None] = {}
    leverage = (np.linalg.qr(best.jacobian)[0] ** 2).sum(axis=1)
    is_lone = leverage.max() > max(MAX_LEVERAGE, MAX_OVER_MEAN * leverage.mean())
    stopped = reasons_at_bounds(set(compress(space.names, best.at_bound)))
    for index, name in enumerate(PARAMETER_NAMES):
        if is_lone:
            reasons[name] = f'{name} would rest on one reading alone; {LONE_READING}'
            continue
        if name not in space.names:
            reasons[name] = STATIC_ALONE.format(name) if name[0] == 'D' else f'{name} was held'
            continue
        if name in stopped:
            reasons[name] = stopped[name]
            continue
        worst = max(IMPERFECTIONS, key=lambda one: abs(systematic[one][index]))
        reasons[name] = reason_open(
            name, [deviation[index] for deviation in deviations],
            abs(float(systematic[worst][index])), IMPERFECTION_WORDS[worst], elevations,
            misfit_advice)
    return {name: reason for name, reason in reasons.items() if reason is not None}


def _intervals(space: SearchSpace, best: Refinement, deviations: Array,
               reasons: Mapping[str, str]) -> dict[str, tuple[float, float] | None]:
    """95 % intervals, None of an open parameter; deviations (6,) in coordinates."""
    intervals: dict[str, tuple[float, float] | None] = dict.fromkeys(PARAMETER_NAMES)
    for position, index in enumerate(space.free):
        if PARAMETER_NAMES[index] in reasons:
            continue
        ends = best.point[position] + WIDTH_95 * deviations[index] * np.array([-1.0, 1.0])
        low, high = np.exp(ends) if space.logarithmic[index] else ends
        intervals[PARAMETER_NAMES[index]] = (float(low), float(high))
    return intervals


def _spread_over_six(values: Array, space: SearchSpace) -> Array:
    six = np.full(len(PARAMETER_NAMES), np.nan)
    six[space.free] = values
    return six


def _with_bounds_alone(covariance: Array, space: SearchSpace,
                       bounds: dict[str, tuple[float, float]]) -> Array:
    """(6, 6) covariance; a held parameter has the variance of its bounds."""
    six = np.diag([(high - low) ** 2 / 12.0 for low, high in (bounds[n] for n in PARAMETER_NAMES)])
    six[np.ix_(space.free, space.free)] = covariance
    return np.asarray(six)


def _sound_factor(objective: WeightedObjective, best: Refinement, sound: Array) -> float:
    """Rms misfit over that of noise and small errors of a sound ring together.

    sound: whitened residuals (M, R) by unequal rollers, clearances and the weight. The parameters
    are fitted beside them: r' (I + S S')^-1 r, with S less what parameters imitate.
    """
    residual, errors = objective.residuals(best.contact[None])[0], unlike(best, sound)
    along = errors @ residual
    inner = np.eye(len(errors)) + errors @ errors.T
    left = residual @ residual - along @ np.linalg.solve(inner, along)
    return math.sqrt(max(float(left), 0.0) / degrees_of_freedom(objective, best))


MAX_HALF_WIDTH = {'K': float(np.log(1.5)), 'n': 0.5 * (10.0 / 9.0 - 1.0), 'D': float(np.log(2.0))}
"""Widest half 95 % interval, in (ln K, n, ln D), of a parameter that counts as determined.

K within a factor 1.5; n separates line contact (10/9) and a linear spring (1); D within a
factor 2.
"""


def reason_wide(name: str, std: float, elevations: int) -> str | None:
    """Why a parameter of standard deviation `std` (in coordinates) is open; None if it is not."""
    half = WIDTH_95 * std
    if half <= MAX_HALF_WIDTH[name[0]]:
        return None
    factor = f'a factor {compact(float(np.exp(min(half, 50.0))))}'
    what = f'± {half:.2f}' if name[0] == 'n' else factor
    advice = 'add a run at another elevation' if elevations < 2 else 'add more or longer runs'
    if name[0] == 'D':
        advice = 'add a faster dynamic run'
    return f'{name} is known only within {what} (95 %) from these data: {advice}'


def reason_of_tests(name: str, std: float, elevations: int, *, is_static: bool) -> str | None:
    """Why tests leave a parameter of standard deviation `std` (in coordinates) open, or None."""
    if reason := reason_wide(name, std, elevations):
        return reason
    if name[0] == 'n' and elevations < 2:
        return ONE_ELEVATION.format(name, '')
    return STATIC_ALONE.format(name) if name[0] == 'D' and is_static else None


def reason_open(name: str, deviations: Sequence[float], shift: float, imperfection: str,
                elevations: int, misfit_advice: str) -> str | None:
    """Why an identified parameter is open; None if it is not.

    deviations (coordinates): in all, of noise alone, and in all for a misfit as large as the
    noise. shift (coordinates): its change by `imperfection`, the worst small one that no fit can
    detect: with one elevation n, and K of a large shift, depend on the curvature alone.
    """
    std, of_noise, without_misfit = deviations
    reason = reason_wide(name, std, elevations)
    if reason is not None:
        width, _, advice = reason.partition(' from these data: ')
        if reason_wide(name, without_misfit, elevations) is None:
            return f'{width}, because the misfit exceeds the noise: {misfit_advice}'
        if reason_wide(name, of_noise, elevations) is not None:
            return reason
        advice = 'longer runs do not help' if elevations > 1 or name[0] == 'D' else advice
        return f'{width} on a ring whose rollers may be unequal: {advice}'
    tolerable = shift + WIDTH_95 * std <= MAX_HALF_WIDTH[name[0]]
    if name[0] == 'D' or elevations > 1 or (name[0] == 'K' and tolerable):
        return None
    moved = f'{shift:.3f}' if name[0] == 'n' else f'{100.0 * np.expm1(min(shift, 50.0)):.0f} %'
    return ONE_ELEVATION.format(name, f': {imperfection} would change it by {moved}')


def reasons_at_bounds(stopped: Collection[str]) -> dict[str, str]:
    """Why parameters are open, by name, where those of `stopped` are at their bounds.

    A curve over the load has nearly the same shape for another pair of K and n.
    """
    reasons = {f'{other}{name[1]}': f'{other}{name[1]} depends on {name}, which is at its bound'
               for name in stopped if (other := {'K': 'n', 'n': 'K'}.get(name[0]))}
    return reasons | {name: f'{name} is at its bound: the best value may lie outside'
                      for name in stopped}


MAX_SOUND = 1.1
"""Rms misfit, over that of noise and small errors of a sound ring, up to which nothing else shows.
Of 16 sound rings of the virtual rig 14 have 0.94 to 1.04, and two with 0.1 µm of noise 1.12 and
1.17."""

MIN_SOUND = 0.75
"""The same, of runs of which one is dynamic, below which the noise is not that of the readings.

On 48 sets of runs of 12 sound rings it was 0.92 to 1.07. Where the load was averaged over 5 or
10 s, or the probes were low-passed alone, it was 0.28 to 0.73 on three rings. Damping was wrong
by up to 15 stated deviations then, without a word. A probe that picks up the mains leaves 0.80,
and no error."""

TOO_QUIET = ('the misfit is {:.2f} times the noise, less than noise can leave: the probes move '
             'while the load stands still, as they do where load or probes are filtered more or '
             'stamped later than the other, or where probes pick up the mains: values and '
             'intervals may be wrong; record all channels with the same filter and clock')

UNDETERMINED = 'not determined by these data'


def undetermined_words(name: str, value: str, reason: str) -> str:
    """A parameter that data do not determine, as every command prints it."""
    return f'{name}: {UNDETERMINED} (best known {value}): {reason}'


def distinct_elevations(elevations: Iterable[float]) -> int:
    """Number of elevations [rad] that differ by more than a degree."""
    return len({round(float(np.degrees(elevation))) for elevation in elevations})


def collinearity(jacobian: Array, names: Sequence[str]) -> dict[str, float]:
    """Collinearity index (Brun et al. 2001) of each pair and of all: 1/sqrt(smallest eigenvalue).

    Columns scaled to unit length; 1 is orthogonal, above 10 to 15 means not separable in practice.
    """
    length = np.linalg.norm(jacobian, axis=0)
    unit = jacobian / np.where(length > 0.0, length, 1.0)
    subsets = [*combinations(range(len(names)), 2), tuple(range(len(names)))]
    return {
        ','.join(names[i] for i in subset): float(
            1.0 / max(np.linalg.svd(unit[:, list(subset)], compute_uv=False)[-1], 1e-12))
        for subset in dict.fromkeys(subsets)}


def at_bound(space: SearchSpace, best: Refinement) -> dict[str, bool]:
    """Whether a parameter is at a bound, by name."""
    return {name: name in space.names and bool(best.at_bound[space.names.index(name)])
            for name in PARAMETER_NAMES}
