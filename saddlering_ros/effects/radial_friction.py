"""Dry friction against delta_x: a hysteron over delta_x takes up to its force."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

from saddlering_ros.effects.base import EffectParameter, Outcomes, RingEffect, UNCLEAR
from saddlering_ros.effects.common_shapes import hysteron, loop_parameters
from saddlering_ros.effects.extension import RingExtension


class RadialFriction(RingEffect):
    """Dry friction in the radial row."""

    id = 'radial_friction'
    title = 'Dry friction in the radial row'
    words = (
        'Cages, seals or skewed rollers resist radial motion by a nearly constant force, which '
        'changes direction with the motion. The radial channel shows a loop that does not depend '
        'on the rate, with a flat part after each reversal. Tilt and axial motion show no loop.'
    )
    settled_by = (
        'A second loading rate (x4), then a repeat cycle with holds at zero and full load: the '
        'loop keeps its height and does not close during the holds.'
    )
    outcomes = Outcomes(
        second_rate='a loop of the same height',
        repeat_cycle='a loop that repeats and stays open during the holds', pull_push=UNCLEAR)
    stage = 'ring'
    form = 0.1  # sticking exceeds sliding by a tenth to a quarter, and how much the speed decides
    channels = ('delta_x',)
    parameters = (
        EffectParameter(
            'force', 'N', 0.0, 80000.0, 5000.0, 5000.0,
            'full friction force', amplitude=True, one_sided=True),
        *loop_parameters('m', 2e-7, 3e-5, 2e-6),
    )

    def extend(self, extension: RingExtension, values: Mapping[str, float]) -> RingExtension:
        """Set the friction against delta_x."""
        return replace(extension, radial_friction=hysteron(values['force'], values))
