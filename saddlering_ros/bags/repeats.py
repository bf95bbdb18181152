"""The same recording given twice: found by its readings, whatever its path and compression."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from saddlering_ros.bags.errors import BagError
from saddlering_ros.bags.reader import TestRun

SAME_SHARE = 0.5
"""Two runs that share more than this part of the shorter one's samples are one recording."""


def is_same_recording(first: TestRun, second: TestRun) -> bool:
    """Whether two runs share stamps and readings over most of the shorter one."""
    common, left, right = np.intersect1d(
        first.stamps, second.stamps, assume_unique=True, return_indices=True)
    shorter = min(first.stamps.size, second.stamps.size)
    if common.size <= SAME_SHARE * shorter:
        return False
    equal = first.load[left] == second.load[right]
    one, other = first.gaps[:, left], second.gaps[:, right]
    equal &= ((one == other) | (np.isnan(one) & np.isnan(other))).all(axis=0)
    return bool(np.count_nonzero(equal) > SAME_SHARE * shorter)


def refuse_repeats(runs: Sequence[TestRun], held_out: Sequence[TestRun] = ()) -> None:
    """BagError (one line) if a recording is given twice, or is both fitted and held out."""
    every = [*runs, *held_out]
    for later, second in enumerate(every):
        for first in every[:later]:
            if not is_same_recording(first, second):
                continue
            if later >= len(runs) and any(first is run for run in runs):
                raise BagError(
                    f'{second.path}: holds the same recording as {first.path}, which is fitted: '
                    'hold out another recording, because the agreement of this one would prove '
                    'nothing')
            raise BagError(
                f'{second.path}: holds the same recording as {first.path}: give it once, because '
                'a second copy would make the errors too small')
