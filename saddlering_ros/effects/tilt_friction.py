"""Dry friction against gamma: a hysteron over gamma takes up to its moment."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

from saddlering_ros.effects.base import Effect, EffectParameter
from saddlering_ros.effects.extension import RingExtension
from saddlering_ros.effects.friction_shape import hysteron, loop_parameters
from saddlering_ros.effects.rig_tests import Outcomes, UNCLEAR


class TiltFriction(Effect):
    """Dry friction in the axial rows."""

    id = 'tilt_friction'
    title = 'Dry friction in the axial rows'
    words = (
        'Friction in the axial rows or their seals resists tilting by a nearly constant moment, '
        'which changes direction with the motion. Tilt and axial motion show a loop that does '
        'not depend on the rate and repeats in every cycle.'
    )
    settled_by = (
        'A repeat cycle with holds at zero and full load: friction shows the same loop again, '
        'settling does not, and drift continues during the holds.'
    )
    outcomes = Outcomes(
        second_rate='a loop of the same height',
        repeat_cycle='a loop that repeats and stays open during the holds',
        pull_push=UNCLEAR,
    )
    stage = 'ring'
    form = 0.1  # sticking exceeds sliding by a tenth to a quarter, and how much the speed decides
    channels = ('delta_y', 'gamma')
    parameters = (
        EffectParameter(
            'moment', 'N m', 0.0, 60000.0, 3000.0, 3000.0,
            'full friction moment', amplitude=True, one_sided=True),
        *loop_parameters('rad', 3e-7, 5e-5, 3e-6),
    )

    def extend(self, extension: RingExtension, values: Mapping[str, float]) -> RingExtension:
        """Set the friction against gamma."""
        return replace(extension, tilt_friction=hysteron(values['moment'], values))
