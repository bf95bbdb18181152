"""Comparison of the rig of a bag with the rig in use, by the hashes of their descriptions.

A forgotten rig file simulates another ring: every channel misfits, and the advice is wrong.
"""

from __future__ import annotations

from collections.abc import Sequence

from saddlering_ros.record.errors import BagError
from saddlering_ros.record.record import Record
from saddlering_ros.rig import Rig, short_digest

UNDESCRIBED = ('', 'virtual rig')
"""Names of rigs without a file: no name, and that of the shipped bags."""


def refuse_other_rig(runs: Sequence[Record], rig: Rig, *, is_given: bool) -> None:
    """BagError if a run states the hash of another rig than `rig`.

    is_given: whether the user named `rig`; otherwise it is the shipped one. A run that names a
    rig without its hash then gets a note.
    """
    for run in runs:
        if run.rig_hash and run.rig_hash != rig.digest:
            raise BagError(_refusal(run, rig, is_given))
        if not (run.rig_hash or is_given or run.rig in UNDESCRIBED):
            note = (f'the bag names the rig {run.rig!r} and no rig file is given: the shipped '
                    f'rig is simulated ({rig_in_words(rig)}); give its rig file if it differs')
            if note not in run.notes:
                run.notes.append(note)


def rig_in_words(rig: Rig) -> str:
    """Main dimensions of a rig, and its hash."""
    return (f'{rig.axial_rows.rollers} rollers in a row, '
            f'{rig.full_scale_words}, hash {short_digest(rig.digest)}')


def _refusal(run: Record, rig: Rig, is_given: bool) -> str:
    name = f' {run.rig!r}' if run.rig else ''
    known = f'was recorded on the rig{name} with the hash {short_digest(run.rig_hash)}'
    given = 'the given rig is another' if is_given else \
        'no rig is given, and the shipped one is another'
    return (f'{run.path}: {known}, {given} ({rig_in_words(rig)}): give rig=FILE of that rig, or '
            'trust_rig=True to continue with this rig')
