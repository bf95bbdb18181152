"""Nodes in processes of their own, replays one after another, and both actions for a client."""

from __future__ import annotations

from collections.abc import Callable
import contextlib
from dataclasses import dataclass
from functools import partial
import os
from pathlib import Path
import signal
import threading
import time
from types import TracebackType
from typing import Any

from diagnostic_msgs.msg import DiagnosticArray
from geometry_msgs.msg import WrenchStamped
from lifecycle_msgs.msg import Transition
from lifecycle_msgs.srv import ChangeState
import numpy as np
from numpy.typing import NDArray
from rcl_interfaces.srv import SetParameters
import rclpy
from rclpy.action import ActionClient
from rclpy.executors import SingleThreadedExecutor
from rclpy.parameter import Parameter
from rclpy.signals import SignalHandlerOptions

from saddlering_interfaces.action import DiagnoseRing, IdentifyRing
from saddlering_interfaces.msg import ReplayState, RingDisplacement
from saddlering_ros.bags.wire import decode_displacements
from saddlering_ros.errors import SaddleringError
from saddlering_ros.record import Record
from saddlering_ros.record.batches import Displacements, join
from saddlering_ros.record.displacement import a_pair_reads
from saddlering_ros.record.topics import LOAD
from saddlering_ros.ros.launcher import last_line, NodeGroup, REPLAY_NODES, RING_NODES
from saddlering_ros.ros.messages import to_stamp
from saddlering_ros.ros.names import DIAGNOSE, DIAGNOSTICS, DISPLACEMENTS, IDENTIFY, STATE
from saddlering_ros.ros.raw_topics import LATCHED, RawSubscription, spin_streaming
from saddlering_ros.ros.streaming_node import StreamingNode

SWITCHED = (*REPLAY_NODES, 'replay_clock')
"""Nodes that are given the next bag, the clock last: it starts the replay."""

PATIENCE = 60.0
"""The longest wait for a node to come up or answer [s]."""

SAMPLES_PER_STEP = 50
"""Loads per step of the clock: many, but few enough for the buffers between the nodes."""

LONGEST_STEP = 1.8
"""[s]; the replay nodes take a step of two seconds for a move by hand."""

Show = Callable[[float, str], None]


