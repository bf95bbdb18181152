"""A worn arc of the axial rows: rollers there are softer, or have a larger gap."""

from collections.abc import Mapping
from dataclasses import replace

from saddlering_ros.effects import base
from saddlering_ros.effects.base import Choice, KINDS, Variant, worn_arc, WornSector
from saddlering_ros.effects.extension import RingExtension

BOTH, UPPER, LOWER = 0.0, 1.0, 2.0
ROWS = ((BOTH, 'both rows'), (UPPER, 'upper row'), (LOWER, 'lower row'))


class WornSectorAxial(WornSector):
    title = 'Worn sector of the axial rows'
    words = ('On one arc the axial rollers or their raceway are worn, so that they carry less or '
             'come into contact later. Tilt and axial motion are softer when the arc lies in the '
             'load zone (front for the upper row, rear for the lower one), and right elsewhere. A '
             'raceway or a mounting face that is out of flat by as much acts alike.')
    channels = ('delta_y', 'gamma')
    parameters = base.arc_parameters(centre=1.2)
    variants = tuple(
        Variant(f'{row_label}, {kind_label}', {'row': row, 'kind': kind})
        for row, row_label in ROWS for kind, kind_label in KINDS)
    choices = (Choice('row', tuple(row for row, _ in ROWS), '0 both rows, 1 upper, 2 lower'),
               *WornSector.choices)

    def extend(self, extension: RingExtension, values: Mapping[str, float]) -> RingExtension:
        wear = worn_arc(values)
        row = values['row']
        upper, lower = extension.upper_row, extension.lower_row
        return replace(
            extension, upper_row=upper if row == LOWER else replace(upper, wear=wear),
            lower_row=lower if row == UPPER else replace(lower, wear=wear))
