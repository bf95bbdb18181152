"""Sessions as arrays, error control over many of them, and rings that differ from their sisters.

A ring is described by six coordinates: log stiffness of both contacts at a reference penetration,
exponents, and log damping. K and n of one contact are all but exchangeable (their correlation is
above 0.99); the stiffness at the penetration where the ring works is what a session measures.

At 1 % a verdict, a thousand sound sessions give ten false alarms: Benjamini and Hochberg, J. R.
Stat. Soc. B 57 (1995) 289; e-values: Vovk and Wang, Ann. Stat. 49 (2021) 1736; e-BH: Wang and
Ramdas, J. R. Stat. Soc. B 84 (2022) 822. Rings differ as theta_ring ~ N(mu, T), from sessions of
known covariance: T by restricted maximum likelihood (Patterson and Thompson, Biometrika 58 (1971)
545), which pays for the mean that is estimated too.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
import math
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import minimize
from scipy.stats import chi2, false_discovery_control

from saddlering_ros.errors import SaddleringError
from saddlering_ros.quantities import lowered
from saddlering_ros.rig import PARAMETER_NAMES

Array = NDArray[np.float64]

COORDINATES = ('stiffness_1', 'exponent_1', 'damping_1', 'stiffness_2', 'exponent_2', 'damping_2')
"""log(K p^(n-1)) [log N/m], n, log D [log N s/m], of the axial rows (1) and the radial row (2)."""

REFERENCE_PENETRATION = 2e-5
"""Penetration [m] of the reference stiffness: half of that at full load."""

MAX_DEVIATION = 1.0
"""A logarithm known no better than this is not a measurement."""

LEVEL = 0.05
"""Largest share of false findings among sessions, among rings, and among drifts."""

MIN_RINGS = 4
"""Smallest number of rings that shows the usual spread."""

MAX_PASSES = 5
"""Populations fitted at most while rings that stand out are taken from them."""

MIN_SPREAD = 1e-4
"""Rings never agree better than this in a logarithm or an exponent."""


class FleetError(SaddleringError):
    """Sessions or limits that fleet statistics cannot use."""


@dataclass(frozen=True)
class SessionFigures:
    """One session: value (6,) and covariance (6, 6) of COORDINATES, NaN where not measured.

    time [s since 1970] and service_hours of the test, NaN if unknown; causes: size and standard
    deviation of every effect named, by its id; titles: of each and its alternatives; change: what
    changed since the base measurement of the ring in one sentence, '' if nothing did.
    """

    key: str
    name: str
    ring: str
    bench: str
    time: float
    service_hours: float
    maintenance: bool
    verdict: str
    p_value: float
    value: Array
    covariance: Array
    causes: Mapping[str, tuple[float, float]]
    next_test: str = ''
    report: str = ''
    change: str = ''
    titles: Mapping[str, str] = field(default_factory=dict)


def figures_of(task: Mapping[str, Any], result: Mapping[str, Any], p_value: float
               ) -> SessionFigures:
    """Figures of one result; a failed session has no values."""
    document, change = result.get('verdict') or {}, result.get('change') or {}
    value, covariance = np.full(6, np.nan), np.full((6, 6), np.nan)
    after = (document.get('parameters') or {}).get('after') or {}
    if result.get('covariance') and all(after.get(name) is not None for name in PARAMETER_NAMES):
        value, covariance = to_coordinates(
            np.array([float(after[name]) for name in PARAMETER_NAMES]),
            np.asarray(result['covariance'], dtype=float))
    named = [cause for cause in document.get('causes') or []
             if 'effect' in cause and not cause.get('partial')]
    causes = {
        cause['effect']: (float(size['value']), float(size['std'] or math.nan))
        for cause in named for size in list((cause.get('parameters') or {}).values())[:1]}
    time, service_hours = (float(math.nan if task[name] is None else task[name])
                           for name in ('time', 'service_hours'))
    return SessionFigures(
        result['key'], task['name'], task['ring'], task['bench'], time, service_hours,
        bool(task['maintenance']), document.get('verdict') or 'failed', p_value, value, covariance,
        causes, document.get('next_test') or '', result.get('report') or '',
        '' if change.get('verdict') in (None, 'none') else change['headline'].rstrip('.'),
        {cause['effect']: ' or '.join(map(lowered, cause['titles']))
         for cause in named if cause.get('titles')})


def to_coordinates(parameters: Array, covariance: Array) -> tuple[Array, Array]:
    """Values (6,) and covariance (6, 6) of COORDINATES from K, n, D of both contacts (SI).

    A damping that the tests do not determine (static ones alone) becomes NaN.
    """
    depth = math.log(REFERENCE_PENETRATION)
    value, slopes = parameters.copy(), np.eye(6)
    for stiffness, exponent, damping in ((0, 1, 2), (3, 4, 5)):
        value[stiffness] = math.log(parameters[stiffness]) + (parameters[exponent] - 1.0) * depth
        value[damping] = math.log(parameters[damping])
        slopes[stiffness, exponent] = depth
        for place in (stiffness, damping):
            slopes[place, place] = 1.0 / parameters[place]
    spread = slopes @ covariance @ slopes.T
    unknown = ~(np.sqrt(np.abs(np.diag(spread))) < MAX_DEVIATION)
    value[unknown] = np.nan
    spread[unknown, :] = spread[:, unknown] = np.nan
    return value, spread


def benjamini_hochberg(p_values: Sequence[float] | Array) -> NDArray[np.bool_]:
    """Which findings (N,) stand when at most the share LEVEL of them may be false."""
    return np.asarray(false_discovery_control(np.fmin(p_values, 1.0)) <= LEVEL)


def e_value(p_values: Sequence[float]) -> float:
    """Evidence of a ring's sessions against a sound ring: independent e-values are multiplied.

    That of one is 1/2 p^(-1/2), whose mean is at most 1 if the ring is sound.
    """
    logs = -np.log(2.0 * np.sqrt(np.maximum(p_values, 1e-300)))
    return float(np.exp(min(logs.sum(), 700.0)))


@dataclass(frozen=True)
class Population:
    """mean (P,), its covariance (P, P), and covariance T (P, P) of rings about it."""

    mean: Array
    mean_covariance: Array
    between: Array


@dataclass(frozen=True)
class Unlikeness:
    """How one ring differs from its sisters: z-scores (P,), p-value of all, whether it stands."""

    z_scores: Array
    p_value: float
    stands: bool


def scatter_inflation(rings: Sequence[tuple[Array, Array]]) -> float:
    """By how much sessions of one ring scatter more than their covariances, in variance, >= 1.

    rings: values (S, P) and covariances (S, P, P) of the sessions of each. By the median over
    pairs of neighbours in time, which neither a drift nor a repair moves much.
    """
    ratios = [
        float((after - before) @ np.linalg.solve(one + other, after - before))
        for values, covariances in rings
        for before, after, other, one in zip(
            values, values[1:], covariances, covariances[1:], strict=False)]
    return max(1.0, float(np.median(ratios) / chi2.median(len(COORDINATES)))) if ratios else 1.0


def weighted_mean(means: Array, covariances: Array,
                  between: Array | float = 0.0) -> tuple[Array, Array, Array]:
    """Mean (P,) of R values, its covariance (P, P), and the weight (R, P, P) of each value."""
    weights = np.linalg.inv(covariances + between)
    mean_covariance = np.linalg.inv(weights.sum(axis=0))
    mean = mean_covariance @ np.einsum('rij,rj->i', weights, means)
    return np.asarray(mean), np.asarray(mean_covariance), np.asarray(weights)


def fit_population(means: Array, covariances: Array) -> Population:
    """REML fit to rings' means (R, P) with covariances (R, P, P)."""
    size = means.shape[1]
    lower, diagonal = np.tril_indices(size), np.diag_indices(size)
    scale = np.sqrt(np.maximum(means.var(axis=0), MIN_SPREAD**2))
    both = np.outer(scale, scale)
    scaled, scaled_covariances = means / scale, covariances / both

    def between(theta: Array) -> Array:
        root = np.zeros((size, size))
        root[lower] = theta
        root[diagonal] = np.exp(root[diagonal])
        return np.asarray(root @ root.T)

    def cost(theta: Array) -> float:
        spread = between(theta)
        mean, mean_covariance, weights = weighted_mean(scaled, scaled_covariances, spread)
        apart = scaled - mean
        quadratic = np.einsum('ri,rij,rj->', apart, weights, apart)
        logs = (np.linalg.slogdet(scaled_covariances + spread)[1].sum()
                - np.linalg.slogdet(mean_covariance)[1])
        return float(0.5 * (quadratic + logs))

    is_diagonal = lower[0] == lower[1]
    optimum = minimize(cost, np.where(is_diagonal, -0.5, 0.0), method='L-BFGS-B', bounds=[
        (-9.0, 4.0) if here else (-20.0, 20.0) for here in is_diagonal])
    mean, mean_covariance, _ = weighted_mean(scaled, scaled_covariances, between(optimum.x))
    return Population(mean * scale, mean_covariance * both, between(optimum.x) * both)