class LiveRig:
    """All eight nodes, and an ordinary client beside them; ended without remains."""

    def __init__(self, bag_root: Path, parameters_root: Path, elevation_deg: float) -> None:
        self._group = NodeGroup()
        self._bag_root, self._parameters_root = bag_root, parameters_root
        self._elevation = elevation_deg
        self._stack = contextlib.ExitStack()
        self._state: ReplayState | None = None
        self._simulator: dict[str, str] = {}
        self._replayed: set[str] = set()

    def __enter__(self) -> LiveRig:
        with contextlib.ExitStack() as stack:
            stack.enter_context(self._group)
            self._start()
            self._join_ros(stack)
            self._stack = stack.pop_all()
        return self

    def __exit__(self, kind: type[BaseException] | None, problem: BaseException | None,
                 trace: TracebackType | None) -> None:
        self._stack.__exit__(kind, problem, trace)

    @property
    def domain(self) -> int:
        """The ROS domain everything happens in."""
        assert self._group.domain_id is not None
        return self._group.domain_id

    @property
    def nodes(self) -> int:
        """How many nodes run."""
        return len(self._group.processes)

    # --- starting and leaving ---

    def _start(self) -> None:
        roots = {'bag_root': str(self._bag_root)}
        self._group.start('ring_displacement')
        self._start_simulator(None)
        self._group.start('ring_residual')
        for name in SWITCHED:
            clock = {'lockstep': True, 'rate': 0.0, 'participants': [
                *REPLAY_NODES, *RING_NODES, RECORDER]} if name == 'replay_clock' else {}
            self._group.start(name, {**roots, **clock})
        self._group.start('ring_identification', roots)
        self._group.start('ring_diagnosis',
                          {**roots, 'parameters_root': str(self._parameters_root)})

    def _start_simulator(self, parameters_file: Path | None) -> None:
        settings: dict[str, Any] = {'elevation_deg': self._elevation, 'follow_parameters': True}
        if parameters_file is not None:
            settings['parameters_file'] = str(parameters_file)
        self._group.start('ring_simulator', settings)

    def _join_ros(self, stack: contextlib.ExitStack) -> None:
        """Create the ROS objects of this process; `stack` destroys them before their context.

        An object that outlives its context is left to the garbage collector, in which the
        middleware can wait for ever.
        """
        os.environ.update(self._group.environment)
        rclpy.init(args=[], domain_id=self.domain, signal_handler_options=SignalHandlerOptions.NO)
        stack.callback(rclpy.try_shutdown)
        self._node = rclpy.create_node('demo')
        stack.callback(self._node.destroy_node)
        self._executor = SingleThreadedExecutor()
        stack.callback(self._executor.shutdown, timeout_sec=0.0)
        self._executor.add_node(self._node)
        self._node.create_subscription(ReplayState, STATE, self._on_state, LATCHED)
        self._node.create_subscription(DiagnosticArray, DIAGNOSTICS, self._on_diagnostics, 50)
        self._actions = {
            'identify': ActionClient(self._node, IdentifyRing, IDENTIFY),
            'diagnose': ActionClient(self._node, DiagnoseRing, DIAGNOSE),
        }
        for action in self._actions.values():
            stack.callback(action.destroy)
        self._recorder = DemoRecorder()
        stack.callback(self._recorder.destroy_node)
        self._recorder.start()
        self._spinning = threading.Thread(
            target=spin_streaming, args=(self._recorder, self._recorder), daemon=True)
        self._spinning.start()
        stack.callback(self._end_recorder)

    def _end_recorder(self) -> None:
        self._recorder.done = True
        self._spinning.join(2.0)

    def _on_state(self, message: ReplayState) -> None:
        self._state = message

    def _on_diagnostics(self, message: DiagnosticArray) -> None:
        for status in message.status:
            if status.name == 'ring_simulator: parameters':
                self._simulator = {item.key: item.value for item in status.values}

    # --- waiting ---

    def wait_for_nodes(self) -> None:
        """Wait until every node is up and answers."""
        for name in (*SWITCHED, 'ring_simulator'):
            self._client(ChangeState, f'/{name}/change_state')
        for name, action in self._actions.items():
            self._until(action.server_is_ready, f'the action {name} is not served')

    def _until(self, is_done: Callable[[], bool], complaint: str,
               patience: float = PATIENCE) -> None:
        """Spin until `is_done`; DemoError if it takes too long, NodeError if a node ends."""
        deadline = time.monotonic() + patience
        while not is_done():
            self._executor.spin_once(timeout_sec=0.05)
            self._group.check()
            if time.monotonic() > deadline:
                said = [f'{node.name}: {last_line(node.said())}'
                        for node in self._group.processes.values() if node.said().strip()]
                raise DemoError(f'{complaint} after {patience:g} s ({"; ".join(said)})')

    def _client(self, kind: Any, name: str) -> Any:
        client = self._node.create_client(kind, name)
        self._until(client.service_is_ready, f'{name} is not there')
        return client

    def _call(self, kind: Any, name: str, request: Any) -> Any:
        client = self._client(kind, name)
        future = client.call_async(request)
        self._until(future.done, f'{name} does not answer')
        self._node.destroy_client(client)
        return future.result()

    # --- replays ---

    def replay(self, bag: Path, interval: float, show: Show) -> ReplayRecording:
        """Replay a bag with a load every `interval` [s] in lockstep; the published messages."""
        self._recorder.cut()
        self._state = None
        window = min(LONGEST_STEP, max(0.02, SAMPLES_PER_STEP * interval))
        for name in SWITCHED:
            extra = {'window': window} if name == 'replay_clock' else {}
            # Give a replay node its next bag, through its lifecycle.
            values: dict[str, str | float] = {'bag': str(bag), **extra}
            if name in self._replayed:
                self._transit(name, Transition.TRANSITION_DEACTIVATE)
                self._transit(name, Transition.TRANSITION_CLEANUP)
            self._replayed.add(name)
            parameters = [Parameter(key, value=value).to_parameter_msg()
                          for key, value in values.items()]
            answer = self._call(SetParameters, f'/{name}/set_parameters',
                                SetParameters.Request(parameters=parameters))
            refused = [item.reason for item in answer.results if not item.successful]
            if refused:
                raise DemoError(f'{name}: {refused[0]}')
            self._transit(name, Transition.TRANSITION_CONFIGURE)
            self._transit(name, Transition.TRANSITION_ACTIVATE)
        self._until(lambda: 0.0 <= self._share()[0] < 1.0,
                    f'the replay of {bag.name} does not start')
        share, words = self._share()
        while share < 1.0:
            self._until(partial(lambda before: self._share()[0] != before, share),
                        f'the replay of {bag.name} is stuck')
            share, words = self._share()
            show(share, words)
        return self._recorder.cut()

    def _share(self) -> tuple[float, str]:
        """Share of the replay that is done (-1: no report yet, 1: at its end), and its rate."""
        state = self._state
        if state is None:
            return -1.0, ''
        if state.state == ReplayState.FINISHED:
            return 1.0, ''
        start, end = to_stamp(state.start), to_stamp(state.end)
        share = (to_stamp(state.now) - start) / max(end - start, 1)
        return min(share, 0.999), f'{state.speed:.0f} times real time' if state.speed else ''

    def _transit(self, name: str, transition: int) -> None:
        request = ChangeState.Request(transition=Transition(id=transition))
        if not self._call(ChangeState, f'/{name}/change_state', request).success:
            said = last_line(self._group.processes[name].said())
            raise DemoError(f'{name}: refuses lifecycle transition {transition}: {said}')

    # --- the simulator ---

    def restart_simulator(self, elevation_deg: float, parameters_file: Path) -> None:
        """Restart the simulator at another elevation with given parameters."""
        process = self._group.processes['ring_simulator'].process
        process.send_signal(signal.SIGINT)
        self._until(lambda: process.poll() is not None, 'ring_simulator does not leave')
        self._elevation, self._simulator = elevation_deg, {}
        self._start_simulator(parameters_file)
        self._until(lambda: bool(self._simulator), 'ring_simulator does not come up again')

    def wait_for_parameters(self, stiffness: float, effects: int) -> None:
        """Wait until the simulator reports these parameters: K1 and the number of effects."""
        def follows() -> bool:
            named = {key.partition('.')[0] for key in self._simulator if '.' in key}
            return self._simulator.get('k1') == f'{stiffness:.6g}' and len(named) == effects

        self._until(follows, 'ring_simulator does not follow /ring/parameters', 10.0)

    # --- actions ---

    def identify(self, bags: list[str], validation: list[str],
                 show: Callable[[IdentifyRing.Feedback], None]) -> IdentifyRing.Result:
        """Call /identify_ring."""
        return self._act('identify', IdentifyRing.Goal(bags=bags, validation_bags=validation),
                         show)

    def diagnose(self, bags: list[str], hold_out: list[str], parameters_file: Path,
                 show: Callable[[DiagnoseRing.Feedback], None]) -> DiagnoseRing.Result:
        """Call /diagnose_ring."""
        goal = DiagnoseRing.Goal(bags=bags, hold_out=hold_out,
                                 parameters_file=str(parameters_file))
        return self._act('diagnose', goal, show)

    def _act(self, name: str, goal: Any, show: Callable[[Any], None]) -> Any:
        sent = self._actions[name].send_goal_async(
            goal, feedback_callback=lambda message: show(message.feedback))
        self._until(sent.done, f'the action {name} does not answer')
        handle = sent.result()
        if not handle.accepted:
            raise DemoError(f'the action {name} refuses the goal: another one is running')
        future = handle.get_result_async()
        self._until(future.done, f'the action {name} does not end', 600.0)
        result = future.result().result
        if result.status != result.SUCCEEDED:
            raise DemoError(f'the action {name} failed: {result.message}')
        return result


