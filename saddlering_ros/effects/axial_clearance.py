"""Another clearance than assumed: mu1 + e (1 + s u), half at each side, u in -1 to 1 by roller."""

from collections.abc import Mapping
from dataclasses import replace

from saddlering_ros.effects.base import Outcomes, RingEffect
from saddlering_ros.effects.common_shapes import CLEARANCE_PARAMETERS, CLEARANCE_STARTS, widened
from saddlering_ros.effects.extension import RingExtension


class AxialClearance(RingEffect):
    title = 'Wrong axial clearance'
    words = ('The clearance of the axial rows differs from the rig file. Tilt and axial motion '
             'begin with a dead zone and then have a nearly constant error, because fewer or more '
             'rollers share the load.')
    settled_by = ('Pull-push through zero load: the jump between the two directions is the '
                  'clearance.')
    outcomes = Outcomes(pull_push='an axial jump other than the clearance in the rig file')
    stage = 'ring'
    form = 0.1  # rollers differ by a pattern of their own
    channels = ('delta_y', 'gamma')
    parameters = CLEARANCE_PARAMETERS
    starts = CLEARANCE_STARTS

    def extend(self, extension: RingExtension, values: Mapping[str, float]) -> RingExtension:
        return replace(extension, upper_row=widened(extension.upper_row, values),
                       lower_row=widened(extension.lower_row, values))