def unlike_sisters(means: Array, covariances: Array) -> tuple[list[Unlikeness], Population]:
    """Which of R rings (R, P) is unlike the others, at most the share LEVEL of them falsely.

    Rings that stand out are taken from the population and it is fitted anew, so that a bad ring
    does not make its own spread look usual. Each is judged by its sisters without itself. R is
    MIN_RINGS at least; the population is that of the usual rings.
    """
    usual = np.ones(len(means), dtype=bool)
    for _ in range(MAX_PASSES):
        population = fit_population(means[usual], covariances[usual])
        weight = np.linalg.inv(population.mean_covariance)
        z_scores, p_values = [], []
        for value, covariance, is_usual in zip(means, covariances, usual, strict=True):
            spread = covariance + population.between
            centre, around = population.mean, population.mean_covariance
            if is_usual:  # the mean of the sisters alone
                itself = np.linalg.inv(spread)
                around = np.linalg.inv(weight - itself)
                centre = around @ (weight @ population.mean - itself @ value)
            apart, spread = value - centre, spread + around
            p_values.append(float(chi2.sf(apart @ np.linalg.solve(spread, apart), apart.size)))
            z_scores.append(apart / np.sqrt(np.diag(spread)))
        stands = benjamini_hochberg(p_values)
        if (usual == ~stands).all() or (~stands).sum() < MIN_RINGS:
            break
        usual = ~stands
    return [Unlikeness(z, p, bool(is_unlike)) for z, p, is_unlike in zip(
        z_scores, p_values, stands, strict=True)], population
