"""Unequal axial rows: the lower row has (1 + e) K1."""

from collections.abc import Mapping
from dataclasses import replace

from saddlering_ros.effects.base import EffectParameter, RingEffect
from saddlering_ros.effects.extension import RingExtension


class UnequalRows(RingEffect):
    title = 'Unequal axial rows'
    words = ('The lower row is stiffer or softer than the upper one, by other rollers, wear or '
             'hardness. The ratio of axial motion to tilt differs from that of equal rows, over '
             'the whole load range.')
    settled_by = ('Pull-push through zero load, which exchanges the parts of the two rows; '
                  'swapped probes 2 and 4 rule out the instruments.')
    outcomes = {'pull_push': 'a misfit that changes its sign with the load'}
    stage = 'ring'
    channels = ('delta_y', 'gamma')
    parameters = (EffectParameter(
        'excess', '1', -0.7, 2.0, 0.2, 0.0,
        'stiffness of the lower row over that of the upper row, minus 1', amplitude=True),)

    def extend(self, extension: RingExtension, values: Mapping[str, float]) -> RingExtension:
        row = extension.lower_row
        stiffness = row.stiffness * (1.0 + values['excess'])
        return replace(extension, lower_row=replace(row, stiffness=stiffness))
