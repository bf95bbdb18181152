"""The common part of all streaming nodes: lifecycle, parameters, diagnostics, progress.

Below it: from a command line to a running node and its exit status, ended cleanly by a signal.
"""

import atexit
from collections import deque
from collections.abc import Callable, Iterator, Sequence
import contextlib
import ctypes
import gc
import math
import os
import re
import signal
import sys
import time
from typing import Any, ClassVar, NoReturn

from diagnostic_msgs.msg import DiagnosticArray
from lifecycle_msgs.srv import ChangeState
import rclpy
from rclpy._rclpy_pybind11 import RCLError
from rclpy.duration import Duration
from rclpy.executors import ExternalShutdownException
from rclpy.lifecycle import LifecycleNode, LifecycleState, TransitionCallbackReturn
from rclpy.signals import SignalHandlerOptions

from saddlering_interfaces.msg import ReplayProgress
from saddlering_ros.errors import SaddleringError, UNUSABLE
from saddlering_ros.record.guard import SampleGuard
from saddlering_ros.ros import diagnostics, launcher, parameters, raw_topics
from saddlering_ros.ros.diagnostics import FunctionTask, OK, Task, TaskStatus
from saddlering_ros.ros.messages import progress_of
from saddlering_ros.ros.names import DIAGNOSTICS, NodeError, PROGRESS, SIGNALS
from saddlering_ros.ros.parameters import NodeParameter
from saddlering_ros.ros.rig_state import RigAgreement

HEARTBEAT = 0.2
"""An idle node repeats its progress, and looks at its publishers, this often [s]."""

PROGRESS_PERIOD = 0.001  # [s]; lockstep waits for it
DIAGNOSTICS_PERIOD = 1.0  # [s], as diagnostic_updater
FIRST_DIAGNOSIS = 0.4
"""Time [s] within which a started node reports its missing inputs."""

AUTOSTART = NodeParameter('autostart', True, 'configure and activate at the start; false: wait '
                          'for `ros2 lifecycle set`')
INPUT_RELIABILITY = NodeParameter(
    'input_reliability', 'auto', 'requested QoS; auto: reliable if all publishers are reliable, '
                                 'else best effort', choices=raw_topics.RELIABILITIES)
DISPLACEMENT_FRAME = NodeParameter(
    'frame_id', 'ring', 'frame of what is published: reference point C of the ring')
MAX_GAP = NodeParameter(
    'max_gap', 10.0, 'a larger jump of the stamps [s] restarts zero and simulation', low=0.1,
    high=3600.0)

MAX_SILENCE = 3.0
"""Time [s] without a sample from which on no zero is promised."""

LONGEST_HAND_OVER = 1.5
"""Longest time [s] at its end for which a node sends again what its readers miss; with
LONGEST_END it stays below the five seconds of a launch."""


RECENT_BATCHES, MAX_PAUSE, WAITS = 10, 10.0, 2.0
"""A longer time [s] between two batches is a pause. The next batch is given WAITS times the
longest time between the recent ones: a test at 2 Hz, or a slow replay, is no silence."""


class Arrivals:
    """When batches of an input came, by a clock that no one sets [s]."""

    def __init__(self) -> None:
        self.last = -math.inf
        self._waits: deque[float] = deque(maxlen=RECENT_BATCHES)

    def note(self, now: float) -> None:
        """A batch has come."""
        if now - self.last <= MAX_PAUSE:
            self._waits.append(now - self.last)
        self.last = now

    def have_ended(self, now: float, patience: float) -> bool:
        """Whether nothing has come for `patience` [s], nor for as long as the next may take."""
        return now - self.last >= max(patience, WAITS * max(self._waits, default=0.0))


