"""Drift of one probe, or of two opposite ones: d_i += r t."""

from collections.abc import Mapping
from dataclasses import replace

from saddlering_ros.effects.base import Choice, EffectParameter, MOVES, ProbeEffect, Variant
from saddlering_ros.effects.extension import at_probe, RingExtension

RADIAL, AXIAL = 13.0, 24.0
"""The choices of two probes, which are opposite: 1 and 3, or 2 and 4."""


class ProbeDrift(ProbeEffect):
    title = 'Probe drift'
    words = ('The reading of one probe, or of two opposite ones, drifts with time, mostly with '
             'temperature. The error follows time and not the load, continues at rest, and leaves '
             'the loop open at zero.')
    settled_by = 'A zero-load record as long as a test.'
    outcomes = {
        'second_rate': 'a misfit that grows with the time and not with the load',
        'repeat_cycle': 'a misfit that continues to grow during the holds at preload',
        'zero_load': 'readings that drift at constant preload', 'swapped_probes': MOVES}
    parameters = (
        EffectParameter('rate', 'm/s', -5e-7, 5e-7, 2e-8, 0.0,
                        'drift per second, of probe 1 or 2 where two drift', amplitude=True),
        EffectParameter('sum', 'm/s', -1e-6, 1e-6, 2e-8, 0.0,
                        'sum of the drifts of two opposite probes per second; 0: the second one '
                        'drifts as the first does, with the other sign', amplitude=True))
    variants = (
        *ProbeEffect.variants,
        Variant('probes 1 and 3', {'probe': RADIAL}, ('delta_x', 'parity'), ('sum',)),
        Variant('probes 2 and 4', {'probe': AXIAL}, ('delta_y', 'gamma'), ('sum',)))
    choices = (Choice('probe', (1.0, 2.0, 3.0, 4.0, RADIAL, AXIAL),
                      'radial: 1 rear, 3 front, 13 both; axial: 2 front, 4 rear, 24 both'),)

    def extend(self, extension: RingExtension, values: Mapping[str, float]) -> RingExtension:
        probe, rate = round(values['probe']), values['rate']
        if probe not in (RADIAL, AXIAL):
            return replace(extension, probe_drift=at_probe(extension.probe_drift, probe, rate))
        first, second = divmod(probe, 10)
        one = at_probe(extension.probe_drift, first, rate)
        return replace(extension, probe_drift=at_probe(one, second, values['sum'] - rate))
