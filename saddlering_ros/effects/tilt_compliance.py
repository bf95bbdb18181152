"""A spring in series with the rollers: gamma += c M."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

from saddlering_ros.effects.base import Effect, EffectParameter
from saddlering_ros.effects.extension import RingExtension
from saddlering_ros.effects.rig_tests import Outcomes


class TiltCompliance(Effect):
    """Tilt compliance in series."""

    id = 'tilt_compliance'
    title = 'Tilt compliance in series'
    words = (
        'Bolts, ring bodies or the carriage bend under the tilting moment in series with the '
        'rollers. The additional tilt is a straight line over the moment, without loop and '
        'without damping. Axial motion is not changed.'
    )
    settled_by = 'A second loading rate (x4), or an inclinometer on the upper ring itself.'
    outcomes = Outcomes(
        other_elevation='a misfit of the tilt in proportion to the tilting moment',
    )
    stage = 'ring'
    channels = ('gamma',)
    parameters = (
        EffectParameter(
            'compliance', 'rad/(N m)', 0.0, 5e-10, 1e-10, 1e-10,
            'motion per unit of moment', amplitude=True, one_sided=True),
    )

    def extend(self, extension: RingExtension, values: Mapping[str, float]) -> RingExtension:
        """Add to the tilt compliance."""
        return replace(
            extension, tilt_compliance=extension.tilt_compliance + values['compliance'])
