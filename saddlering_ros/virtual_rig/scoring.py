"""The score of a verdict after the seal is opened; benchmark and test suite share this rule."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from scipy.stats import binom

from saddlering_ros.virtual_rig.campaign import CLEAN, OUTSIDE, PAIR, SINGLE

MAX_GROUP = 4
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
    if any(len(group) > MAX_GROUP for group in groups):
        return 'vague', found
    return ('right' if found == len(hidden) else 'part'), found


@dataclass(frozen=True)
class Promise:
    """How often verdicts of some kinds of rig may (or must) have a score."""

    words: str
    kinds: tuple[str, ...]
    score: str
    rate: float
    is_minimum: bool


PROMISES = (
    Promise('sound rigs with a cause', (CLEAN,), 'false', 0.02, False),
    Promise('faults with a wrong name', (SINGLE, PAIR, OUTSIDE), 'wrong', 0.02, False),
    Promise('single effects found', (SINGLE,), 'right', 0.8, True),
    Promise('effects outside the catalogue called unknown', (OUTSIDE,), 'right', 0.85, True),
)
CHANCE = 1e-3
"""At which a program that just keeps a promise fails it."""


def broken_promises(scores: Sequence[tuple[str, str]]) -> list[str]:
    """Return each promise that a campaign of (kind, score) breaks, in words with its figures."""
    broken = []
    for promise in PROMISES:
        own = [score for kind, score in scores if kind in promise.kinds]
        count = own.count(promise.score)
        unlikely = (binom.cdf(count, len(own), promise.rate) if promise.is_minimum
                    else binom.sf(count - 1, len(own), promise.rate))
        if own and unlikely < CHANCE:
            broken.append(f'{promise.words}: {count} of {len(own)}, promised '
                          f'{"at least" if promise.is_minimum else "at most"} {promise.rate:.0%}')
    return broken
