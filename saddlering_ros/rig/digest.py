"""The hash of a rig's description: equal for equal rigs, in any form of their files."""

from __future__ import annotations

from dataclasses import asdict
import hashlib
import json
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from saddlering_ros.rig.description import Rig

SHORT_DIGITS = 12
"""Digits of the form for people."""

NOT_OF_THE_RIG = ('bounds', 'force_unit', 'full_scale_time', 'absent')
"""Fields of a Rig for identification, guarding and display, and the number of a probe that is
absent. They are not part of the hash: the ring is the same."""

FIELDS = {'middle_row': 'radial_row'}
"""Fields of a Rig by the names of rig files where these differ; the hash is that of the files'."""

NAMES_IN_FILES = {field: name for name, field in FIELDS.items()}


def rig_digest(rig: Rig) -> str:
    """SHA-256 of the rig's canonical description: its SI numbers as JSON, keys sorted.

    Numbers are written with the fewest digits that give the same float, -0 as 0. Search
    bounds, the limit of the guard and the unit of forces on screens are left out.
    """
    text = json.dumps(_canonical(asdict(rig)), sort_keys=True, separators=(',', ':'))
    return hashlib.sha256(text.encode()).hexdigest()


def short_digest(digest: str) -> str:
    """The first digits, for people: enough to distinguish the rigs of one firm."""
    return digest[:SHORT_DIGITS]


def _canonical(value: object) -> object:
    if isinstance(value, dict):
        return {NAMES_IN_FILES.get(key, key): _canonical(item) for key, item in value.items()
                if key not in NOT_OF_THE_RIG}
    if isinstance(value, (list, tuple)):
        return [_canonical(item) for item in value]
    if isinstance(value, (int, float)) and not isinstance(value, bool):
        return float(value) + 0.0
    return value
