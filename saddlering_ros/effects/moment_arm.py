"""Load applied higher or lower than assumed: y_t + e."""

from saddlering_ros.effects.base import EffectParameter, RingEffect


class MomentArm(RingEffect):
    title = 'Wrong moment arm'
    words = ('The load acts higher or lower over the ring than in the rig file. Only the tilting '
             'moment changes. Tilt changes, and axial motion with it, because the same rows carry '
             'both. The radial channel does not change.')
    settled_by = ('Measure the height of the loading axis over the ring, or hang a reference load '
                  'from a known arm.')
    outcomes = {
        'heights': 'another height of the loading axis than in the rig file',
        'other_elevation': 'a misfit of tilt and axial motion only'}
    stage = 'load path'
    channels = ('delta_y', 'gamma')
    parameters = (EffectParameter(
        'offset', 'm', -0.3, 0.3, 0.03, 0.0,
        'true height of the trunnion minus the height in the rig file', amplitude=True,
        adds_to='moment_arm'),)
