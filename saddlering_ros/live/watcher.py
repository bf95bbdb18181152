"""Data of the page, received over ROS: streams, health, parameters and actions."""

from collections.abc import Mapping
import contextlib
from dataclasses import asdict
import math
import os
from pathlib import Path
import threading
import time
from typing import Any

from diagnostic_msgs.msg import DiagnosticArray
import numpy as np
from numpy.typing import NDArray
import rclpy
from rclpy._rclpy_pybind11 import RMWError
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rclpy.serialization import deserialize_message

from saddlering_interfaces import msg
from saddlering_ros.bags.wire import CdrError, decode_displacements, decode_samples
from saddlering_ros.diagnosis.ring_wording import effect_rows
from saddlering_ros.errors import LiveError, SaddleringError
from saddlering_ros.live import session
from saddlering_ros.live.commands import Action, ACTIONS, Commands
from saddlering_ros.live.traces import Gauges, Traces
from saddlering_ros.monitoring.detector import materiality, sound_motion
from saddlering_ros.quantities import quantity
from saddlering_ros.record.batches import BRIDGED, DOUBTFUL_LOAD, NOT_KNOWN
from saddlering_ros.record.quality import white_noise
from saddlering_ros.record.record import TestMetadata
from saddlering_ros.record.topics import ELEVATION, LOAD, PROBES, RigTopic
from saddlering_ros.rig import CHANNELS, ContactParameters, default_rig, PARAMETER_NAMES, Rig
from saddlering_ros.rig.parameter_file import PARAMETER_UNITS
from saddlering_ros.rig.units import FORCE_UNITS, stiffnesses_per_millimetre
from saddlering_ros.ros import names, raw_topics
from saddlering_ros.ros.messages import parameters_from_message, progress_of, to_stamp
from saddlering_ros.ros.names import PARAMETERS_IN_FORCE
from saddlering_ros.ros.raw_topics import LATCHED_BY_SEVERAL, PROGRESS_QOS, RawSubscription

RIG: dict[str, RigTopic] = {
    'load': LOAD, 'elevation': ELEVATION,
    **{f'probe_{place}': topic for place, topic in enumerate(PROBES, 1)}}
"""Topics of the rig by the names of their gauges; the load is drawn too."""

RING = {'measured': names.DISPLACEMENT, 'simulated': names.SIMULATED, 'residual': names.RESIDUAL}
"""Topics of the ring by the names of their curves; in micrometres and microradians."""

POLL = 0.05
"""Streams are drained this often [s]: the queues of `RawSubscription` hold 100 times that."""

CALLBACKS = 4
"""More callbacks between two polls, so that a state of the alarm waits for no other message."""

REVIEW = 1.0
"""How often it is looked whether the publishers are reliable or best effort [s]."""

NODE_NAME = 48
"""Bytes at the start of a report of progress within which its node's name ends."""

LAST_SAMPLES = 3.0
"""After the end of a replay, samples that have not come for so long [s] are lost."""

REPORT = 0.2
"""Period [s] of the reports to a replay, which stays at its end until the page has all."""

SILENT = 3.5
"""A node that has not spoken on /diagnostics for so long [s] is gone: it is offline, unless the
clock of a replay left the network within as long of the node's last word."""

BAND_LAG = 30
"""Drawn means over which the noise of the residual is judged, at most: slow noise counts too."""

MIN_MEANS = 20
"""Fewest means whose noise is drawn, a standard deviation known to 16 %."""

ELEVATION_KEY = 'elevation [deg]'
"""Key of /diagnostics whose value the page shows, if the rig measures none."""

LEVELS = ('ok', 'warning', 'error', 'silent')


