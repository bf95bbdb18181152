"""Bent load characteristic: P = P_m + 4 c P_m (P_fs - P_m) / P_fs."""

from saddlering_ros.effects.base import EffectParameter, RingEffect


class LoadNonlinearity(RingEffect):
    title = 'Bent load characteristic'
    words = ('The load measurement is right at zero and at full scale, and wrong between them. '
             'The error is a parabola over load, of equal size in force units in all channels, '
             'up and down alike.')
    settled_by = 'A reference load in several steps up to full scale.'
    outcomes = {'reference_load': 'a difference that is largest at half load'}
    stage = 'load path'
    parameters = (EffectParameter(
        'curvature', '1', -0.1, 0.1, 0.01, 0.0,
        'largest error, at half load, as a share of full scale', amplitude=True,
        adds_to='load_nonlinearity'),)
