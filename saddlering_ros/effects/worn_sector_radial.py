"""A worn arc of the middle row: rollers there are softer, or have a larger gap."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
import math

from saddlering_ros.effects.base import Effect, EffectParameter, Variant
from saddlering_ros.effects.extension import RingExtension
from saddlering_ros.effects.worn_arc import KIND, KINDS, worn_arc


class WornSectorRadial(Effect):
    """Worn sector of the middle row."""

    id = 'worn_sector_radial'
    title = 'Worn sector of the middle row'
    words = (
        'On one arc the radial rollers or their raceway are worn, so that they carry less or '
        'come into contact later. The radial channel is softer when the arc lies at the rear, '
        'where the load is, and right elsewhere.'
    )
    settled_by = 'The ring slewed by 90 deg: the arc leaves the load zone.'
    stage = 'ring'
    channels = ('delta_x',)
    parameters = (
        EffectParameter(
            'wear', '1', 0.0, 1.0, 0.3, 0.3,
            'share of stiffness lost on the arc, or its extra gap in units of 0.1 mm',
            amplitude=True, one_sided=True),
        EffectParameter(
            'centre', 'rad', 0.0, math.pi, 0.5, 0.5,
            'middle of the arc from the rear (x > 0); its mirror image acts alike',
            one_sided=True),
        EffectParameter(
            'half_width', 'rad', 0.15, 1.5, 0.5, 0.6,
            'half the length of the arc', one_sided=True),
    )
    variants = tuple(Variant(label, {'kind': kind}) for kind, label in KINDS)
    choices = (KIND,)
    starts = ({'centre': 0.0}, {'centre': 0.8})

    def extend(self, extension: RingExtension, values: Mapping[str, float]) -> RingExtension:
        """Wear the middle row."""
        row = replace(extension.middle_row, wear=worn_arc(values))
        return replace(extension, middle_row=row)
