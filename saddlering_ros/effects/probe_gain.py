"""Wrong gain of one probe: d_i (1 + g)."""

from saddlering_ros.effects.base import EffectParameter, MOVES, ProbeEffect


class ProbeGain(ProbeEffect):
    title = 'Probe gain error'
    words = ('One probe reads a fixed share too much or too little, because of its calibration or '
             'the metal of its target. A radial probe (1, 3) shows it in the parity, an axial one '
             '(2, 4) in the ratio of axial motion to tilt.')
    settled_by = 'Swapped probes: the error moves with the probe.'
    outcomes = {'swapped_probes': MOVES}
    parameters = (EffectParameter(
        'gain', '1', -0.3, 0.3, 0.03, 0.0, 'share by which the probe reads too much',
        amplitude=True, adds_to='probe_gain'),)
