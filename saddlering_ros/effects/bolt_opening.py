"""A joint that opens: gamma += c mean(max(0, M - M0)), M0 spread evenly over M0 - w to M0 + w."""

from saddlering_ros.effects.base import EffectParameter, RingEffect

MIN_MOMENT = 20000.0
"""Lowest opening moment [N m]: a joint that is open from there on is a compliance of the tilt, by
all but 1 % of the power of what it does."""


class BoltOpening(RingEffect):
    title = 'Opening bolted joint'
    words = ('Beyond a certain tilting moment the bolted joint opens on one side, and the ring '
             'tilts more easily. Tilt has a kink at one moment, or a bend if bolts open one after '
             'another. The kink is the same at every elevation, for rising and falling load.')
    settled_by = ('A run at another elevation: the kink stays at the same moment, not at the same '
                  'load; the ring slewed by 90 deg moves the opening to other bolts.')
    outcomes = {
        'slewed_ring': 'a kink at another tilting moment',
        'other_elevation': 'a kink at the same tilting moment and another load'}
    stage = 'ring'
    form = 0.05  # bolts need not open evenly over the range of moments
    channels = ('gamma',)
    parameters = (
        EffectParameter('compliance', 'rad/(N m)', 0.0, 1e-9, 2e-10, 2e-10,
                        'extra tilt per unit of moment beyond the opening moment', amplitude=True,
                        one_sided=True, adds_to='opening_compliance'),
        EffectParameter(
            'moment', 'N m', MIN_MOMENT, 250000.0, 100000.0, 100000.0,
            'tilting moment at which the joint opens, the mean of its bolts; at the lowest '
            'one it is always open, a compliance of the tilt', one_sided=True,
            limiting_case=(MIN_MOMENT,), adds_to='opening_moment'),
        EffectParameter('spread', 'N m', 0.0, 60000.0, 10000.0, 0.0,
                        'w: bolts open from M0 - w to M0 + w; 0: all at once', one_sided=True,
                        adds_to='opening_spread'))
    # A sharp kink does not show its change with the spread: the search begins with a wide one
    starts = tuple({'moment': moment, 'spread': 0.2 * moment} for moment in (4e4, 7e4, 1e5, 1.4e5))
