"""Data of the page, received over ROS: streams, health, parameters and actions."""

from __future__ import annotations

from collections.abc import Callable, Mapping
import contextlib
from dataclasses import asdict, dataclass, field
import json
import os
import threading
import time
from typing import Any

from action_msgs.msg import GoalStatus, GoalStatusArray
from diagnostic_msgs.msg import DiagnosticArray
from geometry_msgs.msg import Vector3Stamped, WrenchStamped
import numpy as np
from numpy.typing import NDArray
import rclpy
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rclpy.qos import qos_profile_action_status_default
from sensor_msgs.msg import Range

from saddlering_interfaces.action import DiagnoseRing, IdentifyRing
from saddlering_interfaces.msg import (
    ReplayProgress,
    ReplayState,
    RingAlarm,
    RingDisplacement,
    RingParameters,
)
from saddlering_ros.bags.messages import decode_displacements, decode_samples
from saddlering_ros.bags.wire import CdrError
from saddlering_ros.errors import SaddleringError
from saddlering_ros.live.alarms import alarm_as_page, with_link
from saddlering_ros.live.answers import diagnosis_answer, identification_answer
from saddlering_ros.live.commands import Commands
from saddlering_ros.live.gauges import Gauges
from saddlering_ros.live.traces import Traces
from saddlering_ros.quantities import quantity
from saddlering_ros.record.samples import BRIDGED, DOUBTFUL_LOAD, NOT_KNOWN
from saddlering_ros.record.scatter import white_noise
from saddlering_ros.record.topics import ELEVATION, LOAD, PROBES, RigTopic
from saddlering_ros.rig import (
    CHANNELS,
    default_rig,
    FORCE_UNITS,
    PARAMETER_NAMES,
    PARAMETER_UNITS,
    Rig,
    stiffness_per_millimetre,
)
from saddlering_ros.ros.messages import parameters_from_message, progress_of, to_stamp
from saddlering_ros.ros.names import (
    DIAGNOSE,
    DIAGNOSTICS,
    DISPLACEMENT,
    IDENTIFY,
    LIVE_PAGE,
    PARAMETERS_IN_FORCE,
    PROGRESS,
    RESIDUAL,
    RING_ALARM,
    SIMULATED,
    STATE,
)
from saddlering_ros.ros.raw_topics import (
    LATCHED,
    LATCHED_BY_SEVERAL,
    PROGRESS_QOS,
    RawSubscription,
)

STREAMS = {'load': LOAD.relative, 'measured': DISPLACEMENT, 'simulated': SIMULATED,
           'residual': RESIDUAL}
SCALES = {'measured': 1e6, 'simulated': 1e6, 'residual': 1e6}
"""Units of the page: micrometres and microradians."""

POLL = 0.05
"""Streams are drained this often [s]: the queues of `RawSubscription` hold 100 times that."""

REVIEW = 1.0
"""How often it is looked whether the publishers are reliable or best effort [s]."""

REPORT = 0.2
"""Period [s] of the reports to a replay, which stays at its end until the page has all."""

SILENT = 3.5
"""A node that has not spoken on /diagnostics for so long [s] is gone."""

BAND_LAG = 30
"""Drawn means over which the noise of the residual is judged, at most: slow noise counts too."""

MIN_MEANS = 20
TYPES = {'geometry_msgs/msg/WrenchStamped': WrenchStamped, 'sensor_msgs/msg/Range': Range,
         'geometry_msgs/msg/Vector3Stamped': Vector3Stamped}
SENSORS: dict[str, RigTopic] = {
    'elevation': ELEVATION, **{f'probe_{place}': topic for place, topic in enumerate(PROBES, 1)}}
"""Readings of the rig besides the load, by the name of the gauge."""

BAG, ELEVATION_KEY = 'bag', 'elevation [deg]'
"""Keys of /diagnostics whose values the page shows."""

ACTIONS = {'identify': (IDENTIFY, IdentifyRing),
           'diagnose': (DIAGNOSE, DiagnoseRing)}
RUNNING = (GoalStatus.STATUS_ACCEPTED, GoalStatus.STATUS_EXECUTING, GoalStatus.STATUS_CANCELING)
LEVELS = ('ok', 'warning', 'error', 'silent')


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


