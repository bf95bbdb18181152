"""A spring in series with the rollers: delta_y += c F_y."""

from saddlering_ros.effects.base import EffectParameter, RingEffect


class AxialCompliance(RingEffect):
    title = 'Axial compliance in series'
    words = ('Bolts or ring bodies deform axially in series with the rollers. The additional '
             'axial motion is a straight line over the axial force, without loop and without '
             'damping. Tilt is not changed.')
    settled_by = ('Swapped probes 2 and 4 rule out the instruments; a second loading rate (x4) '
                  'tells the spring from K1.')
    outcomes = {'other_elevation': 'a misfit of the axial motion in proportion to the axial force'}
    stage = 'ring'
    channels = ('delta_y',)
    parameters = (EffectParameter(
        'compliance', 'm/N', 0.0, 3e-10, 5e-11, 5e-11, 'motion per unit of force', amplitude=True,
        one_sided=True, adds_to='axial_compliance'),)
