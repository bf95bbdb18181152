"""Another clearance than assumed: mu2 + e (1 + s u), half at each side, u in -1 to 1 by roller."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

from saddlering_ros.effects.base import EffectParameter, Outcomes, RingEffect
from saddlering_ros.effects.extension import RingExtension


class RadialClearance(RingEffect):
    """Wrong radial clearance."""

    id = 'radial_clearance'
    title = 'Wrong radial clearance'
    words = (
        'The clearance of the radial row differs from the rig file. The radial channel begins '
        'with a dead zone and then has a nearly constant error, because fewer or more rollers '
        'share the load.'
    )
    settled_by = (
        'Pull-push through zero load: the jump between the two directions is the clearance.'
    )
    outcomes = Outcomes(pull_push='a radial jump other than the clearance in the rig file')
    stage = 'ring'
    form = 0.1  # rollers differ by a pattern of their own
    channels = ('delta_x',)
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
        """Widen the radial row by half the change at each side."""
        radial, half = extension.radial_row, 0.5 * values['change']
        row = replace(radial, gap=radial.gap + half, gap_spread=abs(half) * values['spread'])
        return replace(extension, radial_row=row)
