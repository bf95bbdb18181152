"""Damping that grows with penetration (Hunt and Crossley) in place of a constant D."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

from saddlering_ros.effects.base import Effect, EffectParameter
from saddlering_ros.effects.extension import RingExtension


class DampingLaw(Effect):
    """Damping grows with penetration."""

    id = 'damping_law'
    title = 'Damping grows with penetration'
    words = (
        'Rollers pressed harder damp more, where the model has one constant D. In a dynamic run '
        'the lag behind the load grows with load instead of with rate alone; a static run shows '
        'nothing.'
    )
    settled_by = (
        'A second loading rate (x4): the lag scales with rate at each load, and its shape over '
        'load stays.'
    )
    stage = 'ring'
    form = 0.2  # damping may grow by another power of penetration
    channels = ('delta_x', 'delta_y', 'gamma')
    parameters = (
        EffectParameter(
            'share', '1', 0.0, 1.0, 0.5, 0.5,
            'share of the damping that is proportional to p^n', amplitude=True, one_sided=True),
    )
    dynamic_only = True

    def extend(self, extension: RingExtension, values: Mapping[str, float]) -> RingExtension:
        """Set the share of growing damping."""
        return replace(extension, damping_penetration_share=values['share'])
