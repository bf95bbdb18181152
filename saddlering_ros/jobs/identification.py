"""One identification as a job of a worker process: plain data in, plain data out, no ROS in it."""

from __future__ import annotations

from dataclasses import dataclass
import json

from saddlering_ros.identification import IdentificationSettings, SwarmSettings
from saddlering_ros.jobs.plain_types import PARAMETER_TYPES, PROGRESS_TYPES, RIG_TYPES
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


TYPES = (*PARAMETER_TYPES, *RIG_TYPES, *PROGRESS_TYPES, IdentificationRequest,
         IdentificationAnswer, IdentificationSettings, SwarmSettings)
"""Types that pass between the node and its worker."""


PRELOADED = ('saddlering_ros.api.functions',)
"""What the worker imports before the first job; the node has no need of it."""


def run(request: IdentificationRequest, on_progress: OnProgress) -> IdentificationAnswer:
    """Identify, and validate on the held-out bags (on all bags if there are none)."""
    from saddlering_ros.api.functions import identify_with, validate
    from saddlering_ros.api.inputs import as_bags, check_rig, runs_of
    from saddlering_ros.bags import refuse_repeats

    rig = request.rig
    bags = as_bags(request.bags, rig, on_progress)
    held_out = as_bags(request.validation_bags, rig, on_progress)
    refuse_repeats(runs_of(bags), runs_of(held_out))
    check_rig(held_out, rig, rig, trust_rig=False)  # before the minutes of an identification
    result = identify_with(request.settings, bags, rig=rig, on_progress=on_progress)
    judged = validate(held_out or bags, parameters=result, rig=rig, on_progress=on_progress)
    found = result.found
    return IdentificationAnswer(found.parameters, found.objective, found.status,
                                json.dumps(judged.found.to_json()['runs']),
                                json.dumps(found.to_json()))
