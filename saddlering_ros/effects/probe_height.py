"""Radial probes higher than assumed: d1 and -d3 see delta_x + (h_s + h) gamma."""

from saddlering_ros.effects.base import EffectParameter, RingEffect


class ProbeHeight(RingEffect):
    title = 'Height of the radial probes'
    words = ('The two radial probes sit higher or lower over the mid-plane of the ring than the '
             'rig file gives, so that they measure a part of the tilt. The error of the radial '
             'channel has the shape of the tilt.')
    settled_by = ('Measure the height of probes 1 and 3 over the mid-plane; or record a run at '
                  'another elevation, where the ratio of tilt and radial force differs.')
    outcomes = {
        'heights': 'another height of probes 1 and 3 than in the rig file',
        'other_elevation': 'a radial misfit in proportion to the tilt'}
    stage = 'measurement'
    channels = ('delta_x',)
    parameters = (EffectParameter(
        'height', 'm', -0.2, 0.2, 0.02, 0.0, 'true height minus the height in the rig file',
        amplitude=True, adds_to='probe_height'),)