class Watcher:
    """A ROS node that receives the topics of the rig; `state` and `rows` are the data of the page.

    It wakes twenty times a second at any rate of the streams; the nodes' publishers keep
    the last messages only and so never wait for a reader. It reports what it has received: a
    replay in lockstep waits before the queues between them lose messages, and at its end.
    """

    def __init__(self, domain_id: int | None = None, window: float = 600.0,
                 namespace: str = '', rig: Rig | None = None) -> None:
        self.rig = rig or default_rig()
        self._scales = {**dict.fromkeys(RING, 1e6), 'load': 1.0 / FORCE_UNITS[self.rig.force_unit]}
        self.context = rclpy.Context()
        rclpy.init(context=self.context, args=[], domain_id=domain_id)
        self.node: Node = rclpy.create_node(
            names.LIVE_PAGE, namespace=namespace, context=self.context)
        self._namespace = namespace
        self._executor = SingleThreadedExecutor(context=self.context)
        self._executor.add_node(self.node)
        self.traces = Traces({'load': 1, **dict.fromkeys(RING, len(CHANNELS))}, window=window)
        self.lock = threading.Lock()
        self._flows = {
            **{name: RawSubscription(self.node, topic.relative,
                                     raw_topics.message_class(topic.type))
               for name, topic in RIG.items()},
            **{name: RawSubscription(self.node, topic, msg.RingDisplacement)
               for name, topic in RING.items()}}
        self.gauges = Gauges()
        self.session = session.Session()
        self.commands = Commands(self.node)
        unknown: list[Any] = [None] * len(CHANNELS)
        self._bands = {'band': unknown, 'allowed': unknown,
                       'range': [[None, None]] * len(CHANNELS)}
        self._contact: ContactParameters | None = None
        self._elevation = math.nan
        self._sound_for: tuple[ContactParameters, float] | None = None
        self._received_at = 0.0
        self._counted = -1
        self._received: dict[str, int] = {}
        self._doubt = self._bag = ''
        self._published: dict[str, int] = {}
        self._assumed: float | None = None
        self._health: dict[str, tuple[float, dict[str, Any]]] = {}
        self._parameters: dict[str, Any] | None = None
        self._replay: dict[str, Any] | None = None
        self._alarm: dict[str, Any] | None = None
        self._has_clock = False
        self._ends: list[float] = []
        self.actions = {name: Action(self.node, name, self.lock) for name in ACTIONS}
        self._progress = self.node.create_publisher(
            msg.ReplayProgress, names.PROGRESS, PROGRESS_QOS)
        subscribe = self.node.create_subscription
        subscribe(DiagnosticArray, names.DIAGNOSTICS, self._on_diagnostics, 50)
        subscribe(msg.RingParameters, PARAMETERS_IN_FORCE, self._on_parameters, LATCHED_BY_SEVERAL)
        subscribe(msg.ReplayState, names.STATE, self._on_replay, raw_topics.LATCHED)
        self._reports = RawSubscription(self.node, names.PROGRESS, msg.ReplayProgress, depth=1000)
        subscribe(msg.RingAlarm, names.RING_ALARM, self._on_alarm, raw_topics.LATCHED)
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self._run, name=names.LIVE_PAGE, daemon=True)

    def __enter__(self) -> 'Watcher':
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
            traces, curves = self.traces, self.traces.current
            is_new = version != traces.version
            streams = {} if curves is None else curves.since(-1 if is_new else turn, self._scales)
            if not streams and not is_new:
                return None
            return {'version': traces.version, 'turn': traces.turn, 'anew': is_new,
                    'width': traces.width / 1e9, 'origin': (traces.origin or 0) / 1e6,
                    'streams': streams}

    def now(self) -> dict[str, Any]:
        """The test and the numbers of this moment."""
        with self.lock:
            shown = self.gauges.as_page(self._assumed, self.rig.probes.absent)
            curves = self.traces.current
            has_ended = shown['load'] is not None and shown['load']['is_old']
            return {'test': None if curves is None else self.session.as_page(curves, self._scales),
                    'gauges': shown, 'ended': self.traces.newest / 1e6 if has_ended else 0}

    def state(self) -> dict[str, Any]:
        """The state of the page without the streams and the values of each sample."""
        now = time.monotonic()
        missing = self._missing(now)
        with self.lock:
            health = [
                {'name': name, **(status if now - heard <= SILENT else {
                    'level': 'silent', 'words': 'Ended with its replay' if any(
                        abs(heard - left) < SILENT for left in self._ends) else 'Node offline'})}
                for name, (heard, status) in sorted(self._health.items())]
            alarm = session.with_link(self._alarm, health)
            if alarm is not None:
                alarm['taken_back'] = self.session.current.alarm.taken_back
            return {
                'full_load': self.rig.full_scale_load * self._scales['load'],
                'force_unit': self.rig.force_unit, 'health': health, 'replay': self._replay,
                'parameters': self._parameters, 'alarm': alarm, 'doubt': self._doubt,
                **self._bands, 'allowed': (alarm or {}).get('allowed') or self._bands['allowed'],
                'commands': self.commands.as_page(), 'left_out': self.traces.left_out,
                'missing': missing,
                'past': [self.session.as_page(curves, self._scales)
                         for curves in self.traces.past],
                'jobs': {name: asdict(action.job) for name, action in self.actions.items()
                         if action.job is not None}}

    def _missing(self, now: float) -> str:
        """Samples that a replay has published and that did not come; '' while more arrive."""
        has_ended = self._replay is not None and self._replay['state'] == 'finished'
        if not has_ended or now - self._received_at < LAST_SAMPLES:
            return ''
        taken = sum(flow.received for flow in self._flows.values())
        if self._counted != taken:
            tests: list[session.SeenTest] = []
            with self.lock, contextlib.suppress(LiveError):
                self._counted, self._received = taken, dict(self.traces.received)
                curves = self.traces.current
                tests = [] if curves is None else self.session.beside(curves.number)
            if curves is not None and tests:
                kept = session.messages_of(tests, curves)
                self._received |= {name: len(kept[topic.name]) for name, topic in RIG.items()}
        due = {name: self._published.get(self._flows[name].topic, 0) for name in self._received}
        return missing_words(self._received, due)

    def test(self, number: int) -> dict[str, Any] | None:
        """All curves of an earlier test, as `rows` gives them; None if it is not kept."""
        with self.lock:
            for curves in self.traces.past:
                if curves.number == number:
                    return {'width': curves.width / 1e9, 'origin': curves.origin / 1e6,
                            'streams': curves.since(-1, self._scales)}
        return None

    def bag(self, number: int) -> bytes | None:
        """The rig's messages of a test as an MCAP file; None if the test is not kept."""
        with self.lock:
            shown = next((curves for curves in (*self.traces.past, self.traces.current)
                          if curves is not None and curves.number == number), None)
            if shown is None:
                return None
            tests, elevation = self.session.beside(number), self._elevation
        facts = TestMetadata(
            elevation_deg=None if math.isnan(elevation) else math.degrees(elevation),
            run=tests[0].name, details={'rig_hash': self.rig.digest})
        return session.mcap_of(session.messages_of(tests, shown), facts)

    def clear(self) -> None:
        with self.lock:
            self.traces.clear()

    # --- hearing ---

    def _run(self) -> None:
        polled = reviewed = reported = 0.0
        while not self._stop.is_set() and self.context.ok():
            try:
                self._executor.spin_once(timeout_sec=POLL / 2)
                for _ in range(CALLBACKS):
                    self._executor.spin_once(timeout_sec=0.0)
            except Exception as problem:  # one bad message must not end the page
                self.node.get_logger().error(f'not understood: {problem}',
                                             throttle_duration_sec=5.0)
            now = time.monotonic()
            if now - polled >= POLL:
                polled = now
                for name, flow in self._flows.items():
                    messages = flow.take()
                    if messages:
                        with contextlib.suppress(CdrError), self.lock:
                            self._take(name, messages)
                # Every node reports a thousand times a second; the last report of each counts.
                last = {report[:NODE_NAME]: report for report in self._reports.take()}
                for report in last.values():
                    with contextlib.suppress(RMWError), self.lock:
                        said = deserialize_message(report, msg.ReplayProgress)
                        self._published.update(
                            zip(said.outputs, map(int, said.published), strict=False))
                for action in self.actions.values():
                    action.look_after()
            if now - reported >= REPORT and self._replay is not None:
                reported = now
                self._report([flow for flow in self._flows.values() if flow.reliable])
            if now - reviewed >= REVIEW:
                reviewed = now
                self._review(now)

        if self._replay is not None and self.context.ok():
            self._report([])  # the page leaves: nobody waits for it

    def _report(self, flows: list[RawSubscription]) -> None:
        self._progress.publish(progress_of(f'{names.LIVE_PAGE}_{os.getpid()}', flows, []))

    def _review(self, now: float) -> None:
        """Fit the subscriptions to their publishers; what is allowed; who ended with a replay."""
        for flow in self._flows.values():
            flow.review()
        with self.lock:
            if self._replay is not None and self._has_clock \
                    and not self.node.count_publishers(names.STATE):
                self._ends.append(now)
                self._has_clock = False
                if self._replay['state'] != 'finished':
                    self._replay |= {'state': 'stopped', 'waiting_for': []}
            # Noise of the drawn means of the residual [um, urad]; None while they are too few.
            means = self.traces.means('residual')
            count = means.shape[1]
            self._bands['band'] = [None if count < MIN_MEANS else
                                   _finite(1e6 * white_noise(channel, min(BAND_LAG, count // 6)))
                                   for channel in means]
            # What a sound ring may do, anew if parameters or elevation are others.
            key = self._contact, self._elevation
            if self._contact is None or math.isnan(self._elevation) or key == self._sound_for:
                return
            self._sound_for = self._contact, self._elevation
            motion = sound_motion(self.rig, *self._sound_for)
            motion = 1e6 * (motion - motion[:, :1])
            self._bands['range'] = [[_finite(row.min()), _finite(row.max())] for row in motion]
            self._bands['allowed'] = [
                _finite(1e6 * value) for value in materiality(self.rig, *self._sound_for)]

    def _take(self, name: str, messages: list[bytes]) -> None:
        topic = RIG.get(name)
        if topic is None:
            batch = decode_displacements(messages)
            self._draw(name, batch.stamps, batch.channels)
            if not math.isnan(batch.elevations[-1]):
                self._elevation = float(batch.elevations[-1])
            if name == 'residual':
                self._doubt = doubt_words(batch.validity)
            return
        samples = decode_samples(messages if name == 'load' else messages[-1:], topic)
        if name == 'load':
            self._draw(name, samples.stamps, samples.values[None, :])
        self._flows[name].last_stamp = int(samples.stamps[-1])
        self.gauges.push(name, float(samples.values[-1]), samples.low, samples.high)
        self.session.keep(topic.name, messages)

    def _draw(self, name: str, stamps: NDArray[np.int64], values: NDArray[np.float64]) -> None:
        """Draw samples (C, N); any stream may be the first that comes of a test."""
        self._flows[name].last_stamp = int(stamps[-1])
        self.traces.push(name, stamps, values)
        self._received_at = time.monotonic()
        playing = self._replay is not None and self._replay['state'] not in ('finished', 'stopped')
        self.session.follow(self.traces.number, self._bag if playing else '')

    def _on_diagnostics(self, message: DiagnosticArray) -> None:
        now = time.monotonic()
        with self.lock:
            for status in message.status:
                if names.is_of_another_rig(status.name, self._namespace):
                    continue
                level = LEVELS[min(status.level[0], 3)]
                self._health[status.name] = (now, {'level': level, 'words': status.message})
                for figure in status.values:
                    if figure.key == ELEVATION_KEY:
                        with contextlib.suppress(ValueError):
                            self._assumed = float(figure.value)

    def _on_parameters(self, message: msg.RingParameters) -> None:
        if not message.applied_by:
            return  # only offered
        try:
            parameters = parameters_from_message(message)
        except SaddleringError:
            return
        contact = parameters.contact
        rows = [
            *([name, quantity(float(getattr(contact, name)), PARAMETER_UNITS[name])]
              for name in PARAMETER_NAMES),
            *([name, quantity(stiffness, 'N/mm^n')]
              for name, stiffness in stiffnesses_per_millimetre(vars(contact)).items()),
            *effect_rows(parameters.effects)]
        with self.lock:
            self._contact = contact
            self._parameters = {'source': str(message.source), 'rows': rows}

    def _on_replay(self, message: msg.ReplayState) -> None:
        start, end = to_stamp(message.start), to_stamp(message.end)
        share = (to_stamp(message.now) - start) / max(end - start, 1)
        words = ('waiting', 'playing', 'paused', 'finished')[min(message.state, 3)]
        with self.lock:
            self._bag, self._has_clock = Path(message.bag).name, True
            if words != 'finished':
                self.traces.begin(start, end)
            self._replay = {'state': words, 'share': min(max(share, 0.0), 1.0),
                            'speed': round(float(message.speed), 1),
                            'waiting_for': list(message.waiting_for)}

    def _on_alarm(self, message: msg.RingAlarm) -> None:
        shown = session.alarm_as_page(message)
        with self.lock:
            self._alarm = shown
            self.session.hear(message, filter(None, (*self.traces.past, self.traces.current)))


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


def _finite(value: float) -> float | None:
    return round(value, 5) if np.isfinite(value) else None
