"""The contact parameters that data determine, and the words for them everywhere.

K, n and D are judged in the coordinates (ln K, n, ln D) of a `SearchSpace`.
"""

from collections.abc import Iterable, Sequence
from itertools import combinations

import numpy as np

from saddlering_ros.estimation.process import Array
from saddlering_ros.quantities import compact, WIDTH_95

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


def reason_open(
    name: str, deviations: Sequence[float], shift: float, imperfection: str, elevations: int,
    misfit_advice: str,
) -> str | None:
    """Why an identified parameter is open; None if it is not.

    deviations (coordinates): in all, of noise alone, and in all for a misfit as large as the
    noise. shift (coordinates): its change by `imperfection`, the worst small one that no fit can
    detect: with one elevation n, and K of a large shift, depend on the curvature alone.
    """
    std, of_noise, without_misfit = deviations
    reason = reason_wide(name, std, elevations)
    if reason is not None:
        known, _, advice = reason.partition(' from these data: ')
        if reason_wide(name, without_misfit, elevations) is None:
            return f'{known}, because the misfit exceeds the noise: {misfit_advice}'
        if reason_wide(name, of_noise, elevations) is not None:
            return reason
        advice = 'longer runs do not help' if elevations > 1 or name[0] == 'D' else advice
        return f'{known} on a ring whose rollers may be unequal: {advice}'
    tolerable = shift + WIDTH_95 * std <= MAX_HALF_WIDTH[name[0]]
    if name[0] == 'D' or elevations > 1 or (name[0] == 'K' and tolerable):
        return None
    moved = f'{shift:.3f}' if name[0] == 'n' else f'{100.0 * np.expm1(min(shift, 50.0)):.0f} %'
    return (f'{name} from one elevation depends on the curvature only: {imperfection} would '
            f'change it by {moved}; add a run at another elevation')


def undetermined_words(name: str, value: str, reason: str) -> str:
    """A parameter that data do not determine, as every command prints it."""
    return f'{name}: not determined by these data (best known {value}): {reason}'


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
