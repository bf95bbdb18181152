"""Waves of the raceways: gap + a cos(m phi) + b sin(m phi) in each row, with m maxima."""

from collections.abc import Mapping, Sequence
from dataclasses import replace
import math
from typing import ClassVar

from saddlering_ros.effects.base import EffectParameter, RingEffect
from saddlering_ros.effects.extension import RingExtension

ROWS = ('upper', 'lower', 'radial')

WAVES = 16
"""Amplitudes of a row: cosine and sine of one to eight maxima. Shorter waves are like unequal
rollers, which are nuisance parameters."""

Raceways = Sequence[Sequence[float]]
"""Amplitudes [m] of each of ROWS, as in `RowGeometry.waves`; none of even raceways."""


class RacewayWaves(RingEffect):
    title = 'Waves of the raceways'
    words = ('No raceway is even: rollers touch one after the other. A diagnosis fits the waves '
             'beside causes where even raceways leave a misfit open, and does not name them: one '
             'session does not part them from an offset or a gain.')
    settled_by = 'Measure roundness and flatness of the raceways.'
    stage = 'ring'
    is_searched: ClassVar[bool] = False
    parameters = tuple(
        EffectParameter(f'{row}_{part}_{maxima}', 'm', -1e-3, 1e-3, 1e-5, 0.0,
                        f'{part} of a wave with {maxima} maxima in the {row} row', amplitude=True)
        for row in ROWS for maxima in range(1, WAVES // 2 + 1) for part in ('cosine', 'sine'))

    def extend(self, extension: RingExtension, values: Mapping[str, float]) -> RingExtension:
        return waved(extension, by_row(values))


def by_row(values: Mapping[str, float]) -> Raceways:
    """Amplitudes of each row from the parameters of the effect."""
    amplitudes = [values.get(parameter.name, 0.0) for parameter in RacewayWaves.parameters]
    return [amplitudes[first:first + WAVES] for first in range(0, len(amplitudes), WAVES)]


def waved(extension: RingExtension, raceways: Raceways) -> RingExtension:
    """The extension on a ring with these waves."""
    if not raceways:
        return extension
    rows = (extension.upper_row, extension.lower_row, extension.radial_row)
    upper, lower, radial = (
        row.beside(tuple(waves)) for row, waves in zip(rows, raceways, strict=True))
    return replace(extension, upper_row=upper, lower_row=lower, radial_row=radial)


def as_effect(raceways: Raceways) -> dict[str, dict[str, float]]:
    """The waves as effects of a parameter file; none of even raceways."""
    amplitudes = (one for waves in raceways for one in waves)
    values = {parameter.name: float(one) for parameter, one in zip(
        RacewayWaves.parameters, amplitudes, strict=False)}
    return {RacewayWaves.id: values} if values else {}


def rms_of(raceways: Raceways) -> dict[str, float]:
    """The rms [m] of the waves of each row; none of even raceways."""
    return {row: math.hypot(*waves) / math.sqrt(2.0)
            for row, waves in zip(ROWS, raceways, strict=False)}
