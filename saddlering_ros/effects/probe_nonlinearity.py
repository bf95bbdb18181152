"""Bent characteristic of one probe: d_i += q d_i^2."""

from saddlering_ros.effects.base import EffectParameter, MOVES, ProbeEffect


class ProbeNonlinearity(ProbeEffect):
    title = 'Bent probe characteristic'
    words = ('The characteristic of one probe is bent, as happens near the end of its span. The '
             'error is a function of its reading, and does not depend on load, rate or elevation.')
    settled_by = ('Swapped probes: the error moves with the probe; or another gap at zero, which '
                  'shifts the error along the characteristic.')
    outcomes = {'swapped_probes': MOVES, 'other_gap': 'a misfit that moves to another load'}
    parameters = (EffectParameter(
        'curvature', '1/m', -3000.0, 3000.0, 100.0, 0.0,
        'curvature; 100 per metre is 1 % at 100 micrometres', amplitude=True,
        adds_to='probe_nonlinearity'),)
