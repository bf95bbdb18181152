"""Shape of a friction loop: the parameters that all hysteretic effects share."""

from __future__ import annotations

from collections.abc import Mapping

from saddlering_ros.effects.base import EffectParameter
from saddlering_ros.effects.extension import Hysteron


def loop_parameters(presliding_unit: str, low: float, high: float,
                    start: float) -> tuple[EffectParameter, ...]:
    """Presliding between `low` and `high`, sharpness of the loop's corners, and how it begins."""
    return (
        EffectParameter(
            'presliding', presliding_unit, low, high, start, start,
            'travel after a reversal within which friction changes direction', one_sided=True,
            logarithmic=True),
        EffectParameter(
            'sharpness', '1', 0.0, 1.0, 0.5, 0.5,
            'corners of the loop: 0 rounded (Dahl), 1 sharp (Jenkins)', one_sided=True),
        EffectParameter(
            'initial', '1', -1.0, 1.0, 0.5, 0.0,
            'share of the friction at the zero of the run: 1 as while loading, -1 as while '
            'unloading'),
    )


def hysteron(limit: float, values: Mapping[str, float]) -> Hysteron:
    """The friction element of height `limit` with the loop parameters in `values`."""
    return Hysteron(limit, values['presliding'], values['sharpness'], values['initial'])
