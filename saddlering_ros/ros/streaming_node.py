"""The common part of all streaming nodes: lifecycle, parameters, diagnostics, progress."""

from __future__ import annotations

import time
from typing import Any, ClassVar

from diagnostic_msgs.msg import DiagnosticArray
from rclpy.lifecycle import LifecycleNode, LifecycleState, TransitionCallbackReturn

from saddlering_interfaces.msg import ReplayProgress
from saddlering_ros.errors import SaddleringError
from saddlering_ros.ros.diagnostics import (
    ACTIVE,
    ERROR,
    Finding,
    OK,
    STATE_TASK,
    Task,
    to_message,
)
from saddlering_ros.ros.lockstep import progress_of
from saddlering_ros.ros.names import diagnostic_name, DIAGNOSTICS, PROGRESS, rig_name
from saddlering_ros.ros.parameters import declare, HARDWARE_ID, NodeParameter
from saddlering_ros.ros.qos import PROGRESS_QOS
from saddlering_ros.ros.raw_topics import RawPublisher, RawSubscription, RELIABILITIES

HEARTBEAT = 0.2
"""An idle node repeats its progress, and looks at its publishers, this often [s]."""

PROGRESS_PERIOD = 0.001
DIAGNOSTICS_PERIOD = 1.0
FIRST_DIAGNOSIS = 0.4
"""Time [s] within which a started node reports its missing inputs."""

AUTOSTART = NodeParameter(
    'autostart', True, 'configure and activate at the start; false: wait for '
    '`ros2 lifecycle set`')
INPUT_RELIABILITY = NodeParameter(
    'input_reliability', 'auto', 'requested QoS; auto: reliable if all publishers are reliable, '
                                 'else best effort', choices=RELIABILITIES)
MAX_GAP = NodeParameter(
    'max_gap', 10.0, 'a larger jump of the stamps [s] restarts zero and simulation', low=0.1,
    high=3600.0)


