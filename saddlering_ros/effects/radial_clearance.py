"""Another clearance than assumed: mu2 + e (1 + s u), half at each side, u in -1 to 1 by roller."""

from saddlering_ros.effects.base import ClearanceEffect


class RadialClearance(ClearanceEffect):
    title = 'Wrong radial clearance'
    words = ('The clearance of the radial row differs from the rig file. The radial channel '
             'begins with a dead zone and then has a nearly constant error, because fewer or more '
             'rollers share the load.')
    outcomes = {'pull_push': 'a radial jump other than the clearance in the rig file'}
    rows = ('radial_row',)
    channels = ('delta_x',)
