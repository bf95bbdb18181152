"""Play in the loading bracket: theta + e z, z a hysteron over the measured load."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

from saddlering_ros.effects.base import EffectParameter, Outcomes, RingEffect, UNCLEAR
from saddlering_ros.effects.common_shapes import hysteron, loop_parameters
from saddlering_ros.effects.extension import RingExtension


class BracketPlay(RingEffect):
    """Play in the loading bracket."""

    id = 'bracket_play'
    title = 'Play in the loading bracket'
    words = (
        'The bracket or trunnion shifts a little when the load changes direction. The angle of a '
        'rising load therefore differs slightly from that of a falling load. A small loop '
        'results, of opposite sign in the radial and in the tilting channels.'
    )
    settled_by = 'An inclinometer on the bracket, read while loading and unloading.'
    outcomes = Outcomes(
        inclinometer='an angle that jumps when the load changes direction',
        second_rate='a loop of the same height',
        repeat_cycle='a loop that repeats and stays open during the holds', pull_push=UNCLEAR)
    stage = 'load path'
    form = 0.1  # a bracket seats bit by bit, not all at one load
    channels = ('delta_x', 'delta_y', 'gamma')
    parameters = (
        EffectParameter(
            'angle', 'rad', 0.0, 0.03, 0.003, 0.003,
            'half the play: the angle gained while loading', amplitude=True, one_sided=True),
        *loop_parameters('N', 100.0, 20e3, 2e3),
    )

    def extend(self, extension: RingExtension, values: Mapping[str, float]) -> RingExtension:
        """Set the play of the bracket."""
        return replace(extension, bracket_play=hysteron(values['angle'], values))