class DemoError(SaddleringError):
    """Bags the demo cannot use, or nodes that do not do their part."""


RECORDER = 'demo_recorder'


@dataclass(frozen=True)
class ReplayRecording:
    """Messages received during one replay: the batch of each topic, and the number of loads."""

    measured: Displacements
    simulated: Displacements
    residual: Displacements
    loads: int

    @property
    def messages(self) -> int:
        """Messages received."""
        return len(self.measured) + len(self.simulated) + len(self.residual) + self.loads

    def lost(self, run: Record) -> int:
        """Messages that the replay of `run` should have given and that did not come.

        Every load has a simulation, and every load at which a pair of probes reads has a
        displacement and a residual.
        """
        published = int(np.count_nonzero(a_pair_reads(run.gaps)))
        return 2 * (len(run.time) + published) - self.messages

    def at(self, stamps: NDArray[np.int64]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Measured and simulated channels (4, N) at `stamps` [ns], NaN where none came."""
        return placed(self.measured, stamps), placed(self.simulated, stamps)


class DemoRecorder(StreamingNode):
    """Keeps displacements and loads; the clock in lockstep waits for it too."""

    def __init__(self) -> None:
        super().__init__(RECORDER)
        self._lock = threading.Lock()
        self._clear()

    def connect(self) -> None:
        """Subscribe to the load and to everything about the ring."""
        self.inputs = [RawSubscription(self, topic, RingDisplacement) for topic in DISPLACEMENTS]
        self.inputs.append(RawSubscription(self, LOAD.relative, WrenchStamped))

    def process_batch(self) -> None:
        """Keep one batch."""
        with self._lock:
            for topic, flow in zip(DISPLACEMENTS, self.inputs, strict=False):
                batch = flow.take_as(decode_displacements)
                if len(batch):
                    flow.last_stamp = int(batch.stamps[-1])
                    self._kept[topic].append(batch)
            load = self.inputs[-1].take_samples(LOAD)
            if len(load):
                self.inputs[-1].last_stamp = int(load.stamps[-1])
                self._loads += len(load)

    def cut(self) -> ReplayRecording:
        """The messages since the last cut."""
        with self._lock:
            kept, loads = self._kept, self._loads
            self._clear()
        measured, simulated, residual = (join(kept[topic]) for topic in DISPLACEMENTS)
        return ReplayRecording(measured, simulated, residual, loads)

    def _clear(self) -> None:
        self._kept: dict[str, list[Displacements]] = {topic: [] for topic in DISPLACEMENTS}
        self._loads = 0


def placed(batch: Displacements, stamps: NDArray[np.int64]) -> NDArray[np.float64]:
    """The channels (4, N) of a batch at `stamps` [ns], NaN where it has none."""
    placed = np.full((4, len(stamps)), np.nan)
    _, here, there = np.intersect1d(stamps, batch.stamps, return_indices=True)
    placed[:, here] = batch.channels[:, there]
    return placed
