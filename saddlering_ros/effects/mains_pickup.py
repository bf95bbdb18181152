"""Pickup of a line frequency: d_i += a cos(w t) + b sin(w t)."""

from collections.abc import Mapping
from dataclasses import replace

from saddlering_ros.effects.base import ANY_PROBE, EffectParameter, ProbeEffect, UNCLEAR, Variant
from saddlering_ros.effects.extension import RingExtension


class MainsPickup(ProbeEffect):
    title = 'Mains pickup'
    words = ('The probe cables pick up the mains, or a pump. The readings contain a steady '
             'oscillation at one frequency, at zero load too. At a low sampling rate this '
             'oscillation appears at another, lower frequency. A spectrum shows its frequency.')
    settled_by = 'A zero-load record at the highest sampling rate.'
    outcomes = {
        'zero_load': 'a line in the spectrum at constant preload', 'swapped_probes': UNCLEAR}
    parameters = (
        EffectParameter('cosine', 'm', -2e-5, 2e-5, 1e-6, 0.0,
                        'part in phase with a cosine from the start of the run', amplitude=True,
                        adds_to='pickup_cosine'),
        EffectParameter('sine', 'm', -2e-5, 2e-5, 1e-6, 0.0,
                        'part in phase with a sine from the start of the run', amplitude=True,
                        adds_to='pickup_sine'),
        EffectParameter('frequency', 'Hz', 0.5, 500.0, 50.0, 50.0, 'true frequency of the line',
                        one_sided=True, logarithmic=True))
    variants = (
        Variant('all probes', {'probe': 0.0}, ('delta_y', 'parity')), *ProbeEffect.variants)
    choices = (ANY_PROBE,)
    line = True
    starts = ({'frequency': 50.0}, {'frequency': 60.0})

    def extend(self, extension: RingExtension, values: Mapping[str, float]) -> RingExtension:
        return replace(super().extend(extension, values), pickup_frequency=values['frequency'])
