"""Drift of one probe: d_i += r t."""

from saddlering_ros.effects.base import EffectParameter, Outcomes
from saddlering_ros.effects.common_shapes import ProbeEffect


class ProbeDrift(ProbeEffect):
    title = 'Probe drift'
    words = ('The reading of one probe drifts with time, mostly with temperature. The error '
             'follows time and not the load, continues at rest, and leaves the loop open at zero.')
    settled_by = 'A zero-load record as long as a test.'
    outcomes = Outcomes(
        second_rate='a misfit that grows with the time and not with the load',
        repeat_cycle='a misfit that continues to grow during the holds at preload',
        zero_load='readings that drift at constant preload',
        swapped_probes='a misfit that moves with the probe')
    parameters = (EffectParameter(
        'rate', 'm/s', -5e-7, 5e-7, 2e-8, 0.0, 'drift per second', amplitude=True,
        adds_to='probe_drift'),)
