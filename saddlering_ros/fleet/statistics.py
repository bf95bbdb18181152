"""Error control over many sessions and rings, and differences of rings of one kind.

At 1 % a verdict, a thousand sound sessions give ten false alarms: Benjamini and Hochberg, J. R.
Stat. Soc. B 57 (1995) 289; e-values: Vovk and Wang, Ann. Stat. 49 (2021) 1736; e-BH: Wang and
Ramdas, J. R. Stat. Soc. B 84 (2022) 822. Rings differ as theta_ring ~ N(mu, T), from sessions of
known covariance: T by restricted maximum likelihood (Patterson and Thompson, Biometrika 58 (1971)
545), which pays for the mean that is estimated too.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import minimize
from scipy.stats import chi2, false_discovery_control

Array = NDArray[np.float64]


LEVEL = 0.05
"""Largest share of false findings among sessions, among rings, and among drifts."""


def benjamini_hochberg(p_values: Sequence[float] | Array) -> NDArray[np.bool_]:
    """Which findings (N,) stand when at most the share LEVEL of them may be false."""
    return np.asarray(false_discovery_control(np.fmin(p_values, 1.0)) <= LEVEL)


def e_value(p_values: Sequence[float]) -> float:
    """Evidence of a ring's sessions against a sound ring: independent e-values are multiplied.

    That of one is 1/2 p^(-1/2), whose mean is at most 1 if the ring is sound.
    """
    logs = -np.log(2.0 * np.sqrt(np.maximum(p_values, 1e-300)))
    return float(np.exp(min(logs.sum(), 700.0)))


MIN_RINGS = 4
"""Smallest number of rings that shows the usual spread."""

MAX_PASSES = 5
MIN_SPREAD = 1e-4
"""Rings never agree better than this in a logarithm or an exponent."""


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


def combined(values: Sequence[Array], covariances: Sequence[Array], inflation: float
             ) -> tuple[Array, Array]:
    """Weighted mean (P,) of a ring's sessions and its covariance (P, P)."""
    weight = np.zeros((values[0].size, values[0].size))
    pull = np.zeros(values[0].size)
    for value, covariance in zip(values, covariances, strict=True):
        inverse = np.linalg.inv(inflation * covariance)
        weight += inverse
        pull += inverse @ value
    spread = np.linalg.inv(weight)
    return np.asarray(spread @ pull), np.asarray(spread)


def scatter_inflation(rings: Sequence[tuple[Sequence[Array], Sequence[Array]]]) -> float:
    """By how much sessions of one ring scatter more than their covariances, in variance, >= 1.

    By the median over pairs of neighbours in time, which neither a drift nor a repair moves much.
    """
    ratios, count = [], 1
    for values, covariances in rings:
        for first in range(len(values) - 1):
            apart = values[first + 1] - values[first]
            spread = covariances[first + 1] + covariances[first]
            ratios.append(float(apart @ np.linalg.solve(spread, apart)))
            count = apart.size
    if not ratios:
        return 1.0
    return max(1.0, float(np.median(ratios)) / float(chi2.median(count)))


def fit_population(means: Array, covariances: Array) -> Population:
    """REML fit to rings' means (R, P) with covariances (R, P, P)."""
    size = means.shape[1]
    lower = np.tril_indices(size)
    spread = np.maximum(means.var(axis=0), MIN_SPREAD**2)
    scale = np.sqrt(spread)
    scaled = means / scale
    scaled_covariances = covariances / np.outer(scale, scale)

    def between(theta: Array) -> Array:
        root = np.zeros((size, size))
        root[lower] = theta
        diagonal = np.diag_indices(size)
        root[diagonal] = np.exp(root[diagonal])
        return np.asarray(root @ root.T)

    def cost(theta: Array) -> float:
        mean, mean_covariance, total, inverse = _weighted(scaled, scaled_covariances,
                                                          between(theta))
        apart = scaled - mean
        quadratic = np.einsum('ri,rij,rj->', apart, inverse, apart)
        logs = np.linalg.slogdet(total)[1].sum() - np.linalg.slogdet(mean_covariance)[1]
        return float(0.5 * (quadratic + logs))

    start = np.zeros(lower[0].size)
    start[lower[0] == lower[1]] = -0.5
    bounds = [(-9.0, 4.0) if row == column else (-20.0, 20.0)
              for row, column in zip(*lower, strict=True)]
    found = minimize(cost, start, method='L-BFGS-B', bounds=bounds)
    covariance = between(found.x)
    mean, mean_covariance, _, _ = _weighted(scaled, scaled_covariances, covariance)
    both = np.outer(scale, scale)
    return Population(mean * scale, mean_covariance * both, covariance * both)


def _weighted(
    means: Array, covariances: Array, between: Array
) -> tuple[Array, Array, Array, Array]:
    total = covariances + between
    inverse = np.linalg.inv(total)
    mean_covariance = np.linalg.inv(inverse.sum(axis=0))
    mean = mean_covariance @ np.einsum('rij,rj->i', inverse, means)
    return (np.asarray(mean), np.asarray(mean_covariance), np.asarray(total), np.asarray(inverse))


def unlike_sisters(means: Array, covariances: Array) -> tuple[list[Unlikeness], Population]:
    """Which of R rings (R, P) is unlike the others, at most the share LEVEL of them falsely.

    Rings that stand out are taken from the population and it is fitted anew, so that a bad ring
    does not make its own spread look usual. Each is judged by its sisters without itself. R is
    MIN_RINGS at least; the population is that of the usual rings.
    """
    usual = np.ones(len(means), dtype=bool)
    for _ in range(MAX_PASSES):
        population = fit_population(means[usual], covariances[usual])
        answer = _judged(means, covariances, population, usual)
        standing = np.array([item.stands for item in answer])
        if (usual == ~standing).all() or (~standing).sum() < MIN_RINGS:
            break
        usual = ~standing
    return answer, population


def _judged(
    means: Array, covariances: Array, population: Population, usual: NDArray[np.bool_],
) -> list[Unlikeness]:
    weight = np.linalg.inv(population.mean_covariance)
    z_scores, p_values = [], []
    for index in range(len(means)):
        spread = covariances[index] + population.between
        centre, around = population.mean, population.mean_covariance
        if usual[index]:  # the mean of the sisters alone
            own = np.linalg.inv(spread)
            around = np.linalg.inv(weight - own)
            centre = around @ (weight @ population.mean - own @ means[index])
        apart, spread = means[index] - centre, spread + around
        p_values.append(float(chi2.sf(apart @ np.linalg.solve(spread, apart), apart.size)))
        z_scores.append(apart / np.sqrt(np.diag(spread)))
    return [Unlikeness(z, p, bool(found)) for z, p, found in zip(
        z_scores, p_values, benjamini_hochberg(p_values), strict=True)]
