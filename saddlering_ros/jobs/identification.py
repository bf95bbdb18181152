"""One identification as a job of a worker process: plain data in, plain data out, no ROS in it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
import json
from typing import Any

from saddlering_ros.bags import read_run, refuse_other_rig, refuse_repeats
from saddlering_ros.identification import (
    IdentificationSettings,
    identify,
    Progress,
    SwarmSettings,
    validate,
)
from saddlering_ros.jobs.plain_types import PARAMETER_TYPES, RIG_TYPES
from saddlering_ros.rig import ParameterSet, Rig


@dataclass(frozen=True)
class IdentificationRequest:
    """What to identify: bags by path, those held out, the rig, and the settings."""

    bags: tuple[str, ...]
    validation_bags: tuple[str, ...]
    rig: Rig
    settings: IdentificationSettings


@dataclass(frozen=True)
class IdentificationAnswer:
    """What was found; validation and report as JSON texts."""

    parameters: ParameterSet
    objective: float
    words: str
    validation_json: str
    report_json: str


TYPES = (*PARAMETER_TYPES, *RIG_TYPES, IdentificationRequest, IdentificationAnswer,
         IdentificationSettings, SwarmSettings, Progress)
"""What may go between the node and its worker."""


def run(request: IdentificationRequest, on_progress: Callable[[Progress], None],
        ) -> IdentificationAnswer:
    """Identify, and judge the result on the bags held out (on all bags if there are none)."""
    runs = [read_run(bag, rig=request.rig) for bag in request.bags]
    held_out = [read_run(bag, rig=request.rig) for bag in request.validation_bags]
    refuse_repeats(runs, held_out)
    refuse_other_rig([*runs, *held_out], request.rig, is_given=True)
    found = identify(runs, request.rig, request.settings, on_progress=on_progress)
    judged: Any = validate(held_out or runs, request.rig, found.parameters).to_json()
    return IdentificationAnswer(found.parameters, found.objective, found.status,
                                json.dumps(judged['runs']), json.dumps(found.to_json()))
