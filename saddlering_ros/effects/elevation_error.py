"""Wrong elevation: theta + e."""

from saddlering_ros.effects.base import EffectParameter, RingEffect


class ElevationError(RingEffect):
    title = 'Elevation error'
    words = ('The elevation of the barrel differs from the record. At 50 degrees one degree too '
             'much takes 2.1 % from the radial force and 1.6 % from the moment on the shipped '
             'rig, and adds 1.5 % to the axial force. At 70 degrees it is 4.8, 3.2 and 0.6 %, so '
             'runs at two elevations tell it from a gain.')
    settled_by = 'An inclinometer on the loading axis, read at zero and at full load.'
    outcomes = {
        'inclinometer': 'an angle other than the one recorded',
        'other_elevation': 'a misfit whose share of the radial displacement changes with the '
        'elevation'}
    stage = 'load path'
    parameters = (EffectParameter(
        'angle', 'rad', -0.1, 0.1, 0.0175, 0.0, 'true elevation minus recorded elevation',
        amplitude=True, adds_to='elevation_error'),)
