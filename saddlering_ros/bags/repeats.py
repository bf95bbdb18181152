"""The same recording given twice: found by its readings, at any path and compression."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from saddlering_ros.bags.errors import BagError
from saddlering_ros.bags.reader import TestRun
from saddlering_ros.bags.scratch import blocks

SAME_SHARE = 0.5
"""Share of the shorter run's samples in common above which two runs are one recording."""


def is_same_recording(first: TestRun, second: TestRun) -> bool:
    """Whether two runs share stamps and readings over most of the shorter one."""
    shorter = min(first.stamps.size, second.stamps.size)
    begin = max(first.stamps[0], second.stamps[0])
    end = min(first.stamps[-1], second.stamps[-1]) + 1
    start, stop = np.searchsorted(first.stamps, [begin, end]).tolist()
    if stop - start <= SAME_SHARE * shorter:
        return False
    arrays = (first.stamps, first.load, first.gaps, second.stamps, second.load, second.gaps)
    equal = sum(_equal_readings(first, second, slice(start + part.start, start + part.stop))
                for part in blocks(stop - start, *arrays))
    return bool(equal > SAME_SHARE * shorter)


def _equal_readings(first: TestRun, second: TestRun, rows: slice) -> int:
    """Number of rows of a stretch of one run that are in another with the same readings."""
    stamps = first.stamps[rows]
    begin, end = np.searchsorted(second.stamps, [stamps[0], stamps[-1] + 1]).tolist()
    _, left, right = np.intersect1d(
        stamps, second.stamps[begin:end], assume_unique=True, return_indices=True)
    equal = first.load[rows][left] == second.load[begin:end][right]
    one, other = first.gaps[:, rows][:, left], second.gaps[:, begin:end][:, right]
    equal &= ((one == other) | (np.isnan(one) & np.isnan(other))).all(axis=0)
    return int(np.count_nonzero(equal))


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
