"""Node ring_alarm: raises an alarm during a test if the ring no longer behaves like its model."""

import time

from geometry_msgs.msg import WrenchStamped
from rclpy.lifecycle import LifecycleState, TransitionCallbackReturn
from std_msgs.msg import Bool
from std_srvs.srv import Trigger

from saddlering_interfaces.msg import ReplayState, RingAlarm, RingDisplacement, RingParameters
from saddlering_ros.bags.wire import decode_displacements
from saddlering_ros.errors import SaddleringError
from saddlering_ros.monitoring import DEFAULT_PERCENT, stream
from saddlering_ros.monitoring.monitor import MonitorSettings, state_words
from saddlering_ros.record.batches import no_displacements, no_samples
from saddlering_ros.record.guard import load_limits, SampleGuard
from saddlering_ros.record.topics import LOAD, LOAD_TOPIC
from saddlering_ros.ros import diagnostics, names, streaming_node
from saddlering_ros.ros.diagnostics import ERROR, OK, TaskStatus, WARN
from saddlering_ros.ros.messages import alarm_message, parameters_from_message
from saddlering_ros.ros.parameters import NodeParameter
from saddlering_ros.ros.raw_topics import LATCHED, LATCHED_BY_SEVERAL, LIMIT_QOS, RawSubscription

HEARTBEAT = 0.1
"""ring/within_limits is repeated this often [s], so that its silence can be noticed."""

LOOK = 0.02
"""Period [s] at which missing streams are looked for."""

SOUGHT_FOR = 5.0
"""After the watch has been blind, the streams above the residual are heard for so long [s]."""

SILENT = 0.4
"""A stream above the residual is missing if nothing has come for so long [s]."""

WAITING, ALARM, BLIND = RingAlarm.WAITING, RingAlarm.ALARM, RingAlarm.BLIND
"""States of the node; those of the monitor have the same numbers, 0 to 3."""

RECENT_NS = 10_000_000_000
"""A lapse that is over is a warning for so long [ns], by the stamps."""


