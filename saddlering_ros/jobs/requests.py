"""Jobs of a worker process: identification, diagnosis, comparison. Plain data in and out, no ROS.

The API is imported by the worker alone; the nodes have no need of it.
"""

from collections.abc import Mapping
from dataclasses import dataclass
import json
from typing import Any, TYPE_CHECKING

from saddlering_ros.errors import Cancelled
from saddlering_ros.progress import IsCancelled, OnProgress, Progress
from saddlering_ros.rig import PARAMETER_NAMES, ParameterSet, Rig

if TYPE_CHECKING:
    from saddlering_ros.identification.result import Identification
    from saddlering_ros.identification.settings import IdentificationSettings

PRELOADED = ('saddlering_ros.api.functions',)
"""What the worker imports before the first job."""

HAND_OVER = 5.0
"""Time [s] that a cancel leaves an identification whose law is complete to hand it over."""


def patience(progress: Progress) -> float:
    """Time [s] that a cancel after this progress leaves for the answer that is complete."""
    return HAND_OVER if progress.task == 'validate' or progress.stage == 'beside errors' else 0.0


@dataclass(frozen=True)
class Answer:
    """Result of a job in words, its parameters (None of a change), fields of the action's result.

    offered: whether the parameters are of use to a simulator.
    """

    words: str
    parameters: ParameterSet | None
    fields: Mapping[str, Any]
    offered: bool = True


@dataclass(frozen=True)
class IdentificationRequest:
    """Input of an identification: bags by path, those held out, the rig, and the settings."""

    bags: tuple[str, ...]
    validation_bags: tuple[str, ...]
    rig: Rig
    settings: 'IdentificationSettings'

    def run(self, on_progress: OnProgress, is_cancelled: IsCancelled) -> Answer:
        """Identify, and validate on the held-out bags (on all bags if there are none).

        Cancelled has an answer without validation as `partial` if there is a law.
        """
        from saddlering_ros.api.functions import identify, validate
        from saddlering_ros.api.inputs import inputs_of, runs_of
        from saddlering_ros.doubts.comparison import refuse_repeats

        given = inputs_of(self.bags, hold_out=self.validation_bags, rig=self.rig,
                          on_progress=on_progress)  # its faults come before minutes of work
        refuse_repeats(runs_of(given.bags), runs_of(given.held_out))
        result = None
        try:
            result = identify(given.bags, rig=self.rig, settings=self.settings,
                              on_progress=on_progress, is_cancelled=is_cancelled)
            judged = validate(given.held_out or given.bags, parameters=result, rig=self.rig,
                              on_progress=on_progress, is_cancelled=is_cancelled)
        except Cancelled as stopped:
            law: Any = result or stopped.partial
            raise Cancelled(partial=law and _answer(law.found, '', is_offered=False)) from None
        return _answer(result.found, json.dumps(judged.found.to_json()['runs']))


def _answer(fit: 'Identification', validation: str, *, is_offered: bool = True) -> Answer:
    """An identification as the result of its action; validation: as JSON."""
    unknown = [name for name in PARAMETER_NAMES if name in fit.parameters.source.undetermined]
    offered = is_offered and len(unknown) < len(PARAMETER_NAMES)
    return Answer(fit.status, fit.parameters, {
        'objective': float(fit.objective), 'undetermined': unknown, 'offered': offered,
        'validation_json': validation, 'report_json': json.dumps(fit.to_json())}, offered)


@dataclass(frozen=True)
class DiagnosisRequest:
    """Bags by path, those of an earlier session, held-out bags, the rig, a file or ''."""

    bags: tuple[str, ...]
    before: tuple[str, ...]
    hold_out: tuple[str, ...]
    rig: Rig
    parameters_file: str
    seed: int

    def run(self, on_progress: OnProgress, is_cancelled: IsCancelled) -> Answer:
        """Diagnose, or compare with the earlier session."""
        from saddlering_ros.api.functions import compare, diagnose

        if self.before:
            change = compare(self.before, self.bags, rig=self.rig, seed=self.seed,
                             on_progress=on_progress, is_cancelled=is_cancelled)
            return Answer(change.headline, None, {'verdict_json': json.dumps(change.to_json())})
        result = diagnose(
            self.bags, hold_out=self.hold_out, rig=self.rig, seed=self.seed,
            parameters=self.parameters_file or None, on_progress=on_progress,
            is_cancelled=is_cancelled)
        return Answer(result.document['headline'], result.parameters,
                      {'verdict_json': json.dumps(result.document)})


def run(request: IdentificationRequest | DiagnosisRequest, on_progress: OnProgress,
        is_cancelled: IsCancelled = lambda: False) -> Answer:
    """Do the job of a request."""
    return request.run(on_progress, is_cancelled)
