"""Dry friction in the axial rows: a hysteron over gamma or delta_y takes up to its moment."""

from collections.abc import Mapping
from dataclasses import replace

from saddlering_ros.effects import base
from saddlering_ros.effects.base import Choice, EffectParameter, FrictionEffect, hysteron, Variant
from saddlering_ros.effects.extension import RingExtension

AXIAL, TILT, EACH = 1.0, 2.0, 3.0
"""The choices: against axial motion alone, against tilting alone, or against every motion."""


class TiltFriction(FrictionEffect):
    title = 'Dry friction in the axial rows'
    words = ('Friction in the axial rows or their seals resists tilting by a nearly constant '
             'moment, which changes direction with the motion. Tilt and axial motion show a loop '
             'that does not depend on the rate and repeats in every cycle. A seal that rubs all '
             'around resists axial and radial motion too, each by a force of its own; one that '
             'rubs evenly resists axial motion alone.')
    settled_by = ('A repeat cycle with holds at zero and full load: friction shows the same loop '
                  'again, settling does not, and drift continues during the holds.')
    element = 'tilt_friction'
    stage = 'ring'
    form = 0.1  # sticking exceeds sliding by a tenth to a quarter, and how much the speed decides
    parameters = (
        EffectParameter('moment', 'N m', 0.0, 60000.0, 3000.0, 3000.0,
                        'full friction moment; of axial motion alone the force at 1 m from the '
                        'axis', amplitude=True, one_sided=True),
        *base.loop_parameters('rad', 3e-7, 5e-5, 3e-6),
        EffectParameter('force', 'N', 0.0, 80000.0, 5000.0, 0.0,
                        'full friction force against radial motion, where each coordinate has its '
                        'own', amplitude=True, one_sided=True),
        EffectParameter('presliding_x', 'm', 2e-7, 3e-5, 2e-6, 2e-6,
                        'radial travel after a reversal within which friction changes direction',
                        one_sided=True, logarithmic=True),
        EffectParameter('force_y', 'N', 0.0, 80000.0, 5000.0, 0.0,
                        'full friction force against axial motion, where each coordinate has its '
                        'own', amplitude=True, one_sided=True),
        EffectParameter('presliding_y', 'm', 3e-7, 5e-5, 3e-6, 3e-6,
                        'axial travel after a reversal within which friction changes direction',
                        one_sided=True, logarithmic=True))
    variants = (
        Variant('gamma', {'coordinate': TILT}, ('delta_y', 'gamma')),
        Variant('delta_y', {'coordinate': AXIAL}, ('delta_y', 'gamma')),
        Variant('each coordinate', {'coordinate': EACH},
                frees=('force', 'presliding_x', 'force_y', 'presliding_y'),
                contains=('radial_friction',)))
    choices = (Choice('coordinate', (TILT, AXIAL, EACH), '2 gamma, 1 delta_y, 3 each'),)

    def extend(self, extension: RingExtension, values: Mapping[str, float]) -> RingExtension:
        if values['coordinate'] == AXIAL:
            return replace(extension, axial_friction=hysteron(values['moment'], values))
        tilted = super().extend(extension, values)
        if values['coordinate'] != EACH:
            return tilted
        radial = {**values, 'presliding': values['presliding_x']}
        axial = {**values, 'presliding': values['presliding_y']}
        return replace(tilted, radial_friction=hysteron(values['force'], radial),
                       axial_friction=hysteron(values['force_y'], axial))
