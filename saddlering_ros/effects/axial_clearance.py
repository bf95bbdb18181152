"""Another clearance than assumed: mu1 + e (1 + s u), half at each side, u in -1 to 1 by roller."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

from saddlering_ros.effects.base import EffectParameter, Outcomes, RingEffect
from saddlering_ros.effects.extension import RingExtension


class AxialClearance(RingEffect):
    """Wrong axial clearance."""

    id = 'axial_clearance'
    title = 'Wrong axial clearance'
    words = (
        'The clearance of the axial rows differs from the rig file. Tilt and axial motion begin '
        'with a dead zone and then have a nearly constant error, because fewer or more rollers '
        'share the load.'
    )
    settled_by = (
        'Pull-push through zero load: the jump between the two directions is the clearance.'
    )
    outcomes = Outcomes(pull_push='an axial jump other than the clearance in the rig file')
    stage = 'ring'
    form = 0.1  # rollers differ by a pattern of their own
    channels = ('delta_y', 'gamma')
    parameters = (
        EffectParameter(
            'change', 'm', -4e-5, 1e-4, 2e-5, 0.0,
            'true clearance minus the clearance in the rig file', amplitude=True),
        EffectParameter(
            'spread', '1', 0.0, 1.0, 0.3, 0.0,
            'difference of rollers: evenly from 1 - s to 1 + s times the change; 0: all alike',
            one_sided=True),
    )
    starts = ({'change': 2e-5, 'spread': 0.8}, {'change': -1e-5, 'spread': 0.8})

    def extend(self, extension: RingExtension, values: Mapping[str, float]) -> RingExtension:
        """Widen upper and lower row by half the change each."""
        upper, lower = extension.upper_row, extension.lower_row
        half = 0.5 * values['change']
        spread = abs(half) * values['spread']
        return replace(
            extension, upper_row=replace(upper, gap=upper.gap + half, gap_spread=spread),
            lower_row=replace(lower, gap=lower.gap + half, gap_spread=spread))
