"""A raceway out of round: radial gap + a cos(2 (phi - phi0))."""

from collections.abc import Mapping
from dataclasses import replace
import math

from saddlering_ros.effects.base import EffectParameter, RingEffect, UNCLEAR
from saddlering_ros.effects.extension import RingExtension


class OutOfRound(RingEffect):
    title = 'Raceway out of round'
    words = ('The radial raceway is slightly oval from the start, so that the gap has two maxima '
             'around the ring. The radial channel looks much as with a wrong clearance: a dead '
             'zone and then a nearly constant offset.')
    settled_by = ('The ring slewed by 90 deg: the effect of an oval changes its sign, that of a '
                  'clearance does not.')
    outcomes = {'slewed_ring': 'a misfit of the opposite sign', 'pull_push': UNCLEAR}
    stage = 'ring'
    channels = ('delta_x',)
    parameters = (
        EffectParameter(
            'amplitude', 'm', -3e-5, 3e-5, 8e-6, 0.0,
            'largest change of the radial gap; positive: wider at phi0', amplitude=True),
        EffectParameter('angle', 'rad', 0.0, math.pi / 4, 0.2, 0.2,
                        'phi0 of the widest gap, from the rear', one_sided=True))
    # Not at 0, where the mirror image makes every change of the angle vanish.
    starts = ({'angle': 0.1}, {'angle': 0.4}, {'angle': 0.65})

    def extend(self, extension: RingExtension, values: Mapping[str, float]) -> RingExtension:
        row = replace(extension.radial_row, oval_amplitude=values['amplitude'],
                      oval_angle=values['angle'])
        return replace(extension, radial_row=row)
