"""Jobs of a worker process: identification, diagnosis, comparison. Plain data in and out, no ROS.

The API is imported by the worker alone; the nodes have no need of it.
"""

from __future__ import annotations

from dataclasses import dataclass
import json
from typing import TYPE_CHECKING

from saddlering_ros.progress import OnProgress
from saddlering_ros.rig import ParameterSet, Rig

if TYPE_CHECKING:
    from saddlering_ros.identification import IdentificationSettings

PRELOADED = ('saddlering_ros.api.functions',)
"""What the worker imports before the first job."""


@dataclass(frozen=True)
class IdentificationRequest:
    """Input of an identification: bags by path, those held out, the rig, and the settings."""

    bags: tuple[str, ...]
    validation_bags: tuple[str, ...]
    rig: Rig
    settings: IdentificationSettings


@dataclass(frozen=True)
class IdentificationAnswer:
    """Result; validation and report as JSON texts."""

    parameters: ParameterSet
    objective: float
    words: str
    validation_json: str
    report_json: str


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


def run(
    request: IdentificationRequest | DiagnosisRequest, on_progress: OnProgress,
) -> IdentificationAnswer | DiagnosisAnswer:
    """Do the job of a request."""
    if isinstance(request, IdentificationRequest):
        return _identified(request, on_progress)
    return _diagnosed(request, on_progress)


def _identified(request: IdentificationRequest, on_progress: OnProgress) -> IdentificationAnswer:
    """Identify, and validate on the held-out bags (on all bags if there are none)."""
    from saddlering_ros.api.functions import identify, validate
    from saddlering_ros.api.inputs import inputs_of, runs_of
    from saddlering_ros.doubts.comparison import refuse_repeats

    rig = request.rig
    given = inputs_of(request.bags, hold_out=request.validation_bags, rig=rig,
                      on_progress=on_progress)  # its faults come before minutes of work
    refuse_repeats(runs_of(given.bags), runs_of(given.held_out))
    result = identify(given.bags, rig=rig, settings=request.settings, on_progress=on_progress)
    judged = validate(given.held_out or given.bags, parameters=result, rig=rig,
                      on_progress=on_progress)
    found = result.found
    return IdentificationAnswer(found.parameters, found.objective, found.status,
                                json.dumps(judged.found.to_json()['runs']),
                                json.dumps(found.to_json()))


def _diagnosed(request: DiagnosisRequest, on_progress: OnProgress) -> DiagnosisAnswer:
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
