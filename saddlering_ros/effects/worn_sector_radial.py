"""A worn arc of the radial row: rollers there are softer, or have a larger gap."""

from collections.abc import Mapping
from dataclasses import replace

from saddlering_ros.effects.base import arc_parameters, KINDS, Variant, worn_arc, WornSector
from saddlering_ros.effects.extension import RingExtension


class WornSectorRadial(WornSector):
    title = 'Worn sector of the radial row'
    words = ('On one arc the radial rollers or their raceway are worn, so that they carry less or '
             'come into contact later. The radial channel is softer when the arc lies at the '
             'rear, where the load is, and right elsewhere. A raceway that is uneven by as '
             'much acts alike.')
    channels = ('delta_x',)
    parameters = arc_parameters(centre=0.5)
    variants = tuple(Variant(label, {'kind': kind}) for kind, label in KINDS)

    def extend(self, extension: RingExtension, values: Mapping[str, float]) -> RingExtension:
        row = replace(extension.radial_row, wear=worn_arc(values))
        return replace(extension, radial_row=row)
