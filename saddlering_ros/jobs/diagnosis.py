"""One diagnosis as a job of a worker process: plain data in, plain data out, no ROS in it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
import json

from saddlering_ros.diagnosis import diagnose_bags
from saddlering_ros.diagnosis.contract import causes_of
from saddlering_ros.jobs.plain_types import PARAMETER_TYPES, RIG_TYPES
from saddlering_ros.rig import ParameterSet, read_parameters, Rig


@dataclass(frozen=True)
class DiagnosisRequest:
    """What to diagnose: bags by path, those held out, the rig, a parameter file ('' for none)."""

    bags: tuple[str, ...]
    hold_out: tuple[str, ...]
    rig: Rig
    parameters_file: str
    seed: int


@dataclass(frozen=True)
class DiagnosisAnswer:
    """The verdict's word, its JSON, a sentence, and the parameters with what was found."""

    verdict: str
    verdict_json: str
    words: str
    parameters: ParameterSet


TYPES = (*PARAMETER_TYPES, *RIG_TYPES, DiagnosisRequest, DiagnosisAnswer)
"""What may go between the node and its worker."""


def run(request: DiagnosisRequest, on_progress: Callable[[tuple[str, float]], None],
        ) -> DiagnosisAnswer:
    """Diagnose."""
    start = read_parameters(request.parameters_file) if request.parameters_file else None
    found = diagnose_bags(
        request.bags, request.hold_out, request.rig, start, seed=request.seed,
        on_progress=lambda stage, share: on_progress((stage, share)))
    document = found.to_json()
    causes = [cause['effect'] for cause in causes_of(document)]
    words = found.verdict + (f': {", ".join(causes)}' if causes else '')
    return DiagnosisAnswer(found.verdict, json.dumps(document), words, found.extended_parameters())
