"""Commands of the page to the nodes, and the goals of both actions as a bystander sees them."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from functools import partial
import json
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
RUNNING = (GoalStatus.STATUS_ACCEPTED, GoalStatus.STATUS_EXECUTING, GoalStatus.STATUS_CANCELING)


class Commands:
    """Clients of the services, and the last answer of each."""

    def __init__(self, node: Node) -> None:
        self._clients = {name: node.create_client(Trigger, path)
                         for name, path in SERVICES.items()}
        self._answers: dict[str, str] = {}

    def ask(self, name: str) -> bool:
        """Call a service without waiting for it; whether it has a server."""
        client = self._clients[name]
        if not client.service_is_ready():
            self._answers[name] = 'no node offers it now'
            return False
        self._answers[name] = 'asked'
        client.call_async(Trigger.Request()).add_done_callback(
            lambda future: self._note(name, future))
        return True

    def as_page(self) -> dict[str, dict[str, Any]]:
        """By command: whether a node offers it, and its last answer."""
        return {name: {'ready': bool(client.service_is_ready()),
                       'words': self._answers.get(name, '')}
                for name, client in self._clients.items()}

    def _note(self, name: str, future: Any) -> None:
        answer = future.result()
        self._answers[name] = str(answer.message) or ('done' if answer.success else 'refused')


@dataclass
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


Change = Callable[[Job | None], Job | None]
"""The next state of a goal, from the last one."""


class Action:
    """One action as a bystander sees it: goals, feedback, results, and the way to cancel."""

    def __init__(self, node: Node, name: str, change: Callable[[str, Change], None]) -> None:
        self._node, self._name, self._change = node, name, partial(change, name)
        path, kind = ACTIONS[name]
        self._path, self._kind = path, kind
        node.create_subscription(GoalStatusArray, f'{path}/_action/status', self._on_status,
                                 qos_profile_action_status_default)
        node.create_subscription(kind.Impl.FeedbackMessage, f'{path}/_action/feedback',
                                 self._on_feedback, 10)
        self._cancel = node.create_client(kind.Impl.CancelGoalService,
                                          f'{path}/_action/cancel_goal')
        self._result = node.create_client(kind.Impl.GetResultService, f'{path}/_action/get_result')
        self._asked = ''

    def cancel(self) -> bool:
        """Cancel all goals (the zero id means all)."""
        if not self._cancel.service_is_ready():
            return False
        self._cancel.call_async(self._kind.Impl.CancelGoalService.Request())
        self._change(lambda job: replace(job, stage='canceling') if job is not None else None)
        return True

    def look_after(self) -> None:
        """Notice that the server is gone."""
        if self._node.count_publishers(f'{self._path}/_action/status'):
            return
        self._change(lambda job: replace(job, state='lost', words='its server is gone')
                     if job is not None and job.state == 'running' else None)

    def _on_status(self, message: GoalStatusArray) -> None:
        for status in message.status_list:
            if status.status in RUNNING:
                self._notice(bytes(status.goal_info.goal_id.uuid).hex())

    def _notice(self, goal: str) -> None:
        """A goal is running: show it, and request its result."""
        self._change(lambda job: job if job is not None and job.goal == goal else Job(goal))
        if self._asked == goal or not self._result.service_is_ready():
            return
        self._asked = goal
        request = self._kind.Impl.GetResultService.Request()
        request.goal_id.uuid = np.frombuffer(bytes.fromhex(goal), np.uint8)
        self._result.call_async(request).add_done_callback(
            lambda future: self._on_result(goal, future.result()))

    def _on_feedback(self, message: Any) -> None:
        goal = bytes(message.goal_id.uuid).hex()
        self._notice(goal)
        said = message.feedback
        if self._name == 'identify':
            share = said.iteration / max(said.iterations, 1)
            words = f'{said.iteration} of {said.iterations}, best {said.best_objective:.4g}'
        else:
            share, words = said.progress, ''
        left = said.elapsed * (1.0 - share) / share if share > 0.05 else None
        self._change(lambda job: job if job is None or job.state != 'running' else replace(
            job, stage=said.stage, share=float(share), words=words, elapsed=float(said.elapsed),
            left=left))

    def _on_result(self, goal: str, response: Any) -> None:
        state = {GoalStatus.STATUS_SUCCEEDED: 'done', GoalStatus.STATUS_CANCELED: 'canceled'}.get(
            response.status, 'failed')
        result = response.result
        ended = Job(goal, state, stage='', share=1.0, words=str(result.message))
        if state == 'done':
            ended = (with_diagnosis(ended, json.loads(result.verdict_json))
                     if self._name == 'diagnose' else
                     with_identification(ended, json.loads(result.report_json)))
        self._change(lambda job: ended if job is None or job.goal == goal else None)


def with_diagnosis(job: Job, document: VerdictDocument) -> Job:
    """The goal with the words of its verdict: headline, next test and misfit reduction."""
    # The words need the catalogue; the page is served before it is loaded.
    from saddlering_ros.diagnosis.ring_wording import gain_sentence, headline
    from saddlering_ros.quantities import VERDICT_WORDS

    verdict, following = document['verdict'], document.get('next_test')
    lines = (f'Next test: {following}' if following else '', gain_sentence(document))
    return replace(job, verdict=verdict, title=f'Verdict: {verdict} – {VERDICT_WORDS[verdict]}',
                   words=headline(document), lines=list(filter(None, lines)))


def with_identification(job: Job, report: Mapping[str, Any]) -> Job:
    """The goal with a line for each parameter."""
    from saddlering_ros.identification.result import parameter_words

    return replace(job, lines=[
        parameter_words(name, item) for name, item in report['parameters'].items()])
