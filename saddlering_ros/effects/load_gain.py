"""Wrong gain of the load measurement: P = P_m / (1 + g)."""

from saddlering_ros.effects.base import EffectParameter, RingEffect


class LoadGain(RingEffect):
    title = 'Load gain error'
    words = ('The load cell or pressure transducer reads a fixed share too much or too little. '
             'Every displacement changes by that share, so that stiffnesses and dampings imitate '
             'the error completely. Only a reference load, or a stiffness known beforehand, shows '
             'the error.')
    settled_by = ('A reference load: a known weight or a calibrated load cell in line with the '
                  'cylinder.')
    outcomes = {
        'reference_load': 'a difference that is a fixed share of the load',
        'other_elevation': 'the same share of every displacement at both elevations'}
    stage = 'load path'
    parameters = (EffectParameter(
        'gain', '1', -0.3, 0.3, 0.03, 0.0, 'share by which the measured load is too large',
        amplitude=True, adds_to='load_gain'),)
