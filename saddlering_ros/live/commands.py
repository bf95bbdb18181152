"""Commands of the page to the nodes, and the goals of both actions as a bystander sees them."""

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
import json
from threading import Lock
from typing import Any, TYPE_CHECKING

from action_msgs.msg import GoalStatus, GoalStatusArray
import numpy as np
from rclpy.node import Node
from rclpy.qos import qos_profile_action_status_default
from std_srvs.srv import Trigger

from saddlering_interfaces.action import DiagnoseRing, IdentifyRing
from saddlering_ros.ros.names import DIAGNOSE, IDENTIFY

if TYPE_CHECKING:
    from saddlering_ros.diagnosis.ring_wording import VerdictDocument

SERVICES = {'zero': 'ring_displacement/zero', 'start': 'replay_clock/play',
            'pause': 'replay_clock/pause'}
"""Relative names: in the namespace of the page's node."""

ACTIONS = {'identify': (IDENTIFY, IdentifyRing), 'diagnose': (DIAGNOSE, DiagnoseRing)}
ENDED = {GoalStatus.STATUS_SUCCEEDED: 'done', GoalStatus.STATUS_CANCELED: 'canceled'}
RUNNING = (GoalStatus.STATUS_ACCEPTED, GoalStatus.STATUS_EXECUTING, GoalStatus.STATUS_CANCELING)


class Commands:
    """Clients of the services, and the last answer of each."""

    def __init__(self, node: Node) -> None:
        self._clients = {name: node.create_client(Trigger, path)
                         for name, path in SERVICES.items()}
        self._answers: dict[str, str] = {}

    def ask(self, name: str) -> bool:
        """Call a service without waiting for it; whether it has a server."""
        def note(future: Any) -> None:
            answer = future.result()
            self._answers[name] = str(answer.message) or ('done' if answer.success else 'refused')

        client = self._clients[name]
        if not client.service_is_ready():
            self._answers[name] = 'no node offers it now'
            return False
        self._answers[name] = 'asked'
        client.call_async(Trigger.Request()).add_done_callback(note)
        return True

    def as_page(self) -> dict[str, dict[str, Any]]:
        """By command: whether a node offers it, and its last answer."""
        return {name: {'ready': bool(client.service_is_ready()),
                       'words': self._answers.get(name, '')}
                for name, client in self._clients.items()}


@dataclass(frozen=True)
class Job:
    """One goal of an action as the page shows it; share 0 to 1; elapsed and left [s]."""

    goal: str
    state: str = 'running'
    stage: str = 'starting'
    share: float = 0.0
    elapsed: float = 0.0
    left: float | None = None
    words: str = ''
    lines: list[str] = field(default_factory=list)
    verdict: str = ''
    title: str = ''


class Action:
    """One action as a bystander sees it: its last goal `job`, set under `lock`; it can cancel."""

    def __init__(self, node: Node, name: str, lock: Lock) -> None:
        path, self._kind = ACTIONS[name]
        self.job: Job | None = None
        self._node, self._name, self._lock, self._asked = node, name, lock, ''
        self._status = f'{path}/_action/status'
        node.create_subscription(GoalStatusArray, self._status, self._on_status,
                                 qos_profile_action_status_default)
        node.create_subscription(self._kind.Impl.FeedbackMessage, f'{path}/_action/feedback',
                                 self._on_feedback, 10)
        self._cancel = node.create_client(self._kind.Impl.CancelGoalService,
                                          f'{path}/_action/cancel_goal')
        self._result = node.create_client(self._kind.Impl.GetResultService,
                                          f'{path}/_action/get_result')

    def cancel(self) -> bool:
        """Cancel all goals (the zero id means all)."""
        if not self._cancel.service_is_ready():
            return False
        self._cancel.call_async(self._kind.Impl.CancelGoalService.Request())
        with self._lock:
            self.job = self.job and replace(self.job, stage='canceling')
        return True

    def look_after(self) -> None:
        """Notice that the server is gone."""
        is_there = self._node.count_publishers(self._status)
        with self._lock:
            if not is_there and self.job is not None and self.job.state == 'running':
                self.job = replace(self.job, state='lost', words='its server is gone')

    def _on_status(self, message: GoalStatusArray) -> None:
        for goal in [one for one in message.status_list if one.status in RUNNING]:
            self._notice(bytes(goal.goal_info.goal_id.uuid))

    def _notice(self, goal: bytes) -> None:
        """A goal is running: show it, and request its result."""
        with self._lock:
            if self.job is None or self.job.goal != goal.hex():
                self.job = Job(goal.hex())
        if self._asked == goal.hex() or not self._result.service_is_ready():
            return
        self._asked = goal.hex()
        request = self._kind.Impl.GetResultService.Request()
        request.goal_id.uuid = np.frombuffer(goal, np.uint8)
        self._result.call_async(request).add_done_callback(
            lambda future: self._on_result(goal.hex(), future.result()))

    def _on_feedback(self, message: Any) -> None:
        self._notice(bytes(message.goal_id.uuid))
        said = message.feedback
        share, words = said.progress, ''
        if self._name == 'identify':
            words = f'{said.iteration} of {said.iterations}, best {said.best_objective:.4g}'
        left = said.elapsed * (1.0 - share) / share if share > 0.05 else None
        with self._lock:
            if self.job is not None and self.job.state == 'running':
                self.job = replace(self.job, stage=said.stage, share=float(share), words=words,
                                   elapsed=float(said.elapsed), left=left)

    def _on_result(self, goal: str, response: Any) -> None:
        result, state = response.result, ENDED.get(response.status, 'failed')
        ended = Job(goal, state, stage='', share=1.0, words=str(result.message))
        if state == 'done':
            ended = (with_diagnosis(ended, json.loads(result.verdict_json))
                     if self._name == 'diagnose' else
                     with_identification(ended, json.loads(result.report_json)))
        with self._lock:
            if self.job is None or self.job.goal == goal:
                self.job = ended


def with_diagnosis(job: Job, document: 'VerdictDocument') -> Job:
    """The goal with its verdict: headline, next test, misfit reduction and certainty."""
    # The words need the catalogue; the page is served before it is loaded.
    from saddlering_ros.diagnosis import ring_wording
    from saddlering_ros.discrepancy import wording
    from saddlering_ros.quantities import verdict_line

    verdict, following = document['verdict'], document.get('next_test')
    lines = (f'Next test: {following}' if following else '',
             ring_wording.partial_words(document), ring_wording.gain_sentence(document),
             *wording.certainty_lines(document, ring_wording.lowered_titles))
    return replace(job, verdict=verdict, title=verdict_line(verdict).capitalize(),
                   words=ring_wording.headline(document), lines=list(filter(None, lines)))


def with_identification(job: Job, report: Mapping[str, Any]) -> Job:
    """The goal with a line for each parameter."""
    from saddlering_ros.identification.result import parameter_words

    return replace(job, lines=[
        parameter_words(name, figures) for name, figures in report['parameters'].items()])