class StreamingNode(LifecycleNode):
    """A node that works streams off in batches; `spin_streaming` runs it.

    A subclass gives PARAMETERS, `configure` (make the core; raise SaddleringError for what cannot
    be used), `connect` (make the flows), `process_batch` (one batch) and its diagnostics tasks.
    """

    PARAMETERS: ClassVar[tuple[NodeParameter, ...]] = ()
    TELLS_PROGRESS: ClassVar[bool] = True

    def __init__(self, name: str, **options: Any) -> None:
        super().__init__(name, **options)
        self.settings = declare(self, (AUTOSTART, HARDWARE_ID, *self.PARAMETERS))
        self.tasks: list[Task] = []
        self.problem: SaddleringError | None = None
        self.inputs: list[RawSubscription] = []
        self.outputs: list[RawPublisher] = []
        self.active = False
        self.done = False
        self._diagnostics = self.create_publisher(DiagnosticArray, DIAGNOSTICS, 10)
        self._progress = self.create_publisher(ReplayProgress, PROGRESS, PROGRESS_QOS)
        self._told = self._beat = 0.0
        self._untold = False
        self._diagnosed = time.monotonic()
        self._next_diagnosis = self._diagnosed + FIRST_DIAGNOSIS

    # --- for subclasses ---

    def startable(self) -> bool:
        """Whether the settings are enough to start by itself; logs the reason if not."""
        return True

    def configure(self) -> None:
        """Read the settings and make the core."""

    def connect(self) -> None:
        """Fill `inputs` and `outputs`."""

    def process_batch(self) -> None:
        """Take the messages of the subscriptions, process them, and send the results."""

    def idle(self) -> None:
        """Called after a time without data."""

    def at_intervals(self, now: float) -> float:
        """Do the work due by the wall clock; returns the time to the next call [s]."""
        return 1.0

    def replayed_until(self) -> int:
        """For nodes that replay a bag: the time [ns] up to which everything is published."""
        return 0

    def lockstep_inputs(self) -> list[RawSubscription]:
        """The subscriptions a replay in lockstep waits for."""
        return self.inputs

    # --- lifecycle ---

    def start(self) -> None:
        """Configure and activate, if `autostart` is set; raises the error that prevents it."""
        if not self.settings['autostart'] or not self.startable():
            return
        self.trigger_configure()
        if self.problem is not None:
            raise self.problem
        self.trigger_activate()
        if self.problem is not None:
            raise self.problem

    def on_configure(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Make the core from the parameters."""
        return self._attempt(self.configure, state, super().on_configure)

    def on_activate(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Subscribe and publish."""
        result = self._attempt(self.connect, state, super().on_activate)
        self.active = result == TransitionCallbackReturn.SUCCESS
        return result

    def on_deactivate(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Stop subscribing and publishing; the core keeps its state."""
        self._disconnect()
        return super().on_deactivate(state)

    def on_cleanup(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Forget the core."""
        self.tasks = []
        return super().on_cleanup(state)

    def on_shutdown(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Leave the process as well."""
        self._disconnect()
        self.done = True
        return super().on_shutdown(state)

    def _attempt(self, step: Any, state: LifecycleState, upwards: Any) -> TransitionCallbackReturn:
        self.problem = None
        try:
            step()
        except SaddleringError as problem:
            self.problem = problem
            self.get_logger().error(str(problem))
            self._disconnect()
            return TransitionCallbackReturn.FAILURE
        result: TransitionCallbackReturn = upwards(state)
        return result

    def sources(self) -> dict[str, int]:
        """How many publishers each input topic has."""
        return {flow.topic: flow.publishers() for flow in self.inputs}

    def _disconnect(self) -> None:
        self.active = False
        for subscription in self.inputs:
            subscription.close()
        for publisher in self.outputs:
            publisher.close()
        self.inputs, self.outputs = [], []

    # --- the loop ---

    def raw_subscriptions(self) -> list[RawSubscription]:
        """The subscriptions to wait for."""
        return self.inputs

    def awaited(self) -> list[RawSubscription]:
        """Those of them without whose next message a batch would give no result."""
        return self.inputs

    def finished(self) -> bool:
        """Whether the node wants to leave."""
        return self.done

    def work(self) -> None:
        """Process the messages that have arrived."""
        if self.active:
            self.process_batch()
            self._untold = self.TELLS_PROGRESS
            self._tell(time.monotonic(), PROGRESS_PERIOD)

    def tick(self, now: float) -> float:
        """Progress, diagnostics and work of the subclass by the wall clock."""
        if self._untold:
            self._tell(now, PROGRESS_PERIOD)
        if now - self._beat >= HEARTBEAT:
            self._beat = now
            if self.active:
                for flow in self.inputs:
                    flow.review()
            self._tell(now, 0.0)
        if now >= self._next_diagnosis:
            self._next_diagnosis = now + DIAGNOSTICS_PERIOD
            self._diagnose(now)
        wait = self.at_intervals(now) if self.active else 1.0
        return min(wait, PROGRESS_PERIOD) if self._untold else wait

    def _tell(self, now: float, period: float) -> None:
        if not self.active or not self.TELLS_PROGRESS or now - self._told < period:
            return
        self._told, self._untold = now, False
        if self._progress.get_subscription_count():
            self._progress.publish(progress_of(
                self.get_name(), self.lockstep_inputs(), self.outputs, self.replayed_until()))

    def _diagnose(self, now: float) -> None:
        elapsed, self._diagnosed = now - self._diagnosed, now
        message = to_message(
            diagnostic_name(self),
            [(STATE_TASK, self._state_finding()),
             *((task.name, task.report(elapsed)) for task in self.tasks)],
            rig_name(self, self.settings.text('hardware_id')))
        message.header.stamp = self.get_clock().now().to_msg()
        self._diagnostics.publish(message)

    def _state_finding(self) -> Finding:
        if self.active:
            return Finding(OK, ACTIVE)
        if self.problem is not None:
            return Finding(ERROR, f'not active: {self.problem}')
        return Finding(OK, 'not active: ros2 lifecycle set '
                       f'{self.get_fully_qualified_name()} configure, then activate')
