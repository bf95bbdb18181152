"""Whether the declared or measured noise agrees with the remaining misfit."""

from __future__ import annotations

from saddlering_ros.estimation.distributions import fisher_chance, fisher_share_below

MAX_CHANCE = 1e-3
"""Chance of as small a misfit from noise alone, below which the noise is overestimated ..."""

MAX_RATIO = 0.5
"""... if the misfit is also below this share of the expected one."""


def overestimated(statistic: float, dimensions: float, degrees: float) -> bool:
    """Whether a whitened misfit over `dimensions` is far below the misfit of noise alone.

    degrees: degrees of freedom of the level of the noise.
    """
    if dimensions <= 0 or statistic >= MAX_RATIO * dimensions:
        return False
    chance = fisher_share_below(statistic / dimensions, dimensions, degrees)
    return bool(chance < MAX_CHANCE)


def underestimated(statistic: float, dimensions: float, degrees: float) -> bool:
    """Whether a whitened misfit over `dimensions` is far above the misfit of noise alone."""
    if dimensions <= 0 or statistic <= dimensions / MAX_RATIO:
        return False
    return bool(fisher_chance(statistic / dimensions, dimensions, degrees) < MAX_CHANCE)


def underestimated_sentence(statistic: float, dimensions: float, where: str) -> str:
    """The warning for a reader."""
    return (
        f'noise underestimated in {where}: the misfit is {statistic:.3g} where noise alone would '
        f'give about {dimensions:.3g}, and no cause explains it; give the noise of the channel as '
        'it is, leave it to be learnt (Noise.unknown), or declare a model error'
    )


def overestimated_sentence(statistic: float, dimensions: float, where: str) -> str:
    """The warning for a reader."""
    return (
        f'noise overestimated in {where}: the misfit is {statistic:.3g} where noise alone would '
        f'give about {dimensions:.3g}: no conclusion is possible; give the noise of the channel '
        '(Noise.white, Noise.from_rest) or a smaller model error'
    )