class RingAlarmNode(streaming_node.StreamingNode):
    """Watches the residual; publishes a latched alarm, and a limit for an interlock."""

    PARAMETERS = (
        streaming_node.INPUT_RELIABILITY, streaming_node.DISPLACEMENT_FRAME,
        NodeParameter('false_alarm_hours', 1000.0, 'hours of testing in which one false alarm is '
                      'allowed in the mean', low=1.0, high=1e6, while_inactive=True),
        NodeParameter(
            'materiality', DEFAULT_PERCENT, 'residual without an alarm, in percent of the '
            "channel's range from preload to full scale", low=0.0, high=100.0,
            while_inactive=True),
        NodeParameter(
            'block', 0.02, 'time [s] over which residuals are averaged before they are judged',
            low=0.001, high=10.0, while_inactive=True),
    )

    def __init__(self) -> None:
        super().__init__('ring_alarm')
        self._offered: RingParameters | None = None
        self._sight = stream.Sight()
        self._upstream: dict[str, tuple[RawSubscription, float]] = {}
        self._sought_at = 0.0
        self._lacks = stream.SEEN
        self._logged = BLIND  # as a node is before it is active
        self._beaten = self._looked = 0.0
        self._make()
        self._teller = self.create_publisher(RingAlarm, names.RING_ALARM, LATCHED)
        self._limit = self.create_publisher(Bool, names.WITHIN_LIMITS, LIMIT_QOS)
        self.create_service(Trigger, '~/reset', self._on_reset)
        self.create_subscription(RingParameters, names.PARAMETERS_IN_FORCE, self._on_parameters,
                                 LATCHED_BY_SEVERAL)
        self.create_subscription(ReplayState, names.STATE, self._on_replay, LATCHED)

    def configure(self) -> None:
        """Make the monitor and its diagnostics; an earlier alarm is cleared."""
        self._sight = stream.Sight()
        self._make()
        self._streams = [diagnostics.StreamTask(topic)
                         for topic in (f'/{names.RESIDUAL}', LOAD_TOPIC)]
        self.tasks = [diagnostics.FunctionTask('alarm', self._alarm_status),
                      diagnostics.FunctionTask('promise', self._promise_status), *self._streams,
                      self._agreement, self.sources(),
                      self.events(lambda: self._stream.counters)]
        self._tell_state()

    def _given(self) -> tuple[float, float, float]:
        return (self.settings['block'], self.settings['false_alarm_hours'],
                self.settings['materiality'])

    def _make(self) -> None:
        """Watch anew, with the settings and the parameters that count now."""
        self._made_with = block, hours, percent = self._given()
        self._stream = stream.AlarmStream(self._rig, MonitorSettings(block, hours), percent)
        self._guard = SampleGuard(load_limits(self._rig))
        self._published: tuple[object, ...] = ()
        if self._offered is not None:
            self._use(self._offered)

    def connect(self) -> None:
        """Subscribe to residual and load; settings changed meanwhile count from now on."""
        if self._given() != self._made_with:
            alarm = self._stream.monitor.alarm
            self._make()
            self._stream.monitor.alarm = alarm
        kinds = {names.RESIDUAL: RingDisplacement, LOAD.relative: WrenchStamped}
        self.inputs = [
            RawSubscription(self, topic, kind, reliability=self.settings['input_reliability'],
                            task=task)
            for (topic, kind), task in zip(kinds.items(), self._streams, strict=True)]

    def process_batch(self) -> None:
        residual = self.inputs[0].take_as(decode_displacements)
        load = self._guard.push(self.inputs[1].take_samples(LOAD))
        now = time.monotonic()
        self._sight.hear_load(load.stamps, now)
        self._sight.hear_residual(residual.stamps, residual.channels[:3], now)
        self._stream.push(residual, load)
        self._tell_state()

    def at_intervals(self, now: float) -> float:
        """Look for missing streams; repeat the limit."""
        if now - self._looked >= LOOK:
            self._looked = now
            # While blind, hear what comes of both displacements, so that the missing one is named.
            if self._lacks in (stream.NO_RESIDUAL, stream.NO_CHANNEL):
                self._sought_at = now
                for topic in (names.DISPLACEMENT, names.SIMULATED):
                    if topic not in self._upstream:
                        flow = RawSubscription(self, topic, RingDisplacement, depth=1,
                                               reliability='best_effort')
                        self._upstream[topic] = flow, now
            elif now - self._sought_at > SOUGHT_FOR:
                self._end_search()
            for topic, (flow, heard) in self._upstream.items():
                self._upstream[topic] = flow, now if flow.take() else heard
            self._tell_state()
        if now - self._beaten >= HEARTBEAT:
            self._beaten = now
            self._limit.publish(Bool(data=self._within_limits()))
        return HEARTBEAT / 2

    def _end_search(self) -> None:
        for flow, _ in self._upstream.values():
            flow.close()
        self._upstream = {}

    def on_deactivate(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Stop watching; from then on nothing is within limits, for late joiners too."""
        result = super().on_deactivate(state)
        self._end_search()
        self._lacks = stream.SEEN
        self._tell_state()
        return result

    def _state(self) -> int:
        monitor = self._stream.monitor
        if monitor.state == ALARM:
            return ALARM
        waits = monitor.state == WAITING and not self._sight.load_stamp
        lacks = bool(self._lacks) and not waits
        return BLIND if lacks or not self.active or monitor.unwatched else monitor.state

    def _within_limits(self) -> bool:
        return (not self._lacks and self._stream.knows_parameters
                and self._state() not in (ALARM, BLIND))

    def _missing(self) -> list[str]:
        """Full names of the topics that are missing or late."""
        lacks, now = self._lacks, time.monotonic()
        if not lacks:
            return []
        if lacks == stream.NO_LOAD:
            return [self.resolve_topic_name(LOAD.relative)]
        silent = [topic for topic, (_, heard) in self._upstream.items() if now - heard > SILENT]
        is_residual = lacks != stream.NO_RESIDUAL or not silent
        return [self.resolve_topic_name(topic)
                for topic in ([names.RESIDUAL] if is_residual else silent)]

    def _tell_state(self) -> None:
        """Publish the state if it has changed; the limit at once with it."""
        self._lacks = self._sight.lacks(time.monotonic()) if self.active else stream.SEEN
        monitor, missing = self._stream.monitor, self._missing()
        is_within = self._within_limits()
        news = (monitor.changes, self._stream.knows_parameters, self._state(), is_within,
                self._lacks, *missing)
        if news == self._published:
            return
        self._published = news
        self._limit.publish(Bool(data=is_within))
        message = alarm_message(monitor, self._words(), self.settings['frame_id'])
        message.state, message.missing = self._state(), missing
        self._teller.publish(message)
        if message.state != self._logged:  # The figures of an alarm change, and are not news.
            self._logged = message.state
            words, logger = f'{names.STATE_TOLD}{message.message}', self.get_logger()
            if message.state == ALARM:
                logger.error(words)
            elif message.state == BLIND:
                logger.warning(words)
            else:
                logger.info(words)

    def _words(self) -> str:
        monitor, lacks = self._stream.monitor, self._lacks
        if monitor.state != ALARM and self._state() == BLIND:
            if not self.active:
                return 'BLIND: ring_alarm is not active: nothing is watched'
            lag = 1e-9 * (self._sight.load_stamp - self._sight.residual_stamp)
            return stream.blind_words(lacks, self._missing(), lag) if lacks else (
                f'BLIND: {monitor.unwatched}')
        if not self._stream.knows_parameters:
            return ('waiting for ring/parameters: start ring_simulator, which publishes what it '
                    'simulates with')
        return state_words(monitor)

    def _on_reset(self, request: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        had = self._stream.monitor.alarm
        self._stream.monitor.reset()
        self._tell_state()
        words = 'there was no alarm' if had is None else f'the alarm of {had.channel} is reset'
        return Trigger.Response(success=True, message=f'{words}; the evidence restarts')

    def _on_parameters(self, message: RingParameters) -> None:
        if not message.applied_by:
            return  # only offered
        self._offered = message
        self._use(message)
        self._stream.push(no_displacements(), no_samples())
        self._tell_state()

    def _on_replay(self, message: ReplayState) -> None:
        is_playing = message.state == ReplayState.PLAYING
        self._sight.hear_replay(message.rate if is_playing else 0.0, time.monotonic())

    def _use(self, message: RingParameters) -> None:
        try:
            self._stream.use(parameters_from_message(message).contact)
        except SaddleringError as problem:
            self.get_logger().error(str(problem))

    def _alarm_status(self) -> TaskStatus:
        monitor = self._stream.monitor
        figures = {
            'log evidence': f'{monitor.log_evidence:.2f}',
            'log threshold': f'{monitor.log_threshold:.2f}',
            'watched [s]': f'{monitor.seconds:.1f}', 'waiting': str(self._stream.waiting),
            'materiality [um, um, urad]': ', '.join(
                f'{1e6 * value:.3f}' for value in monitor.materiality.tolist())}
        missing = self._missing()
        if missing:
            figures['missing'] = ', '.join(missing)
        level = {ALARM: ERROR, BLIND: ERROR, WAITING: WARN}.get(self._state(), OK)
        return TaskStatus(level, self._words(), figures)

    def _promise_status(self) -> TaskStatus:
        monitor, hours = self._stream.monitor, f'{self.settings["false_alarm_hours"]:g}'
        lapses = [lapse for lapse in monitor.lapses
                  if lapse.is_lasting or monitor.stamp - lapse.stamp < RECENT_NS]
        figures = {'lapses': str(len(monitor.lapses)), 'false alarm hours': hours}
        if lapses:
            return TaskStatus(WARN, lapses[-1].reason, figures)
        return TaskStatus(OK, f'at most one false alarm in {hours} h of testing', figures)


main = streaming_node.executable(RingAlarmNode)

if __name__ == '__main__':
    main()
