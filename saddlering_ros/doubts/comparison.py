"""Comparison of the rig of a bag with the rig in use, by the hashes of their descriptions.

A forgotten rig file simulates another ring: every channel misfits, and the advice is wrong.
"""

from collections.abc import Sequence
from itertools import combinations
import math

import numpy as np

from saddlering_ros.errors import BagError
from saddlering_ros.record.batches import Mask, Rows
from saddlering_ros.record.record import RawRecord, Record
from saddlering_ros.record.scratch import blocks
from saddlering_ros.rig import default_rig, ParameterSet, Rig, RigError, short_digest

UNDESCRIBED = ('', 'virtual rig')
"""Names of rigs without a file: no name, and that of the shipped bags."""


def refuse_other_rig(runs: Sequence[Record], rig: Rig) -> None:
    """BagError if a run states the hash of another rig than `rig`.

    A run that names a rig without a hash gets a note if the shipped rig is simulated.
    """
    for run in runs:
        refuse_other_hash(run, rig)
        is_shipped = rig.digest == default_rig().digest
        if not run.rig_hash and run.rig not in UNDESCRIBED and is_shipped:
            note = (f'the bag names the rig {run.rig!r}, and the shipped rig is simulated '
                    f'({rig_in_words(rig)}): give its rig file if it differs')
            if note not in run.notes:
                run.notes.append(note)


def refuse_other_hash(run: Record | RawRecord, rig: Rig) -> None:
    """BagError if a bag states the hash of another rig than `rig`."""
    if run.rig_hash and run.rig_hash != rig.digest:
        name = f' {run.rig!r}' if run.rig else ''
        is_shipped = rig.digest == default_rig().digest
        in_use = 'shipped rig is in use, which' if is_shipped else 'rig in use'
        raise BagError(
            f'{run.path}: was recorded on the rig{name} with the hash '
            f'{short_digest(run.rig_hash)}, and the {in_use} is another ({rig_in_words(rig)}): '
            'give rig=FILE of that rig, or trust_rig=True to continue with this rig')


def refuse_parameters_of_other_rig(parameters: ParameterSet, rig: Rig) -> None:
    """RigError if parameters state the hash of another rig than the one they are used with."""
    recorded = parameters.source.rig_hash
    if recorded and recorded != rig.digest:
        raise RigError(
            f'the parameters belong to the rig with the hash {short_digest(recorded)}, and the '
            f'rig in use has {short_digest(rig.digest)}: give rig=FILE of that rig, or '
            'trust_rig=True to continue with this rig')


def rig_in_words(rig: Rig) -> str:
    """Main dimensions of a rig, and its hash."""
    return (f'{rig.axial_rows.rollers} rollers in a row, '
            f'{rig.full_scale_words}, hash {short_digest(rig.digest)}')


SAME_SHARE = 0.5
"""Share of the shorter run's samples in common above which two runs are one recording."""

ANCHORS, ANCHOR_ROWS = (0.3, 0.5, 0.7), 16
"""Shares of the length of the shorter run, from which it is searched in the longer one; and the
successive loads that are searched."""


def is_same_recording(first: Record, second: Record) -> bool:
    """Whether two runs share their readings over most of the shorter one; stamps do not count."""
    shorter, longer = sorted((first, second), key=lambda run: len(run.load))
    wanted = SAME_SHARE * len(shorter.load)
    if shared_rows(first, second) > wanted:
        return True
    for share in ANCHORS:
        anchor = int(share * len(shorter.load))
        head = shorter.load[anchor:anchor + ANCHOR_ROWS]
        if len(head) < ANCHOR_ROWS or head.min() == head.max():
            continue
        for block in blocks(len(longer.load) - len(head) + 1, longer.load):
            places = block.start + np.flatnonzero(longer.load[block] == head[0])
            if any(_equal_from(shorter, longer, place - anchor) > wanted
                   for place in places.tolist()
                   if np.array_equal(longer.load[place:place + len(head)], head)):
                return True
    return False


def overlap_words(first: Record, second: Record) -> str:
    """A note on a part of `second` that `first` holds too, with the same stamps; '' without."""
    shared = shared_rows(first, second)
    return '' if not shared else (
        f'{shared} of its {len(second.load)} samples stand in {first.path} too, with the same '
        'stamps, and count twice: give one of the two, or remove this part from one of them')


def _equal_from(shorter: Record, longer: Record, shift: int) -> int:
    """Number of rows of a run that equal those of another `shift` rows later."""
    start = max(0, -shift)
    stop = min(len(shorter.load), len(longer.load) - shift)
    count = 0
    for block in blocks(stop - start, shorter.load, shorter.gaps, longer.load, longer.gaps):
        rows = slice(start + block.start, start + block.stop)
        count += np.count_nonzero(
            _equal(shorter, rows, longer, slice(rows.start + shift, rows.stop + shift)))
    return count


def shared_rows(first: Record, second: Record) -> int:
    """Number of rows that two runs share with stamp and readings; 0 if they are too few to tell.

    Loads and gaps without noise, at rest, are equal in two runs that begin alike: they tell none.
    """
    start, stop = np.searchsorted(first.stamps, [
        max(first.stamps[0], second.stamps[0]),
        min(first.stamps[-1], second.stamps[-1]) + 1]).tolist()
    arrays = (first.stamps, first.load, first.gaps, second.stamps, second.load, second.gaps)
    count, low, high = 0, math.inf, -math.inf
    for block in blocks(max(0, stop - start), *arrays):
        rows = slice(start + block.start, start + block.stop)
        stamps = first.stamps[rows]
        others = slice(*np.searchsorted(second.stamps, [stamps[0], stamps[-1] + 1]).tolist())
        _, left, right = np.intersect1d(stamps, second.stamps[others], assume_unique=True,
                                        return_indices=True)
        same = _equal(first, rows.start + left, second, others.start + right)
        loads = first.load[rows][left][same]
        count += len(loads)
        low, high = loads.min(initial=low), loads.max(initial=high)
    return count if count >= ANCHOR_ROWS and low < high else 0


def _equal(first: Record, rows: Rows, second: Record, others: Rows) -> Mask:
    """Mask of the rows at which two runs have equal loads and gaps; NaN equals NaN."""
    gaps, other_gaps = first.gaps[:, rows], second.gaps[:, others]
    same = (gaps == other_gaps) | (np.isnan(gaps) & np.isnan(other_gaps))
    equal: Mask = same.all(axis=0) & (first.load[rows] == second.load[others])
    return equal


def refuse_repeats(runs: Sequence[Record], held_out: Sequence[Record] = ()) -> None:
    """BagError (one line) if a recording is given twice, or is both fitted and held out.

    Runs of several rings, by their names, and those that share a smaller part get a note.
    """
    rings = sorted({run.ring for run in (*runs, *held_out)} - {''})
    note = (f'the bags name the rings {" and ".join(rings)}, and count as tests of one: give '
            'those of one ring, or correct "ring" (or else "rig") of their metadata')
    for run in (*runs, *held_out) if len(rings) > 1 else ():
        if note not in run.notes:
            run.notes.append(note)
    for (place, first), (later, second) in combinations(enumerate([*runs, *held_out]), 2):
        if not is_same_recording(first, second):
            note = overlap_words(first, second)
            if note and note not in second.notes:
                second.notes.append(note)
            continue
        if place < len(runs) <= later:
            raise BagError(
                f'{second.path}: holds the same recording as {first.path}, which is fitted: hold '
                'out another recording, because the agreement of this one would prove nothing')
        raise BagError(f'{second.path}: holds the same recording as {first.path}: give it once, '
                       'because a second copy would make the errors too small')
