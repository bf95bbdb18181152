"""Wrong zero of the load measurement: P = P_m - P0."""

from saddlering_ros.effects.base import EffectParameter, RingEffect, UNCLEAR


class LoadOffset(RingEffect):
    title = 'Load zero offset'
    words = ('The load measurement does not read zero at zero load. The error is the same number '
             'of newtons in every run, so that it matters most at low load, where the clearances '
             'close.')
    settled_by = 'A zero-load record with the cylinder disconnected, or a reference load.'
    outcomes = {
        'reference_load': 'the same difference in newtons at every load', 'zero_load': UNCLEAR}
    stage = 'load path'
    parameters = (EffectParameter(
        'offset', 'N', -15000.0, 8000.0, 2000.0, 0.0, 'reading of the load measurement at no load',
        amplitude=True, adds_to='load_offset'),)
