"""Dry friction against delta_x: a hysteron over delta_x takes up to its force."""

from saddlering_ros.effects.base import EffectParameter, FrictionEffect, loop_parameters


class RadialFriction(FrictionEffect):
    title = 'Dry friction in the radial row'
    words = ('Cages, seals or skewed rollers resist radial motion by a nearly constant force, '
             'which changes direction with the motion. The radial channel shows a loop that does '
             'not depend on the rate, with a flat part after each reversal. Tilt and axial motion '
             'show no loop.')
    settled_by = ('A second loading rate (x4), then a repeat cycle with holds at zero and full '
                  'load: the loop keeps its height and does not close during the holds.')
    element = 'radial_friction'
    stage = 'ring'
    form = 0.1  # sticking exceeds sliding by a tenth to a quarter, and how much the speed decides
    channels = ('delta_x',)
    parameters = (
        EffectParameter('force', 'N', 0.0, 80000.0, 5000.0, 5000.0, 'full friction force',
                        amplitude=True, one_sided=True),
        *loop_parameters('m', 2e-7, 3e-5, 2e-6))
