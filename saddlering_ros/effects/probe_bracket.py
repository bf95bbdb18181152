"""A probe bracket that bends with load: d_i += b P."""

from saddlering_ros.effects.base import EffectParameter, ProbeEffect


class ProbeBracket(ProbeEffect):
    title = 'Probe bracket bends with load'
    words = ('The bracket of one probe moves with the load, because it bends or its base moves. '
             'The error of this probe is a straight line over load, without loop, and affects two '
             'channels.')
    settled_by = ('Swapped probes: the error stays with the bracket; the ring slewed by 90 deg '
                  'does not change the error.')
    outcomes = {'other_elevation': 'a misfit of one probe in the same proportion to the load'}
    parameters = (EffectParameter(
        'compliance', 'm/N', -2e-10, 2e-10, 2e-11, 0.0, 'motion of the bracket per unit of load',
        amplitude=True, adds_to='probe_bracket'),)
