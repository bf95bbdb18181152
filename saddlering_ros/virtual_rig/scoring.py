"""How a verdict counts once the seal is opened; benchmark and test suite share this one rule."""

from __future__ import annotations

from collections.abc import Sequence

from saddlering_ros.virtual_rig.campaign import CLEAN, OUTSIDE

LARGEST_GROUP = 4
"""A group of more look-alikes than this is no answer."""


def score(
    kind: str, hidden: Sequence[str], verdict: str, groups: Sequence[Sequence[str]]
) -> tuple[str, int]:
    """How a verdict counts, and how many hidden effects are in its groups.

    right: every group holds a hidden effect, none is larger than four, and all effects are found;
    part: the same with some not found; wrong: a single name that is not hidden, beside a right one
    too; missed: `none` for something; false: anything on a clean rig; unknown: said of an effect
    of the catalogue; vague: groups too large or that miss.
    """
    found = sum(any(name in group for group in groups) for name in hidden)
    if kind == CLEAN:
        return ('right' if verdict == 'none' else 'false'), 0
    if verdict == 'none':
        return 'missed', 0
    if verdict == 'unknown':
        return ('right' if kind == OUTSIDE else 'unknown'), found
    strays = [group for group in groups if not any(name in group for name in hidden)]
    if strays:
        return ('wrong' if any(len(group) == 1 for group in strays) else 'vague'), found
    if any(len(group) > LARGEST_GROUP for group in groups):
        return 'vague', found
    return ('right' if found == len(hidden) else 'part'), found
