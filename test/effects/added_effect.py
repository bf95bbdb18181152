"""A spring in series with the rollers that hardens: gamma += c M |M|."""

from __future__ import annotations

from collections.abc import Mapping

from saddlering_ros.effects.base import EffectParameter, RingEffect
from saddlering_ros.effects.extension import OwnParameter, READING, RingExtension

HARDENING = OwnParameter('tilt_hardening', 'ring', READING)
"""c [rad/(N m)^2]."""


class TiltHardening(RingEffect):
    title = 'Tilt compliance that hardens'
    words = 'Something in series with the rollers bends under the tilting moment, less and less.'
    settled_by = 'An inclinometer on the upper ring itself.'
    stage = 'ring'
    channels = ('gamma',)
    own_parameters = (HARDENING,)
    parameters = (
        EffectParameter(
            'hardening', 'rad/(N m)^2', -1e-14, 1e-14, 2e-15, 0.0,
            'tilt per square of the moment', amplitude=True),
    )

    def extend(self, extension: RingExtension, values: Mapping[str, float]) -> RingExtension:
        return HARDENING.add(extension, values['hardening'])
