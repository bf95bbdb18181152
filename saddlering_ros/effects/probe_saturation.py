"""A probe at the end of its span: d_i clipped at a limit."""

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

from saddlering_ros.effects.base import Choice, EffectParameter, MOVES, probe_variants, ProbeEffect
from saddlering_ros.effects.extension import RingExtension


class ProbeSaturation(ProbeEffect):
    title = 'Probe saturation'
    words = ('One probe reaches the end of its span, and its reading stays constant while the '
             'ring moves on. The reading is cut off at one level, for rising and falling load, '
             'and right below this level.')
    settled_by = ('The same test with the gap of that probe set wider or narrower at zero; '
                  'swapped probes.')
    outcomes = {
        'swapped_probes': MOVES,
        'other_gap': 'a flat part that moves to another load or disappears'}
    parameters = (EffectParameter(
        'limit', 'm', 2e-6, 1e-3, 8e-5, 8e-5,
        'travel from zero at which the reading is cut off; large: never', amplitude=True,
        one_sided=True, neutral=1e-3, logarithmic=True),)
    variants = (
        *probe_variants({'side': 1.0}, ', increasing readings'),
        *probe_variants({'side': -1.0}, ', decreasing readings'))
    choices = (*ProbeEffect.choices,
               Choice('side', (1.0, -1.0), '1 increasing readings, -1 decreasing ones'))
    starts = tuple({'limit': limit} for limit in (2e-5, 4e-5, 8e-5, 1.2e-4, 1.6e-4, 2e-4))

    def extend(self, extension: RingExtension, values: Mapping[str, float]) -> RingExtension:
        name = 'saturation_high' if values['side'] > 0.0 else 'saturation_low'
        levels = list(getattr(extension, name))
        levels[round(values['probe']) - 1] = values['side'] * values['limit']
        changed: dict[str, Any] = {name: tuple(levels)}
        return replace(extension, **changed)
