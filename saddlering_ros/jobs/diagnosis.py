"""One diagnosis or comparison as a job of a worker process: plain data in and out, no ROS."""

from __future__ import annotations

from dataclasses import dataclass
import json

from saddlering_ros.progress import OnProgress
from saddlering_ros.rig import ParameterSet, Rig


@dataclass(frozen=True)
class DiagnosisRequest:
    """Bags by path, those of an earlier session, held-out bags, the rig, a file or ''."""

    bags: tuple[str, ...]
    before: tuple[str, ...]
    hold_out: tuple[str, ...]
    rig: Rig
    parameters_file: str
    seed: int


@dataclass(frozen=True)
class DiagnosisAnswer:
    """The word of the verdict, its JSON, a sentence; parameters with causes, None of a change."""

    verdict: str
    verdict_json: str
    words: str
    parameters: ParameterSet | None


PRELOADED = ('saddlering_ros.api.functions',)
"""What the worker imports before the first job; the node has no need of it."""


def run(request: DiagnosisRequest, on_progress: OnProgress) -> DiagnosisAnswer:
    """Diagnose, or compare with the earlier session."""
    from saddlering_ros.api.comparison import compare
    from saddlering_ros.api.functions import diagnose

    if request.before:
        change = compare(request.before, request.bags, rig=request.rig, seed=request.seed,
                         on_progress=on_progress)
        return DiagnosisAnswer(change.verdict, json.dumps(change.to_json()), change.headline, None)
    result = diagnose(
        request.bags, hold_out=request.hold_out, rig=request.rig,
        parameters=request.parameters_file or None, seed=request.seed, on_progress=on_progress)
    words = result.verdict + (f': {", ".join(result.causes)}' if result.causes else '')
    return DiagnosisAnswer(result.verdict, json.dumps(result.document), words, result.parameters)