class StreamingNode(LifecycleNode):
    """A node that works streams off in batches; `spin_streaming` runs it.

    A subclass gives PARAMETERS, `configure` (make the core; raise SaddleringError for what cannot
    be used), `connect` (make the flows), `process_batch` (one batch) and its diagnostics tasks.
    """

    PARAMETERS: ClassVar[tuple[NodeParameter, ...]] = ()
    TELLS_PROGRESS: ClassVar[bool] = True
    IS_SINGLE: ClassVar[bool] = True
    """Whether a second node of its name is a mistake."""
    HAS_RIG: ClassVar[bool] = True
    """Whether it takes the parameters of a rig, and tells others the hash of its own."""

    def __init__(self, name: str, **options: Any) -> None:
        super().__init__(name, **options)
        launcher.widen_sockets()
        self.settings = parameters.declare(
            self, (AUTOSTART, parameters.HARDWARE_ID, *self.PARAMETERS))
        self.tasks: list[Task] = []
        self.problem: SaddleringError | None = None
        self.inputs: list[raw_topics.RawSubscription] = []
        self.outputs: list[raw_topics.RawPublisher] = []
        self.active = self.done = self._is_starting = False
        self._diagnostics = self.create_publisher(DiagnosticArray, DIAGNOSTICS, 10)
        self._progress = self.create_publisher(ReplayProgress, PROGRESS, raw_topics.PROGRESS_QOS)
        self._namesakes = diagnostics.Namesakes(self)
        self._silent = diagnostics.SilentStreams(self)
        self._told = self._beat = 0.0
        self._untold = False
        self._diagnosed = time.monotonic()
        self._next_diagnosis = self._diagnosed + FIRST_DIAGNOSIS
        if self.HAS_RIG:
            self._rig = parameters.declare_rig(self)
            self._agreement = RigAgreement(self, self._rig)

    # --- for subclasses ---

    def configure(self) -> None:
        """Read the settings and make the core."""

    def connect(self) -> None:
        """Fill `inputs` and `outputs`."""

    def process_batch(self) -> None:
        """Take the messages of the subscriptions, process them, and send the results."""

    def at_intervals(self, now: float) -> float:
        """Do the work due by the wall clock; returns the time to the next call [s]."""
        return 1.0

    def replayed_until(self) -> int:
        """For nodes that replay a bag: the time [ns] up to which everything is published."""
        return 0

    # --- lifecycle ---

    def start(self) -> None:
        """Configure and activate, if `autostart` is set; raises the error that prevents it."""
        if not self.settings['autostart']:
            return
        self._is_starting = True
        for step in (self.trigger_configure, self.trigger_activate):
            step()
            if self.problem is not None:
                raise self.problem
        self._is_starting = False

    def _LifecycleNodeMixin__on_change_state(
        self, request: ChangeState.Request, response: ChangeState.Response,
    ) -> ChangeState.Response:
        """Refuse a transition that the state does not have: rclpy's own would end the node."""
        try:
            return super()._LifecycleNodeMixin__on_change_state(request, response)
        except RCLError:
            self.get_logger().warning('refused a transition that this state does not have')
            response.success = False
            return response

    def on_configure(self, state: LifecycleState) -> TransitionCallbackReturn:
        return self._attempt(self.configure, state, super().on_configure)

    def on_activate(self, state: LifecycleState) -> TransitionCallbackReturn:
        result = self._attempt(self.connect, state, super().on_activate)
        self.active = result == TransitionCallbackReturn.SUCCESS
        return result

    def on_deactivate(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Stop subscribing and publishing; the core keeps its state."""
        self._disconnect()
        return super().on_deactivate(state)

    def on_cleanup(self, state: LifecycleState) -> TransitionCallbackReturn:
        self.tasks = []
        return super().on_cleanup(state)

    def on_shutdown(self, state: LifecycleState) -> TransitionCallbackReturn:
        self._disconnect()
        self.done = True
        return super().on_shutdown(state)

    def _attempt(self, step: Any, state: LifecycleState, upwards: Any) -> TransitionCallbackReturn:
        self.problem = None
        try:
            step()
        except SaddleringError as problem:
            self.problem = problem
            if not self._is_starting:  # who starts the node says it
                self.get_logger().error(str(problem))
            self._disconnect()
            return TransitionCallbackReturn.FAILURE
        return upwards(state)

    def sources(self) -> Task:
        """The task that counts the publishers of each input topic."""
        return FunctionTask('sources', lambda: diagnostics.sources_status(
            {flow.topic: flow.publishers() for flow in self.inputs},
            [flow.unheard for flow in self.inputs if flow.unheard],
            [flow.topic for flow in self.inputs if not flow.senders.are_mixed]))

    def events(self, counts: Callable[[], dict[str, int]], harmless: Sequence[str] = (),
               guards: Callable[[], Sequence[SampleGuard]] = tuple) -> Task:
        """The task that counts mishaps, messages that could not be read among them.

        guards: of the first inputs, by which a refused sample has its topic and its limit.
        """
        def places() -> dict[tuple[str, str], int]:
            found = {('malformed', flow.topic): flow.malformed for flow in self.inputs}
            return found | {
                (name, flow.topic + guard.limits.words(name)): count
                for flow, guard in zip(self.inputs, guards(), strict=False)
                for name, count in vars(guard.counters).items()}

        return diagnostics.Events(
            lambda: {**counts(), 'malformed': sum(flow.malformed for flow in self.inputs)},
            harmless, places)

    def offer(self, kind: Any, name: str, act: Callable[[Any], str]) -> None:
        """Serve `name` while the node is active; `act` gives the words, NodeError refuses."""
        def answer(request: Any, response: Any) -> Any:
            try:
                if not self.active:
                    raise NodeError('is not active: ros2 lifecycle set '
                                    f'{self.get_fully_qualified_name()} activate')
                response.success, response.message = True, act(request)
            except NodeError as refusal:
                response.success, response.message = False, str(refusal)
            return response

        self.create_service(kind, name, answer)

    def refuse_silence(self, given_at: float, is_paused: bool) -> None:
        """NodeError if nothing comes of which a zero could be taken.

        given_at: when the inputs last gave something [s, monotonic]; is_paused: by a replay.
        """
        now = time.monotonic()
        if is_paused or now - given_at < MAX_SILENCE:
            return
        silent = [flow.topic for flow in self.inputs if now - flow.heard >= MAX_SILENCE]
        words = (f'no samples come on {", ".join(silent)}: start the driver or the replay'
                 if silent else 'load and probes come without a common stamp: correct their '
                 'clocks (status clocks)')
        raise NodeError(f'{words}, then call ~/zero again')

    def hand_over(self) -> None:
        """Stay until each reliable reader has every message, at most LONGEST_HAND_OVER.

        A reader on a busy machine is behind by what it asked for again: it ends with the writer.
        """
        end = time.monotonic() + LONGEST_HAND_OVER
        for flow in self.outputs:
            left = max(0.0, end - time.monotonic())
            flow.publisher.wait_for_all_acked(Duration(seconds=left))

    def _disconnect(self) -> None:
        self.active = False
        self.hand_over()
        for subscription in self.inputs:
            subscription.close()
        for publisher in self.outputs:
            publisher.close()
        self.inputs, self.outputs = [], []

    # --- the loop ---

    def awaited(self) -> list[raw_topics.RawSubscription]:
        """Those of them without whose next message a batch would give no result."""
        return self.inputs

    def work(self) -> None:
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
                self.get_name(), self.inputs, self.outputs, self.replayed_until()))

    def _diagnose(self, now: float) -> None:
        elapsed, self._diagnosed = now - self._diagnosed, now
        if self.IS_SINGLE and (twice := self._namesakes.words()):
            state = TaskStatus(diagnostics.WARN, twice)
        elif self.active:
            state = TaskStatus(OK, diagnostics.ACTIVE)
        elif self.problem is not None:
            state = TaskStatus(diagnostics.ERROR, f'not active: {self.problem}')
        else:
            steps = 'activate' if self.tasks else 'configure, then activate'
            state = TaskStatus(
                OK, f'not active: ros2 lifecycle set {self.get_fully_qualified_name()} {steps}')
        found = [(task, task.report(elapsed)) for task in self.tasks]
        self._silent.review(found)
        self._diagnostics.publish(diagnostics.to_message(self, [
            (diagnostics.STATE_TASK, state),
            *((task.name, status) for task, status in found)]))


REFUSALS = ('RCLError', 'UnknownROSArgsError', 'InvalidNodeNameException',
            'RCLInvalidROSArgsError', 'InvalidNamespaceException')
"""Errors by which rclpy refuses a command line (--ros-args, a parameter file it cannot read)."""
LONGEST_END = 3.0
"""Longest time [s] for the middleware to leave the network; a launch grants five in all."""

FORMS = {
    'remap rule': '-r OLD:=NEW', 'parameter override rule': '-p NAME:=VALUE',
    'log level': '--log-level debug, info, warn, error or fatal',
    'params file': '--params-file FILE, and in it NODE: {ros__parameters: {NAME: VALUE}}'}
"""What to type, by the name that rcl has for a part of a command line."""

NAMES = {'__ns': '-r __ns:=/NAME with letters, digits and _, and no digit first',
         '__node': '-r __node:=NAME with letters, digits and _, and no digit first'}
"""The same of a name that is no name of ROS."""


def refusal_words(words: str) -> str:
    """A refusal of rcl with what to type, and without places in its source; others unchanged."""
    refused = re.search(
        r"Couldn't parse (?:trailing )?(.*?): '(.*?)'\. Error: (.*?)(?:, at |$)", words)
    if refused is not None and refused[1] in FORMS:
        name = refused[2].removeprefix('-r ').partition(':=')[0]
        why = f' ({refused[3]})' if refused[1] == 'params file' else ''
        return (f'{refused[1]} {refused[2]!r} is of no use{why}: give '
                f'{NAMES.get(name, FORMS[refused[1]])}')
    return re.sub(r', at /\S+', '', words)


def run_streaming(make: Callable[[], StreamingNode], args: Sequence[str] | None = None) -> int:
    """Run a streaming node until it is done or a signal ends it; returns the exit status."""
    def spin(node: StreamingNode) -> None:
        node.start()
        # A full collection of garbage looks at every object of every imported library, which
        # takes tens of milliseconds in the middle of a stream. These objects are exempt from it.
        gc.collect()
        gc.freeze()
        raw_topics.spin_streaming(node)
        node.hand_over()
    return run(make, spin, args)


def executable(make: Callable[[], Any], serve: Callable[..., int] = run_streaming,
               ) -> Callable[..., None]:
    """The function `main` of a node's module; serve: makes and runs it, for the exit status."""
    return lambda args=None: leave(serve(make, args))


def run(make: Callable[[], Any], spin: Callable[[Any], None],
        args: Sequence[str] | None = None) -> int:
    """Make a node, spin it, clean up; one line and status 2 for an error of the user.

    SIGINT and SIGTERM set the node's `done`, which ends `spin`: a context that rclpy's handlers
    have shut down waits for no reader. A node that is being made is made first: what a handler
    raises may be lost in the middle of it.
    """
    launcher.follow_lifeline()
    launcher.sweep()
    node: Any = None
    told, status = False, 1

    def finish(*_: object) -> None:
        nonlocal told
        told = True
        if node is not None:
            node.done = True

    given = sys.argv[1:] if args is None else args
    try:
        words = parameters.strict_arguments(given)
        domain = launcher.domain_from(os.environ.get('ROS_DOMAIN_ID') or '0', 'ROS_DOMAIN_ID')
        launcher.prepare_middleware()
        for number in SIGNALS:
            signal.signal(number, finish)
        rclpy.init(args=['', *words], signal_handler_options=SignalHandlerOptions.NO)
        node = make()
        parameters.refuse_undeclared(node)
        for warning in parameters.unaddressed(given, node):
            node.get_logger().warning(warning)
        crowded = launcher.crowded_words(launcher.participants(domain), domain)
        if crowded:
            node.get_logger().error(crowded)
        if not told:
            spin(node)
        status = 0
    except (KeyboardInterrupt, ExternalShutdownException):
        status = 0
    except Exception as problem:
        if not isinstance(problem, SaddleringError):
            if node is not None and not node.context.ok():
                status = 0  # a signal came in the middle of work
                return status
            if node is not None or type(problem).__name__ not in REFUSALS:
                raise
        print(refusal_words(' '.join(str(problem).split())), file=sys.stderr)
        status = UNUSABLE
    finally:
        # Destroy the node and the context; a second Ctrl-C must not interrupt this.
        for number in SIGNALS:
            with contextlib.suppress(ValueError):
                signal.signal(number, signal.SIG_IGN)
        with _abandoned(status, LONGEST_END):
            if node is not None:
                with contextlib.suppress(Exception):
                    node.destroy_node()
            with contextlib.suppress(Exception):
                rclpy.try_shutdown()
    return status


def leave(status: int, longest: float = LONGEST_END) -> NoReturn:
    """End the process with `status` after all functions that were registered for the end.

    The interpreter is not finalized. With compiled kernels that takes longer than everything
    else, and a launch file gives all its nodes together five seconds to end.

    The work of the node is done and written by now. The status is therefore kept even if the
    middleware crashes or hangs while it leaves the network. Fast DDS sometimes does so when many
    nodes end at once. The middleware is abandoned after `longest` seconds. No line is printed:
    nothing is lost, and other participants forget this one after its lease.
    """
    gc.disable()  # an automatic collection could reach the middleware before the handlers are set
    with _abandoned(status, longest, signal.SIGSEGV, signal.SIGABRT, signal.SIGBUS):
        gc.unfreeze()
        gc.collect()  # the node leaves the network
        atexit._run_exitfuncs()
        for stream in (sys.stdout, sys.stderr):
            with contextlib.suppress(OSError, ValueError):
                stream.flush()
        os._exit(status)


@contextlib.contextmanager
def _abandoned(status: int, longest: float, *crashes: signal.Signals) -> Iterator[None]:
    """End the process with `status` if the block takes longer than `longest` [s], or crashes.

    The handler is one of the C runtime: the middleware may keep the interpreter while it hangs,
    and Python would run its own handlers only after that.
    """
    def end(_number: int) -> None:
        os._exit(status)

    handler_type = ctypes.CFUNCTYPE(None, ctypes.c_int)
    handler = handler_type(end)
    set_handler = ctypes.CDLL(None).signal
    set_handler.argtypes, set_handler.restype = (ctypes.c_int, handler_type), ctypes.c_void_p
    for number in (signal.SIGALRM, *crashes):
        set_handler(number, handler)
    signal.setitimer(signal.ITIMER_REAL, longest)
    try:
        yield
    finally:
        signal.setitimer(signal.ITIMER_REAL, 0.0)
        signal.signal(signal.SIGALRM, signal.SIG_DFL)
        del handler
