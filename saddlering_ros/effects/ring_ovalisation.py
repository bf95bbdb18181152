"""Ovalisation of the ring: d1 and d3 += c F_x, with the same sign."""

from saddlering_ros.effects.base import EffectParameter, RingEffect


class RingOvalisation(RingEffect):
    title = 'Ovalisation of the ring'
    words = ('The radial force squeezes the ring a little oval, so that both radial probes move '
             'in the same direction. Ovalisation shows in the parity (d1 + d3)/2 only, which is '
             'zero for a rigid ring. The parity is then a straight line over load, without loop.')
    settled_by = ('Swapped probes 1 and 3: ovalisation stays in the parity, a gain error of one '
                  'probe changes its sign.')
    outcomes = {'other_elevation': 'a parity in proportion to the radial force'}
    stage = 'ring'
    channels = ('parity',)
    parameters = (EffectParameter(
        'compliance', 'm/N', -2e-10, 2e-10, 3e-11, 0.0,
        'common radial motion per unit of radial force', amplitude=True, adds_to='ovalisation'),)
