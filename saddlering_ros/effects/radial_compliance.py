"""A spring in series with the rollers: delta_x += c F_x."""

from saddlering_ros.effects.base import EffectParameter, RingEffect


class RadialCompliance(RingEffect):
    title = 'Radial compliance in series'
    words = ('Bolts, ring bodies or the carriage deform radially in series with the rollers. The '
             'additional motion is a straight line over load, without loop and without damping, '
             'so that the radial stiffness imitates nearly all of it.')
    settled_by = 'A second loading rate (x4): the compliance has no damping, the rollers have.'
    outcomes = {'other_elevation': 'a radial misfit in proportion to the radial force'}
    stage = 'ring'
    channels = ('delta_x',)
    parameters = (EffectParameter(
        'compliance', 'm/N', 0.0, 4e-10, 6e-11, 6e-11, 'motion per unit of force', amplitude=True,
        one_sided=True, adds_to='radial_compliance'),)
