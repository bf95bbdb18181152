"""The engine's answer to the same question, computed once for all tests of a run.

A diagnosis takes ten seconds of processor time. Tests of commands, of the API and of what is made
of an answer ask the same of the same bags; those of the engine ask for themselves.
"""

from collections.abc import Callable, Sequence
from dataclasses import replace
import hashlib
from pathlib import Path
import pickle
from typing import Any

from made_once import MadeOnce

from saddlering_ros import diagnosis
from saddlering_ros.diagnosis import Verdict
from saddlering_ros.record.record import Record

PLACE = 'saddlering_ros.diagnosis.diagnose_ring'
"""Where commands and the API find the function that these tests replace."""


def shared_diagnose(made: MadeOnce) -> Callable[..., Verdict]:
    """The diagnosis of a ring, which computes once for each runs, rig, start and seed.

    The shipped rig is the same rig where a page reads it from its file.
    """
    compute = diagnosis.diagnose_ring

    def diagnose(runs: Sequence[Record], hold_out: Sequence[Record] = (), *, rig: Any,
                 parameters: Any = None, seed: int = 0, **more: Any) -> Verdict:
        def make(folder: Path) -> None:
            found = compute(runs, hold_out, rig=rig, parameters=parameters, seed=seed, **more)
            (folder / 'verdict').write_bytes(pickle.dumps(found))

        asked = _digest(runs, hold_out, (replace(rig, source=''), parameters, seed))
        found = pickle.loads((made.folder(f'verdicts/{asked}', make) / 'verdict').read_bytes())
        assert isinstance(found, Verdict)
        return found
    return diagnose


def _digest(runs: Sequence[Record], hold_out: Sequence[Record], rest: tuple[Any, ...]) -> str:
    digest = hashlib.sha256(repr((len(runs), rest)).encode())
    for run in (*runs, *hold_out):
        digest.update(str(run.path).encode())
        digest.update(run.load.tobytes() + run.gaps.tobytes())
    return digest.hexdigest()[:20]
