"""Whether a rig is ready to test, by the reports of its nodes on /diagnostics."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
import time

from diagnostic_msgs.msg import DiagnosticArray
from rclpy.node import Node

from saddlering_ros.ros.diagnostics import ACTIVE, Finding, OK, STATE_TASK, WARN
from saddlering_ros.ros.names import DIAGNOSTICS

SILENT = 3.0
"""A node that has not reported for so long [s] is not there."""

EVENTS_COUNT = 10.0
"""A sample refused, lost or late keeps a rig from being ready for so long [s]."""

EVENTS_TASK = 'events'
SHOWN = 3
"""Reasons in the words of the status; the figures hold all."""


@dataclass(frozen=True)
class _Status:
    level: int
    words: str
    at: float
    is_active: bool


class Readiness:
    """Receives the statuses of nodes; names the reasons that prevent a test.

    needed: names of nodes as /diagnostics shows them. Ready means that each of them reports, is
    active, and reports nothing but OK: every stream comes at its rate, the zero is taken, the rig
    files agree, and no sample was refused or lost for EVENTS_COUNT.
    """

    def __init__(self, needed: Sequence[str]) -> None:
        self._needed = tuple(needed)
        self._heard: dict[str, dict[str, _Status]] = {name: {} for name in needed}
        self._events: dict[str, tuple[float, str]] = {}

    def hear(self, name: str, level: int, words: str, now: float) -> None:
        """Take the status 'NODE: TASK' at `now` [s, monotonic]."""
        node, _, task = name.partition(': ')
        if node not in self._heard:
            return
        self._heard[node][task] = _Status(level, words, now, words == ACTIVE)
        if task == EVENTS_TASK and level > OK:
            self._events[node] = now, words

    def reasons(self, now: float) -> list[str]:
        """Reasons that prevent a test at `now` [s, monotonic], one line each; none: ready."""
        return [reason for node in self._needed for reason in self._reasons_of(node, now)]

    def _reasons_of(self, node: str, now: float) -> list[str]:
        current = {task: status for task, status in self._heard[node].items()
                   if now - status.at <= SILENT}
        state = current.get(STATE_TASK)
        if state is None:
            return [f'{node} does not report']
        if not state.is_active:
            return [f'{node} is {state.words}']
        reasons = [f'{node}: {task}: {status.words}' for task, status in current.items()
                   if status.level > OK and task != EVENTS_TASK]
        at, words = self._events.get(node, (-EVENTS_COUNT, ''))
        if now - at < EVENTS_COUNT:
            reasons.append(f'{node}: {words} in the last {EVENTS_COUNT:g} s')
        return reasons


class ReadinessTask:
    """The diagnostics task `ready to test` of a node, over all nodes of its namespace."""

    name = 'ready to test'

    def __init__(self, node: Node, needed: Sequence[str]) -> None:
        prefix = '' if node.get_namespace() == '/' else f'{node.get_namespace()}/'
        self._own = f'{prefix}{node.get_name()}: {self.name}'
        self._readiness = Readiness([f'{prefix}{name}' for name in needed if name])
        node.create_subscription(DiagnosticArray, DIAGNOSTICS, self._hear, 100)

    def _hear(self, message: DiagnosticArray) -> None:
        now = time.monotonic()
        for status in message.status:
            if status.name != self._own:
                self._readiness.hear(status.name, status.level[0], status.message, now)

    def report(self, elapsed: float) -> Finding:
        """Ready, or the reasons that prevent a test."""
        reasons = self._readiness.reasons(time.monotonic())
        if not reasons:
            return Finding(OK, 'ready to test')
        more = len(reasons) - SHOWN
        words = '; '.join(reasons[:SHOWN]) + (f'; and {more} more' if more > 0 else '')
        return Finding(WARN, f'not ready: {words}',
                       {f'reason {number}': reason for number, reason in enumerate(reasons, 1)})
