"""Slow probe electronics: a low-pass of one or two stages on one or all probes."""

from saddlering_ros.effects.base import ANY_PROBE, EffectParameter, ProbeEffect, UNCLEAR, Variant


class ProbeLag(ProbeEffect):
    title = 'Probe lag'
    words = ('A filter in the electronics delays one probe, or all probes. In a dynamic run the '
             'error is exponential after each change of the load rate. A static run shows '
             'nothing. A lag of all probes looks much like damping, and a lag of two stages much '
             'like a clock offset.')
    settled_by = 'A second loading rate (x4), with swapped probes if only one is slow.'
    outcomes = {
        'second_rate': 'a delay of the same time with rounded corners', 'swapped_probes': UNCLEAR}
    parameters = (
        EffectParameter('time', 's', 0.0, 1.0, 0.03, 0.03,
                        'time constant of the low-pass, of both its stages together',
                        amplitude=True, one_sided=True, adds_to='probe_lag'),
        EffectParameter('second', '1', 0.0, 0.5, 0.5, 0.0,
                        'share of the time constant that a second stage has; 0: one stage',
                        one_sided=True, adds_to='probe_lag_second'))
    variants = (
        Variant('all probes', {'probe': 0.0}, ('delta_x', 'delta_y', 'gamma')),
        *ProbeEffect.variants)
    choices = (ANY_PROBE,)
    starts = ({'second': 0.5},)
    dynamic_only = True
