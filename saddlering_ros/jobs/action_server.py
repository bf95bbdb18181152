"""The common part of both action servers: one goal at a time, worked on in a process."""

from collections import deque
from collections.abc import Callable, Sequence
from dataclasses import replace
import threading
import time
from typing import Any, ClassVar

from diagnostic_msgs.msg import DiagnosticArray
from rclpy.action import ActionServer, CancelResponse, GoalResponse
from rclpy.action.server import ServerGoalHandle
from rclpy.clock import Clock, ClockType
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rclpy.task import Future

from saddlering_interfaces.msg import RingParameters
from saddlering_ros.errors import Cancelled, SaddleringError
from saddlering_ros.files import share_directory
from saddlering_ros.jobs import requests
from saddlering_ros.jobs.requests import Answer
from saddlering_ros.jobs.worker import CANCELED, DONE, FAILED, Outcome, REFUSED, Worker
from saddlering_ros.progress import Progress
from saddlering_ros.rig import Rig
from saddlering_ros.ros import names, parameters
from saddlering_ros.ros.diagnostics import ERROR, Namesakes, OK, TaskStatus, to_message, WARN
from saddlering_ros.ros.messages import parameters_to_message, to_time
from saddlering_ros.ros.names import NodeError
from saddlering_ros.ros.raw_topics import LATCHED, MANY_REQUESTS
from saddlering_ros.ros.rig_state import RigAgreement
from saddlering_ros.ros.streaming_node import run

MAX_BAGS = 100
"""Bags of one goal."""

ANSWER_PERIOD = 0.05
"""Goals and cancels are answered this far apart [s], if more than a few come at once."""

ANSWERS_AT_ONCE = 5  # half of the queue of a client

FAREWELL = 1.0
"""Time [s] that a server stays after its end was requested, so that the result of its last goal is
sent: callbacks of the executor send it, and send lost packets again."""


class PacedActionServer(ActionServer):
    """An action server that lets a moment pass before it answers a cancel, as before goals.

    rclpy asks no callback about a cancel of a goal that has ended: of 500 cancels of one goal, the
    answers to all but the first came at once, and most were lost in the client's queue.
    """

    def __init__(self, *args: Any, pace: Callable[[], None], **options: Any) -> None:
        self._pace = pace
        super().__init__(*args, **options)

    async def _execute_cancel_request(self, request_header_and_message: Any) -> None:
        self._pace()
        await super()._execute_cancel_request(request_header_and_message)


