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


def reason_unequal(name: str, std: float, noise_std: float, elevations: int) -> str | None:
    """The same reason if unequal rollers, and not noise alone, leave the parameter open."""
    reason = reason_wide(name, std, elevations)
    if reason is None or reason_wide(name, noise_std, elevations) is not None:
        return reason
    known, _, advice = reason.partition(' from these data: ')
    if elevations > 1 or name[0] == 'D':
        return f'{known} on a ring whose rollers may be unequal: longer runs do not help'
    return f'{known} on a ring whose rollers may be unequal: {advice}'


def reason_misfit(name: str, std: float, fitted_std: float, advice: str) -> str | None:
    """The same reason if only the misfit, which widens the interval, leaves the parameter open.

    fitted_std: standard deviation (coordinates) for a misfit as large as the noise.
    """
    reason = reason_wide(name, std, 1)
    if reason is None or reason_wide(name, fitted_std, 1) is not None:
        return None
    known, _, _ = reason.partition(' from these data: ')
    return f'{known}, because the misfit exceeds the noise: {advice}'


def reason_one_elevation(
    name: str, std: float, shift: float, imperfection: str, elevations: int
) -> str | None:
    """Why a parameter depends on curvature alone; None if it does not.

    shift: its change by `imperfection`, the worst small one that no fit can detect
    (coordinates).
    """
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
