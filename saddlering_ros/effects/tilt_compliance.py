"""A spring in series with the rollers: gamma += c M."""

from saddlering_ros.effects.base import Choice, EffectParameter, RingEffect, Variant

TILT, EACH = 2.0, 3.0
"""The choices: tilt alone, or every coordinate by its own amount."""


class TiltCompliance(RingEffect):
    title = 'Tilt compliance in series'
    words = ('Bolts, ring bodies or the carriage bend under the tilting moment in series with the '
             'rollers. The additional tilt is a straight line over the moment, without loop and '
             'without damping. A joint that bends unevenly moves the ring radially and axially '
             'too, each in proportion to its own force.')
    settled_by = 'A second loading rate (x4), or an inclinometer on the upper ring itself.'
    outcomes = {'other_elevation': 'a misfit of the tilt in proportion to the tilting moment'}
    stage = 'ring'
    parameters = (
        EffectParameter('compliance', 'rad/(N m)', 0.0, 5e-10, 1e-10, 1e-10,
                        'motion per unit of moment', amplitude=True, one_sided=True,
                        adds_to='tilt_compliance'),
        EffectParameter('compliance_x', 'm/N', 0.0, 4e-10, 6e-11, 0.0,
                        'radial motion per unit of radial force, where every coordinate has its '
                        'own', amplitude=True, one_sided=True, adds_to='radial_compliance'),
        EffectParameter('compliance_y', 'm/N', 0.0, 3e-10, 5e-11, 0.0,
                        'axial motion per unit of axial force, where every coordinate has its own',
                        amplitude=True, one_sided=True, adds_to='axial_compliance'))
    variants = (
        Variant('gamma', {'coordinate': TILT}, ('gamma',)),
        Variant('each coordinate', {'coordinate': EACH},
                frees=('compliance_x', 'compliance_y'),
                contains=('radial_compliance', 'axial_compliance')))
    choices = (Choice('coordinate', (TILT, EACH), '2 gamma, 3 each'),)