class ActionNode(Node):
    """An action server whose work is done by a worker process.

    One goal at a time: a goal that comes while another runs is rejected (the client cancels
    the first, or waits). A goal that cannot be used is accepted and aborted at once with
    status REFUSED and the reason, since a rejection can carry none. Every accepted
    goal ends: succeeded, canceled, or aborted with status REFUSED or FAILED.
    """

    NODE: ClassVar[str]
    ACTION: ClassVar[Any]
    NAME: ClassVar[str]

    PARAMETERS: ClassVar[tuple[parameters.NodeParameter, ...]] = (
        parameters.NodeParameter(
            'bag_root', '', 'folder below which every bag of a goal must lie (links are '
            'resolved first); none: the shipped bags'),
        parameters.NodeParameter(
            'parameters_root', '', 'folder below which every parameter file of a goal must '
            'lie; none: bag_root'),
        parameters.NodeParameter(
            'longest_goal', 86400.0, 'a goal that takes longer than this [s] is aborted', low=1.0,
            high=1e7),
        parameters.HARDWARE_ID)

    def __init__(self) -> None:
        super().__init__(self.NODE)
        self.settings = parameters.declare(self, self.PARAMETERS)
        self.rig: Rig = parameters.declare_rig(self)
        self._agreement = RigAgreement(self, self.rig)
        self.bag_root = parameters.root_folder(self, 'bag_root', share_directory() / 'bags')
        self.parameters_root = parameters.root_folder(self, 'parameters_root', self.bag_root)
        self.done = False
        self._answered: deque[float] = deque()
        self.busy = threading.Lock()
        self._stage, self._last = 'idle', 'no goal yet'
        self._level = OK
        self._worker = Worker('saddlering_ros.jobs.requests')
        self._done = self.create_guard_condition(lambda: None)
        self._found = self.create_publisher(RingParameters, names.PARAMETERS_IN_FORCE, LATCHED)
        self._diagnostics = self.create_publisher(DiagnosticArray, names.DIAGNOSTICS, 10)
        self._namesakes = Namesakes(self)
        self.create_timer(1.0, self._diagnose, clock=Clock(clock_type=ClockType.STEADY_TIME))
        self._server = PacedActionServer(
            self, self.ACTION, self.NAME, pace=self._pace, execute_callback=self._execute,
            goal_callback=self._on_goal, cancel_callback=lambda _: CancelResponse.ACCEPT,
            goal_service_qos_profile=MANY_REQUESTS, cancel_service_qos_profile=MANY_REQUESTS,
            result_service_qos_profile=MANY_REQUESTS)
        self.get_logger().info(
            f'serves {self.resolve_service_name(self.NAME)}; bags from {self.bag_root}')

    def request(self, goal: Any) -> Any:
        """Input of the job of a goal with bags; SaddleringError for one that cannot be used."""
        raise NotImplementedError

    def feedback(self, progress: Progress, elapsed: float) -> Any:
        raise NotImplementedError

    def fill(self, result: Any, answer: Answer) -> None:
        for name, value in answer.fields.items():
            setattr(result, name, value)

    def bags(self, named: Sequence[str]) -> tuple[str, ...]:
        """The bags of a goal as paths below bag_root, with every file they consist of."""
        if len(named) > MAX_BAGS:
            raise NodeError(f'the goal names {len(named)} bags: give at most {MAX_BAGS}')
        return tuple(str(parameters.bag_below(self.bag_root, name)) for name in named)

    def _pace(self) -> None:
        """Let a moment pass between answers: a client's queue of them holds ten by default."""
        now = time.monotonic()
        self._answered.append(now)
        if len(self._answered) > ANSWERS_AT_ONCE:
            due = self._answered.popleft() + ANSWERS_AT_ONCE * ANSWER_PERIOD
            time.sleep(max(0.0, due - now))

    def _on_goal(self, goal: Any) -> GoalResponse:
        self._pace()
        if self.busy.locked() or self.done:
            self.get_logger().warning(
                f'goal rejected: another goal is running ({self._stage}); cancel that goal or '
                'wait')
            return GoalResponse.REJECT
        self.busy.acquire()
        return GoalResponse.ACCEPT

    async def _execute(self, goal_handle: ServerGoalHandle) -> Any:
        result = self.ACTION.Result()
        future: Future = Future()
        self._stage = 'starting'
        threading.Thread(target=self._work, args=(goal_handle, future), daemon=True).start()
        try:
            self._end(goal_handle, await future, result)
        except Exception as problem:
            self.get_logger().error(f'failed: {problem}')
            result.status, result.message = result.FAILED, str(problem)
            goal_handle.abort()
        finally:
            self._stage = 'idle'
            self.busy.release()
        return result

    def _work(self, goal_handle: ServerGoalHandle, future: Future) -> None:
        """In a thread: drive the worker process, pass its progress on, watch for a cancel."""
        started = time.monotonic()

        def on_progress(progress: Progress) -> None:
            message = self.feedback(progress, time.monotonic() - started)
            self._stage = message.stage
            goal_handle.publish_feedback(message)

        def reason_to_stop() -> str:
            if self.done:
                return 'the server is shutting down'
            if time.monotonic() - started > self.settings['longest_goal']:
                return f'took longer than longest_goal, {self.settings["longest_goal"]:g} s'
            return 'canceled' if goal_handle.is_cancel_requested else ''

        try:
            if not goal_handle.request.bags:
                raise NodeError('the goal names no bags: give at least one')
            outcome = self._worker.run(
                self.request(goal_handle.request), on_progress, lambda: bool(reason_to_stop()),
                lambda progress: 0.0 if self.done else requests.patience(progress))
        except Cancelled as stopped:
            outcome = CANCELED, reason_to_stop()
            if isinstance(law := stopped.partial, Answer):
                words = law.words.removeprefix('cancelled: ')
                outcome = CANCELED, replace(law, words=f'{outcome[1]}; {words}')
        except SaddleringError as problem:
            outcome = REFUSED, str(problem)
        except Exception as problem:
            outcome = FAILED, f'{type(problem).__name__}: {problem}'
        future.set_result(outcome)
        self._done.trigger()
        if not self.done:
            self._worker.start()

    def _end(self, goal_handle: ServerGoalHandle, outcome: Outcome, result: Any) -> None:
        self._level, (kind, answer) = OK, outcome
        result.message = answer.words if isinstance(answer, Answer) else answer
        if isinstance(answer, Answer):
            self.fill(result, answer)
            if (law := answer.parameters) is not None:
                # The newest offer counts, and the clock of a replay begins again with its bag.
                result.parameters = parameters_to_message(law, to_time(time.time_ns()))
                if answer.offered:
                    self._found.publish(result.parameters)
                elif kind == DONE:
                    self.get_logger().warning(
                        'the parameters are not offered to simulators, because the data do not '
                        f'determine {", ".join(law.source.undetermined)}')
        if kind == DONE:
            result.status = result.SUCCEEDED
            goal_handle.succeed()
        elif kind == CANCELED and goal_handle.is_cancel_requested:
            result.status = result.CANCELED
            goal_handle.canceled()
        else:
            result.status = result.REFUSED if kind == REFUSED else result.FAILED
            self._level = OK if kind == REFUSED else ERROR
            goal_handle.abort()
        self._last = f'{kind}: {result.message}'
        self.get_logger().info(f'goal {self._last}')

    def _diagnose(self) -> None:
        twice, figures = self._namesakes.words(), {'last goal': self._last}
        status = TaskStatus(WARN if twice else self._level, twice or self._stage, figures)
        self._diagnostics.publish(to_message(self, [
            (f'/{self.NAME}', status), ('rig', self._agreement.report(1.0))]))

    def destroy_node(self) -> None:
        self._worker.close()
        self._server.destroy()
        super().destroy_node()


def serve(make: Any, args: Sequence[str] | None = None) -> int:
    """Run an action server until SIGINT or SIGTERM; a goal that runs then is aborted first."""
    def spin(node: ActionNode) -> None:
        executor = SingleThreadedExecutor()
        executor.add_node(node)
        while not node.done and node.context.ok():
            executor.spin_once(timeout_sec=0.1)
        if node.busy.locked():
            for wanted, seconds in ((node.busy.locked, 1.0), (lambda: True, FAREWELL)):
                deadline = time.monotonic() + seconds
                while wanted() and time.monotonic() < deadline:
                    executor.spin_once(timeout_sec=0.02)
        executor.shutdown(timeout_sec=0.0)

    return run(make, spin, args)
