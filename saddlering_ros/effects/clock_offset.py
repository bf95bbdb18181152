"""Two clocks: a reading of the probes at t carries the stamp t + tau + skew t."""

from saddlering_ros.effects.base import EffectParameter, RingEffect


class ClockOffset(RingEffect):
    title = 'Clock offset between load and probes'
    words = ('Load and probes are stamped by two clocks with an offset or a different speed. All '
             'probes are early or late by the same time, without smoothing. A static run hardly '
             'shows this.')
    settled_by = ('A second loading rate (x4): the shift stays the same in seconds; or record one '
                  'signal with both recorders.')
    outcomes = {'second_rate': 'a shift of the same time with sharp corners'}
    stage = 'measurement'
    parameters = (
        EffectParameter('offset', 's', -0.5, 0.5, 0.02, 0.0,
                        'stamp of the probes minus true time; positive: probes late',
                        amplitude=True, adds_to='clock_offset'),
        EffectParameter(
            'skew', '1', -0.001, 1e-3, 1e-4, 0.0,
            'further offset per second of the run', amplitude=True, adds_to='clock_skew'))
    dynamic_only = True
