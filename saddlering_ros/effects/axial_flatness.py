"""Axial raceways out of flat: axial gap + a (cos(2 (phi - phi0)) + t cos(3 phi))."""

from collections.abc import Mapping
from dataclasses import replace

from saddlering_ros.effects.base import Choice, EffectParameter, OvalGap, Variant
from saddlering_ros.effects.extension import RingExtension

SIGNS = {0.0: (1.0, 1.0), 1.0: (1.0, -1.0), 2.0: (1.0, 0.0), 3.0: (0.0, 1.0)}
"""Signs of the change of the gap in the upper and in the lower row, by the choice of rows."""
LABELS = ('both rows alike', 'upper and lower row opposite', 'upper row', 'lower row')


class AxialFlatness(OvalGap):
    title = 'Axial raceways out of flat'
    words = ('The axial raceways or their mounting face are bent like a saddle, so that the gap '
             'of the rollers has two maxima around the ring. Rollers come into contact later at '
             'two opposite places and earlier between them. A worn arc at these places has almost '
             'the same effect.')
    channels = ('delta_y', 'gamma')
    parameters = (*OvalGap.parameters, EffectParameter(
        'third', '1', -1.0, 1.0, 0.2, 0.0,
        'share of a wave with three maxima, one of them at the rear'))
    starts = (*OvalGap.starts, *({'amplitude': size, 'angle': 0.4} for size in (8e-6, -8e-6)))
    variants = tuple(Variant(label, {'rows': rows})
                     for rows, label in zip(SIGNS, LABELS, strict=True))
    choices = (Choice('rows', tuple(SIGNS), '0 both rows alike, 1 opposite (a bent ring), 2 '
                      'upper, 3 lower'),)
    form = 0.2  # real raceways have waves of higher orders, too

    def slewed(self, values: Mapping[str, float]) -> dict[str, float]:
        # A turned wave of three maxima has its mirror image of the other sign: it moves nothing.
        return {**super().slewed(values), 'third': 0.0}

    def extend(self, extension: RingExtension, values: Mapping[str, float]) -> RingExtension:
        waves = (*self.waves(values), values['amplitude'] * values['third'])
        upper, lower = (
            row.beside(tuple(sign * one for one in waves))
            for sign, row in zip(SIGNS[values['rows']],
                                 (extension.upper_row, extension.lower_row), strict=True))
        return replace(extension, upper_row=upper, lower_row=lower)
