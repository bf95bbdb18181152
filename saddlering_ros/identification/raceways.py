"""Waves of the raceways as errors of an identification, of the size that its misfit shows.

A wave moves the ring over the load nearly as another K and n do, so that K and n of a ring whose
raceways are not even are wrong by more than noise and unequal rollers explain. Waves are
independent errors, whose standard deviation is a power of the number of their maxima, the same in
each row. Sizes and powers are compared, together with the noise beside them, and count by the
restricted likelihood of the residuals (H. D. Patterson and R. Thompson, Biometrika 58 (1971) 545).
"""

from dataclasses import dataclass
import math

import numpy as np

from saddlering_ros.effects.raceway_waves import RacewayWaves, ROWS, WAVES
from saddlering_ros.estimation.process import Array
from saddlering_ros.ring.small_errors import SmallError

WAVE = 1e-6
"""Size [m] by which waves are simulated."""

EACH_WAVE: list[SmallError] = [
    {RacewayWaves.id: {one.name: WAVE}}
    for one in RacewayWaves.parameters if '_cosine_' in one.name]
"""A wave each. Sines move a ring that is loaded in its plane of symmetry by their square only."""

MAXIMA = np.tile(np.arange(1, WAVES // 2 + 1), len(ROWS))
"""Number of maxima of each wave."""

SIZES = np.geomspace(0.05, 200.0, 31)
"""Standard deviations of a wave with one maximum that are compared, in WAVE."""

POWERS = (0.0, -1.0, -2.0)
"""Powers of the maxima that are compared: errors of form grow with their length on a ring."""

EXPLAINED = 0.5
"""Share of the power of the misfit beyond noise from which waves count. Waves of 1 to 6 um rms
explain 0.71 to 1.0 of it, friction up to 0.65, many small errors together up to 0.48. A moment
arm, an elevation or a bent load cell explain as much as waves, and bend K and n as they do."""


@dataclass(frozen=True)
class Waves:
    """Standard deviation of each wave (W,), in WAVE, and the share of the misfit they explain."""

    sizes: Array
    share: float

    @property
    def rms(self) -> float:
        """Rms [m] of the waves of a raceway."""
        return WAVE * math.sqrt(float(self.sizes @ self.sizes) / len(ROWS) / 2.0)


def waves_of(residual: Array, sound: Array, waves: Array, freedom: int) -> Waves:
    """The waves that whitened residuals (R,) show; their sizes are 0 if they explain too little.

    sound (M, R), waves (W, R): changes of the residuals by small errors of a sound ring and by
    each wave; freedom: of the residuals. All are what the free parameters cannot imitate.
    """
    errors = np.vstack([sound, waves])
    power, along, products = float(residual @ residual), errors @ residual, errors @ errors.T
    noise = np.geomspace(0.5, 2.0 * max(power / freedom, 1.0), 60)[:, None]
    found = []
    for sizes in (0.0 * MAXIMA, *(size * MAXIMA**power for power in POWERS for size in SIZES)):
        scale = np.concatenate([np.ones(len(sound)), sizes])
        values, vectors = np.linalg.eigh(products * np.outer(scale, scale))
        values, seen = np.maximum(values, 0.0), (vectors.T @ (scale * along)) ** 2
        # Twice the negative logarithm of the likelihood, by noise.
        deviance = (freedom * np.log(noise[:, 0]) + np.log1p(values / noise).sum(axis=1)
                    + (power - (seen / (noise + values)).sum(axis=1)) / noise[:, 0])
        place = int(np.argmin(deviance))
        found.append((float(deviance[place]), float(noise[place, 0]), sizes))
    least, remains, sizes = min(found, key=lambda one: one[0])
    share = (power / freedom - remains) / max(power / freedom - 1.0, 1e-12)
    if share < EXPLAINED or not sizes.any():
        return Waves(0.0 * sizes, min(max(share, 0.0), 1.0))
    weights = np.exp(0.5 * (least - np.array([deviance for deviance, _, _ in found])))
    variances = weights @ np.array([sizes**2 for _, _, sizes in found]) / weights.sum()
    return Waves(np.sqrt(variances), min(share, 1.0))
