"""Settling under the highest load so far: y += s max P."""

from collections.abc import Mapping
from dataclasses import replace

from saddlering_ros.effects.base import Choice, EffectParameter, RingEffect, UNCLEAR, Variant
from saddlering_ros.effects.extension import RingExtension

EACH = 3.0
"""The choice in which every coordinate settles by its own amount."""

SETTLING = ('settling_x', 'settling_y', 'settling_tilt')


class Settling(RingEffect):
    title = 'Settling in the first cycle'
    words = ('Joints, shims or asperities settle permanently under the highest load so far. The '
             'first cycle does not return to zero, and its loop is open at the lower end. A '
             'second cycle to the same load shows no change.')
    settled_by = ('A repeat cycle with holds at zero and full load: the second cycle shows no '
                  'settling.')
    outcomes = {
        'second_rate': 'no misfit in the repeated test',
        'repeat_cycle': 'a misfit in the first cycle only',
        'swapped_probes': 'no misfit in the repeated test', 'slewed_ring': UNCLEAR,
        'other_elevation': UNCLEAR, 'other_gap': 'no misfit in the repeated test',
        'pull_push': UNCLEAR}
    stage = 'ring'
    form = 0.05  # joints settle not quite in proportion to the load
    parameters = (
        EffectParameter('settling', 'm/N', -3e-10, 3e-10, 4e-11, 0.0,
                        'remaining motion per unit of the highest load; for tilt that at 1 m from '
                        'the axis', amplitude=True),
        EffectParameter('settling_y', 'm/N', -3e-10, 3e-10, 4e-11, 0.0,
                        'the same of delta_y where every coordinate has its own, the first being '
                        'of delta_x', amplitude=True, adds_to='settling_y'),
        EffectParameter('settling_tilt', 'm/N', -3e-10, 3e-10, 4e-11, 0.0,
                        'the same of gamma, at 1 m from the axis, where every coordinate has its '
                        'own', amplitude=True, adds_to='settling_tilt'))
    variants = (
        Variant('delta_x', {'coordinate': 0.0}, ('delta_x',)),
        Variant('delta_y', {'coordinate': 1.0}, ('delta_y',)),
        Variant('gamma', {'coordinate': 2.0}, ('gamma',)),
        Variant('each coordinate', {'coordinate': EACH}, frees=('settling_y', 'settling_tilt')))
    choices = (
        Choice('coordinate', (0.0, 1.0, 2.0, EACH), '0 delta_x, 1 delta_y, 2 gamma, 3 each'),)

    def extend(self, extension: RingExtension, values: Mapping[str, float]) -> RingExtension:
        # Where each coordinate has its own amount, the first is that of delta_x.
        name = SETTLING[round(values['coordinate']) % len(SETTLING)]
        extended = super().extend(extension, values)
        return replace(extended, **{name: getattr(extended, name) + values['settling']})
