"""Play in the loading bracket: theta + e z, z a hysteron over the measured load."""

from saddlering_ros.effects.base import EffectParameter, FrictionEffect, loop_parameters


class BracketPlay(FrictionEffect):
    title = 'Play in the loading bracket'
    words = ('The bracket or trunnion shifts a little when the load changes direction. The angle '
             'of a rising load therefore differs slightly from that of a falling load. A small '
             'loop results, of opposite sense in the axial channel and in the two others.')
    settled_by = 'An inclinometer on the bracket, read while loading and unloading.'
    outcomes = {
        **FrictionEffect.outcomes,
        'inclinometer': 'an angle that jumps when the load changes direction'}
    element = 'bracket_play'
    stage = 'load path'
    form = 0.1  # a bracket seats bit by bit, not all at one load
    parameters = (
        EffectParameter(
            'angle', 'rad', 0.0, 0.03, 0.003, 0.003,
            'half the play: the angle gained while loading', amplitude=True, one_sided=True),
        *loop_parameters('N', 100.0, 20e3, 2e3))
