"""One diagnosis as a job of a worker process: plain data in, plain data out, no ROS in it."""

from __future__ import annotations

from dataclasses import dataclass
import json

from saddlering_ros.progress import OnProgress
from saddlering_ros.rig import ParameterSet, Rig


@dataclass(frozen=True)
class DiagnosisRequest:
    """Input of a diagnosis: bags by path, held-out bags, the rig, a parameter file or ''."""

    bags: tuple[str, ...]
    hold_out: tuple[str, ...]
    rig: Rig
    parameters_file: str
    seed: int


@dataclass(frozen=True)
class DiagnosisAnswer:
    """The word of the verdict, its JSON, a sentence, and the parameters with the causes."""

    verdict: str
    verdict_json: str
    words: str
    parameters: ParameterSet


PRELOADED = ('saddlering_ros.api.functions',)
"""What the worker imports before the first job; the node has no need of it."""


def run(request: DiagnosisRequest, on_progress: OnProgress) -> DiagnosisAnswer:
    """Diagnose."""
    from saddlering_ros.api.functions import diagnose

    result = diagnose(
        request.bags, hold_out=request.hold_out, rig=request.rig,
        parameters=request.parameters_file or None, seed=request.seed, on_progress=on_progress)
    words = result.verdict + (f': {", ".join(result.causes)}' if result.causes else '')
    return DiagnosisAnswer(result.verdict, json.dumps(result.document), words, result.parameters)
