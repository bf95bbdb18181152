"""Another clearance than assumed: mu1 + e (1 + s u), half at each side, u in -1 to 1 by roller."""

from saddlering_ros.effects.base import ClearanceEffect


class AxialClearance(ClearanceEffect):
    title = 'Wrong axial clearance'
    words = ('The clearance of the axial rows differs from the rig file. Tilt and axial motion '
             'begin with a dead zone and then have a nearly constant error, because fewer or more '
             'rollers share the load.')
    outcomes = {'pull_push': 'an axial jump other than the clearance in the rig file'}
    rows = ('upper_row', 'lower_row')
    channels = ('delta_y', 'gamma')
