"""Another clearance than assumed: mu2 + e, half of it at each side."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

from saddlering_ros.effects.base import Effect, EffectParameter
from saddlering_ros.effects.extension import RingExtension


class RadialClearance(Effect):
    """Wrong radial clearance."""

    id = 'radial_clearance'
    title = 'Wrong radial clearance'
    words = (
        'The clearance of the middle row is not the one in the rig file. The radial channel '
        'begins with a dead zone and then runs a nearly constant number of micrometres off, '
        'because fewer or more rollers share the load.'
    )
    settled_by = (
        'Pull-push through zero load: the jump between the two directions is the clearance.'
    )
    stage = 'ring'
    form = 0.1  # clearances differ from roller to roller
    channels = ('delta_x',)
    parameters = (
        EffectParameter(
            'change', 'm', -4e-5, 1e-4, 2e-5, 0.0,
            'true clearance minus the clearance in the rig file', amplitude=True),
    )

    def extend(self, extension: RingExtension, values: Mapping[str, float]) -> RingExtension:
        """Widen the middle row by half the change at each side."""
        gap = extension.middle_row.gap + 0.5 * values['change']
        return replace(extension, middle_row=replace(extension.middle_row, gap=gap))
