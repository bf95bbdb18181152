"""A second mode in series: v'' + 2 z w v' + w^2 v = w^2 u, and y = (1 - s) u + s v."""

from collections.abc import Mapping
from dataclasses import replace
import math

from saddlering_ros.effects.base import Choice, EffectParameter, RingEffect, Variant
from saddlering_ros.effects.extension import RingExtension

ALIKE, EACH = 0.0, 1.0

PERIODS = tuple(0.02 * 1.15**number for number in range(25))
"""Periods [s] tried first: closer than a ringing of ten periods separates."""

SHORTEST_PERIOD = 1e-4
"""Below this period [s] the mode is as good as rigid."""


class CarriageResonance(RingEffect):
    title = 'Resonance of the carriage'
    words = ('The carriage or the frame oscillates after each sudden change of the load rate. All '
             'displacement channels oscillate at one frequency with a falling amplitude. A static '
             'run shows nothing.')
    settled_by = ('A second loading rate (x4): the oscillation grows with the rate and keeps its '
                  'frequency.')
    outcomes = {'second_rate': 'an oscillation that becomes smaller and keeps its frequency'}
    stage = 'ring'
    parameters = (
        EffectParameter('share', '1', 0.0, 1.5, 1.0, 1.0,
                        'share of the motion that the second mode carries; 0: rigid',
                        amplitude=True, one_sided=True),
        EffectParameter('period', 's', 0.0, 1.0, 0.1, 0.1,
                        'period of the second mode (one over its frequency)', one_sided=True),
        EffectParameter('damping', '1', 0.005, 0.7, 0.05, 0.05, 'damping ratio of the second mode',
                        one_sided=True, logarithmic=True),
        EffectParameter('share_y', '1', 0.0, 1.5, 1.0, 1.0,
                        'share of delta_y where every coordinate has its own, the first being of '
                        'delta_x', amplitude=True, one_sided=True),
        EffectParameter(
            'share_tilt', '1', 0.0, 1.5, 1.0, 1.0,
            'share of gamma where every coordinate has its own', amplitude=True, one_sided=True))
    variants = (
        Variant('all alike', {'coordinates': ALIKE}),
        Variant('each coordinate', {'coordinates': EACH}, frees=('share_y', 'share_tilt')))
    choices = (Choice('coordinates', (ALIKE, EACH), '0 all swing alike, 1 each by its own share'),)
    starts = tuple({'period': period} for period in PERIODS)
    dynamic_only = True

    def extend(self, extension: RingExtension, values: Mapping[str, float]) -> RingExtension:
        period = values['period']
        frequency = 2.0 * math.pi / period if period > SHORTEST_PERIOD else 0.0
        share = values['share']
        shares = (share, share, share)
        if values['coordinates'] == EACH:
            shares = (share, values['share_y'], values['share_tilt'])
        return replace(extension, resonance_frequency=frequency,
                       resonance_damping=values['damping'], resonance_share=shares)
