"""A worn arc of a row: what the effects of axial and radial wear share."""

from __future__ import annotations

from collections.abc import Mapping

from saddlering_ros.effects.base import Choice
from saddlering_ros.effects.extension import Wear

STIFFNESS, GAP = 0.0, 1.0
KINDS = ((STIFFNESS, 'softer rollers'), (GAP, 'larger gap'))
KIND = Choice('kind', (STIFFNESS, GAP), '0 softer rollers, 1 larger gap')

FULL_GAP = 1e-4
"""Extra gap [m] at a wear of 1."""

STARTS = ({'centre': 0.4}, {'centre': 1.6}, {'centre': 2.7})
"""Both load zones of the axial rows and the place between."""


def worn_arc(values: Mapping[str, float]) -> Wear:
    """The arc at `centre` [rad] with `half_width` [rad], worn by `wear` in one `kind`."""
    wear = values['wear']
    loss, gap = (wear, 0.0) if values['kind'] == STIFFNESS else (0.0, FULL_GAP * wear)
    return Wear(values['centre'], values['half_width'], loss, gap)