class Watcher:
    """A ROS node that receives the topics of the rig; `state` and `rows` are the data of the page.

    It wakes twenty times a second at any rate of the streams; the nodes' publishers keep
    the last messages only and so never wait for a reader. It reports what it has received: a
    replay in lockstep waits before the queues between them lose messages, and at its end.
    """

    def __init__(self, domain_id: int | None = None, window: float = 600.0,
                 namespace: str = '', rig: Rig | None = None) -> None:
        self.rig = rig or default_rig()
        self.force_unit = self.rig.force_unit
        self._scales = {**SCALES, 'load': 1.0 / FORCE_UNITS[self.force_unit]}
        self.context = rclpy.Context()
        rclpy.init(context=self.context, args=[], domain_id=domain_id)
        self.node: Node = rclpy.create_node(
            LIVE_PAGE, namespace=namespace, context=self.context)
        self._namespace = namespace
        self._executor = SingleThreadedExecutor(context=self.context)
        self._executor.add_node(self.node)
        channels = {name: 1 if name == 'load' else len(CHANNELS) for name in STREAMS}
        self.traces = Traces(channels, window=window)
        self.lock = threading.Lock()
        self._streams = {
            name: RawSubscription(
                self.node, topic, WrenchStamped if name == 'load' else RingDisplacement)
            for name, topic in STREAMS.items()}
        self._sensors = {name: RawSubscription(self.node, topic.relative, TYPES[topic.type])
                         for name, topic in SENSORS.items()}
        self.gauges = Gauges()
        self.commands = Commands(self.node)
        self._band: list[float | None] = [None] * len(CHANNELS)
        self._doubt = ''
        self._published: dict[str, int] = {}
        self._facts: dict[str, str] = {}
        self._health: dict[str, tuple[float, dict[str, Any]]] = {}
        self._parameters: dict[str, Any] | None = None
        self._replay: dict[str, Any] | None = None
        self._alarm: dict[str, Any] | None = None
        self._jobs: dict[str, Job] = {}
        self._actions = {name: _Action(self, name, path, kind)
                         for name, (path, kind) in ACTIONS.items()}
        self._progress = self.node.create_publisher(ReplayProgress, PROGRESS, PROGRESS_QOS)
        subscribe = self.node.create_subscription
        subscribe(DiagnosticArray, DIAGNOSTICS, self._on_diagnostics, 50)
        subscribe(RingParameters, PARAMETERS_IN_FORCE, self._on_parameters, LATCHED_BY_SEVERAL)
        subscribe(ReplayState, STATE, self._on_replay, LATCHED)
        subscribe(ReplayProgress, PROGRESS, self._on_progress, PROGRESS_QOS)
        subscribe(RingAlarm, RING_ALARM, self._on_alarm, LATCHED)
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self._run, name=LIVE_PAGE, daemon=True)

    def __enter__(self) -> Watcher:
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._stop.set()
        self._thread.join(5.0)
        with contextlib.suppress(Exception):
            self._executor.shutdown(timeout_sec=0.0)
            self.node.destroy_node()
        rclpy.try_shutdown(context=self.context)

    # --- requests of the page ---

    def rows(self, version: int, turn: int) -> dict[str, Any] | None:
        """New data of the streams since `turn` of `version`; None if there are none."""
        with self.lock:
            traces = self.traces
            is_new = version != traces.version
            found = traces.since(-1 if is_new else turn, self._scales)
            if not found and not is_new:
                return None
            return {'full_load': self.rig.full_scale_load * self._scales['load'],
                    'version': traces.version, 'turn': traces.turn, 'anew': is_new,
                    'width': traces.width / 1e9, 'force_unit': self.force_unit, 'streams': found}

    def now(self) -> dict[str, Any]:
        """The name of the test and the numbers of this moment."""
        with self.lock:
            shown = self.gauges.as_page(_number(self._facts.get(ELEVATION_KEY)),
                                        self.rig.probes.absent)
            has_ended = shown['load'] is not None and shown['load']['is_old']
            return {'test': self._facts.get(BAG, ''), 'gauges': shown,
                    'ended': self.traces.newest if has_ended else 0}

    def state(self) -> dict[str, Any]:
        """The state of the page without the streams and the values of each sample."""
        with self.lock:
            now = time.monotonic()
            health = [
                {'name': name, **({'level': 'silent', 'words': 'Node offline'}
                                  if now - heard > SILENT else status)}
                for name, (heard, status) in sorted(self._health.items())]
            return {
                'health': health, 'parameters': self._parameters, 'replay': self._replay,
                'alarm': with_link(self._alarm, health), 'band': self._band, 'doubt': self._doubt,
                'commands': self.commands.as_page(), 'left_out': self.traces.left_out,
                'missing': missing_words(self.traces.received, self._published_by_stream())
                if self._replay is not None and self._replay['state'] == 'finished' else '',
                'jobs': {name: asdict(job) for name, job in self._jobs.items()}}

    def clear(self) -> None:
        """Clear the plots."""
        with self.lock:
            self.traces.clear()

    def cancel(self, action: str) -> bool:
        """Ask the server of an action to cancel its goal; whether there is a server."""
        return self._actions[action].cancel()

    def ask(self, command: str) -> bool:
        """Ask for a zero, a start or a pause; whether a node offers it."""
        return self.commands.ask(command)

    # --- hearing ---

    def _run(self) -> None:
        polled = reviewed = reported = 0.0
        while not self._stop.is_set() and self.context.ok():
            try:
                self._executor.spin_once(timeout_sec=POLL / 2)
            except Exception as problem:  # one bad message must not end the page
                self.node.get_logger().error(f'not understood: {problem}',
                                             throttle_duration_sec=5.0)
            now = time.monotonic()
            if now - polled >= POLL:
                polled = now
                self._poll()
            if now - reported >= REPORT and self._replay is not None:
                reported = now
                self._progress.publish(progress_of(
                    f'{LIVE_PAGE}_{os.getpid()}',
                    [flow for flow in self._streams.values() if flow.reliable], []))
            if now - reviewed >= REVIEW:
                reviewed = now
                for subscription in (*self._streams.values(), *self._sensors.values()):
                    subscription.review()
                with self.lock:
                    self._band = self._band_of_residual()

    def _poll(self) -> None:
        for name, subscription in self._streams.items():
            messages = subscription.take()
            if not messages:
                continue
            with contextlib.suppress(CdrError), self.lock:
                self._take(name, messages)
        for name, subscription in self._sensors.items():
            newest = subscription.take()[-1:]
            if newest:
                with contextlib.suppress(CdrError), self.lock:
                    found = decode_samples(newest, SENSORS[name])
                    self.gauges.push(name, float(found.values[-1]), found.low, found.high)
        for action in self._actions.values():
            action.look_after()

    def _band_of_residual(self) -> list[float | None]:
        """Noise of the drawn means of the residual [um, urad]; None while they are too few."""
        means = self.traces.means('residual')
        if means.shape[1] < MIN_MEANS:
            return [None] * len(CHANNELS)
        lag = min(BAND_LAG, means.shape[1] // 6)
        return [_finite(1e6 * white_noise(channel, lag)) for channel in means]

    def _take(self, name: str, messages: list[bytes]) -> None:
        if name == 'load':
            load = decode_samples(messages, LOAD)
            self._streams[name].last_stamp = int(load.stamps[-1])
            self.traces.push(name, load.stamps, load.values[None, :])
            self.gauges.push(name, float(load.values[-1]))
            return
        batch = decode_displacements(messages)
        self._streams[name].last_stamp = int(batch.stamps[-1])
        self.traces.push(name, batch.stamps, batch.channels)
        if name == 'residual':
            self._doubt = doubt_words(batch.validity)

    def _on_diagnostics(self, message: DiagnosticArray) -> None:
        now = time.monotonic()
        with self.lock:
            for status in message.status:
                if not in_namespace(status.name, self._namespace):
                    continue
                level = LEVELS[min(status.level[0], 3)]
                self._health[status.name] = (now, {'level': level, 'words': status.message})
                self._facts.update((item.key, item.value) for item in status.values
                                   if item.key in (BAG, ELEVATION_KEY))

    def _on_parameters(self, message: RingParameters) -> None:
        if not message.applied_by:
            return  # only offered
        try:
            parameters = parameters_from_message(message)
        except SaddleringError:
            return
        contact = parameters.contact
        rows = [[name, quantity(float(getattr(contact, name)), PARAMETER_UNITS[name])]
                for name in PARAMETER_NAMES]
        rows += [[name, quantity(stiffness_per_millimetre(value, power), 'N/mm^n')]
                 for name, value, power in (('K1', contact.K1, contact.n1),
                                            ('K2', contact.K2, contact.n2))]
        rows += [[f'{effect}.{name}', f'{value:.4g}']
                 for effect, values in parameters.effects.items()
                 for name, value in values.items()]
        with self.lock:
            self._parameters = {'source': str(message.source), 'rows': rows}

    def _on_replay(self, message: ReplayState) -> None:
        start, end = to_stamp(message.start), to_stamp(message.end)
        share = (to_stamp(message.now) - start) / max(end - start, 1)
        words = ('waiting', 'playing', 'paused', 'finished')[min(message.state, 3)]
        with self.lock:
            if words != 'finished':
                self.traces.begin(start, end)
            self._replay = {'state': words, 'share': min(max(share, 0.0), 1.0),
                            'speed': round(float(message.speed), 1),
                            'waiting_for': list(message.waiting_for)}

    def _on_progress(self, message: ReplayProgress) -> None:
        with self.lock:
            self._published.update(zip(message.outputs, map(int, message.published),
                                       strict=False))

    def _published_by_stream(self) -> dict[str, int]:
        return {name: self._published.get(subscription.topic, 0)
                for name, subscription in self._streams.items()}

    def _on_alarm(self, message: RingAlarm) -> None:
        shown = alarm_as_page(message)
        with self.lock:
            self._alarm = shown

    def set_job(self, action: str, change: Callable[[Job | None], Job | None]) -> None:
        """Change the state of an action's goal."""
        with self.lock:
            job = change(self._jobs.get(action))
            if job is not None:
                self._jobs[action] = job


def doubt_words(validity: NDArray[np.uint8]) -> str:
    """Channels of the newest residual (N,) that are unknown or not from sound readings."""
    missing = [name for name, bit in NOT_KNOWN.items() if int(validity[-1]) & bit]
    words = [f'not known: {", ".join(missing)}'] if missing else []
    if (validity & BRIDGED).any():
        words.append('interpolated across a refused reading')
    if (validity & DOUBTFUL_LOAD).any():
        words.append('by a doubtful load')
    return '; '.join(words)


def missing_words(received: Mapping[str, int], published: Mapping[str, int]) -> str:
    """Samples of the test that its nodes published and that have not arrived here; '' if all."""
    return ', '.join(f'{due - received[name]} of {due} samples of {name}'
                     for name, due in published.items() if received[name] < due)


def in_namespace(status: str, namespace: str) -> bool:
    """Whether a status on /diagnostics is of a node in `namespace` ('' for the root)."""
    return status.startswith(f'{namespace}/') if namespace else not status.startswith('/')


class _Action:
    """One action as a bystander sees it: goals, feedback, results, and the way to cancel."""

    def __init__(self, watcher: Watcher, name: str, path: str, kind: Any) -> None:
        self._watcher, self._name, self._path = watcher, name, path
        node = watcher.node
        self._kind = kind
        node.create_subscription(GoalStatusArray, f'{path}/_action/status', self._on_status,
                                 qos_profile_action_status_default)
        node.create_subscription(kind.Impl.FeedbackMessage, f'{path}/_action/feedback',
                                 self._on_feedback, 10)
        self._cancel = node.create_client(kind.Impl.CancelGoalService,
                                          f'{path}/_action/cancel_goal')
        self._result = node.create_client(kind.Impl.GetResultService,
                                          f'{path}/_action/get_result')
        self._asked = ''

    def cancel(self) -> bool:
        """Cancel all goals (the zero id means all)."""
        if not self._cancel.service_is_ready():
            return False
        self._cancel.call_async(self._kind.Impl.CancelGoalService.Request())
        self._change(lambda job: _with(job, stage='canceling') if job is not None else None)
        return True

    def look_after(self) -> None:
        """Notice that the server is gone."""
        if self._watcher.node.count_publishers(f'{self._path}/_action/status'):
            return
        self._change(lambda job: _with(job, state='lost', words='its server is gone')
                     if job is not None and job.state == 'running' else None)

    def _change(self, change: Callable[[Job | None], Job | None]) -> None:
        self._watcher.set_job(self._name, change)

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
        self._change(lambda job: job if job is None or job.state != 'running' else _with(
            job, stage=said.stage, share=float(share), words=words, elapsed=float(said.elapsed),
            left=left))

    def _on_result(self, goal: str, response: Any) -> None:
        state = {GoalStatus.STATUS_SUCCEEDED: 'done', GoalStatus.STATUS_CANCELED: 'canceled'}.get(
            response.status, 'failed')
        result = response.result
        ended = Job(goal, state, stage='', share=1.0, words=str(result.message))
        if state == 'done':
            answer = (diagnosis_answer(json.loads(result.verdict_json))
                      if self._name == 'diagnose' else
                      identification_answer(json.loads(result.report_json), ended.words))
            ended = _with(ended, verdict=answer.verdict, title=answer.title, words=answer.words,
                          lines=list(answer.lines))
        self._change(lambda job: ended if job is None or job.goal == goal else None)


def _with(job: Job, **changes: Any) -> Job:
    return Job(**{**asdict(job), **changes})


def _finite(value: float) -> float | None:
    return round(value, 5) if np.isfinite(value) else None


def _number(text: str | None) -> float | None:
    try:
        return None if text is None else float(text)
    except ValueError:
        return None
