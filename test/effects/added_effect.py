"""A spring in series with the rollers that hardens: gamma += c M |M|."""

from saddlering_ros.effects.base import EffectParameter, RingEffect
from saddlering_ros.effects.extension import OwnParameter, READING


class TiltHardening(RingEffect):
    title = 'Tilt compliance that hardens'
    words = 'Something in series with the rollers bends under the tilting moment, less and less.'
    settled_by = 'An inclinometer on the upper ring itself.'
    stage = 'ring'
    channels = ('gamma',)
    parameters = (
        EffectParameter(
            'hardening', 'rad/(N m)^2', -1e-14, 1e-14, 2e-15, 0.0,
            'tilt per square of the moment', amplitude=True,
            adds_to=OwnParameter('tilt_hardening', 'ring', READING)),
    )
