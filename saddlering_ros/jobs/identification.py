"""One identification as a job of a worker process: plain data in, plain data out, no ROS in it."""

from __future__ import annotations

from dataclasses import dataclass
import json

from saddlering_ros.identification import IdentificationSettings
from saddlering_ros.progress import OnProgress
from saddlering_ros.rig import ParameterSet, Rig


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


PRELOADED = ('saddlering_ros.api.functions',)
"""What the worker imports before the first job; the node has no need of it."""


def run(request: IdentificationRequest, on_progress: OnProgress) -> IdentificationAnswer:
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
