"""Node ring_alarm: raises an alarm during a test if the ring no longer behaves like its model."""

from __future__ import annotations

from collections.abc import Sequence

from geometry_msgs.msg import WrenchStamped
from std_msgs.msg import Bool
from std_srvs.srv import Trigger

from saddlering_interfaces.msg import RingAlarm, RingDisplacement, RingParameters
from saddlering_ros.bags.messages import decode_displacements
from saddlering_ros.errors import SaddleringError
from saddlering_ros.monitoring import ALARM, LEARNING, MonitorSettings, WAITING
from saddlering_ros.monitoring.monitor import alarm_words, state_words
from saddlering_ros.monitoring.noise import DEFAULT_PERCENT
from saddlering_ros.monitoring.stream import AlarmStream
from saddlering_ros.record import LOAD_TOPIC
from saddlering_ros.record.samples import no_displacements, no_samples
from saddlering_ros.record.topics import LOAD
from saddlering_ros.ros.diagnostics import (
    ERROR,
    Events,
    Finding,
    FunctionTask,
    OK,
    SourcesTask,
    StreamTask,
    WARN,
)
from saddlering_ros.ros.messages import alarm_message, parameters_from_message
from saddlering_ros.ros.names import PARAMETERS_IN_FORCE, RESIDUAL, RING_ALARM, WITHIN_LIMITS
from saddlering_ros.ros.parameters import declare_rig, NodeParameter
from saddlering_ros.ros.raw_topics import LATCHED, LATCHED_BY_SEVERAL, RawSubscription
from saddlering_ros.ros.rig_state import RigAgreement
from saddlering_ros.ros.streaming_node import (
    INPUT_RELIABILITY,
    leave,
    run_streaming,
    StreamingNode,
)

HEARTBEAT = 0.1
"""ring/within_limits is repeated this often [s], so that its silence can be noticed."""

NOTHING = (-1, False)
"""State before the first publication: changes of the monitor, parameters known."""

RECENT_NS = 10_000_000_000
"""A lapse that is over is a warning for so long [ns], by the stamps."""


class RingAlarmNode(StreamingNode):
    """Watches the residual; publishes a latched alarm, and a limit for an interlock."""

    PARAMETERS = (
        INPUT_RELIABILITY,
        NodeParameter(
            'false_alarm_hours', 1000.0, 'hours of testing in which one false alarm is '
            'allowed in the mean', low=1.0, high=1e6, while_inactive=True),
        NodeParameter(
            'materiality', DEFAULT_PERCENT, 'residual without an alarm, in percent of the '
            "channel's range from preload to full scale", low=0.0, high=100.0,
            while_inactive=True),
        NodeParameter(
            'block', 0.02, 'time [s] over which residuals are averaged before they are judged',
            low=0.001, high=10.0, while_inactive=True),
        NodeParameter('frame_id', 'ring', 'frame of the alarm: reference point C of the ring'),
    )

    def __init__(self) -> None:
        super().__init__('ring_alarm')
        self._rig = declare_rig(self)
        self._agreement = RigAgreement(self, self._rig)
        self._stream = self._make()
        self._offered: RingParameters | None = None
        self._published, self._latched = NOTHING, False
        self._beaten = 0.0
        self._teller = self.create_publisher(RingAlarm, RING_ALARM, LATCHED)
        self._limit = self.create_publisher(Bool, WITHIN_LIMITS, LATCHED)
        self.create_service(Trigger, '~/reset', self._on_reset)
        self.create_subscription(RingParameters, PARAMETERS_IN_FORCE, self._on_parameters,
                                 LATCHED_BY_SEVERAL)

    def configure(self) -> None:
        """Make the monitor and its diagnostics; an earlier alarm is cleared."""
        self._stream = self._make()
        self._published, self._latched = NOTHING, False
        if self._offered is not None:
            self._use(self._offered)
        self._streams = [StreamTask(f'/{RESIDUAL}'), StreamTask(LOAD_TOPIC)]
        self.tasks = [FunctionTask('alarm', self._alarm_finding),
                      FunctionTask('promise', self._promise_finding), *self._streams,
                      self._agreement, SourcesTask(self.sources), Events(self._events)]
        self._tell_state()

    def _given(self) -> tuple[float, float, float]:
        return (self.settings['block'], self.settings['false_alarm_hours'],
                self.settings['materiality'])

    def _make(self) -> AlarmStream:
        self._made_with = self._given()
        block, hours, percent = self._made_with
        return AlarmStream(self._rig, MonitorSettings(block, hours), percent)

    def connect(self) -> None:
        """Subscribe to residual and load; settings changed meanwhile count from now on."""
        if self._given() != self._made_with:
            alarm = self._stream.monitor.alarm
            self._stream = self._make()
            self._stream.monitor.alarm = alarm
            if self._offered is not None:
                self._use(self._offered)
            self._published = NOTHING
            self._tell_state()
        wanted = self.settings['input_reliability']
        self.inputs = [
            RawSubscription(self, RESIDUAL, RingDisplacement, reliability=wanted),
            RawSubscription(self, LOAD.relative, WrenchStamped, reliability=wanted)]

    def process_batch(self) -> None:
        """Process one batch of either topic, and publish the changes."""
        residual = self.inputs[0].take_as(decode_displacements)
        load = self.inputs[1].take_samples(LOAD)
        for flow, task, stamps in zip(self.inputs, self._streams,
                                      (residual.stamps, load.stamps), strict=True):
            if len(stamps):
                flow.last_stamp = int(stamps[-1])
                task.push(stamps)
        self._stream.push(residual, load)
        self._tell_state()

    def at_intervals(self, now: float) -> float:
        """Repeat the limit."""
        if now - self._beaten >= HEARTBEAT:
            self._beaten = now
            self._limit.publish(Bool(data=self._stream.monitor.alarm is None))
        return HEARTBEAT / 2

    def _tell_state(self) -> None:
        """Publish the state if it has changed; the limit at once with it."""
        monitor = self._stream.monitor
        news = (monitor.changes, self._stream.knows_parameters)
        if news == self._published:
            return
        rose = monitor.alarm is not None and not self._latched
        self._published, self._latched = news, monitor.alarm is not None
        self._limit.publish(Bool(data=monitor.alarm is None))
        self._teller.publish(alarm_message(monitor, self._words(), self.settings['frame_id']))
        if rose and monitor.alarm is not None:
            self.get_logger().error(alarm_words(monitor.alarm))

    def _words(self) -> str:
        if not self._stream.knows_parameters:
            return ('waiting for ring/parameters: start ring_simulator, which publishes what it '
                    'simulates with')
        return state_words(self._stream.monitor)

    def _on_reset(self, request: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        monitor = self._stream.monitor
        had = monitor.alarm
        monitor.reset()
        response.success = True
        response.message = ('there was no alarm; the evidence restarts' if had is None else
                            f'the alarm of {had.channel} is reset; the evidence restarts')
        self._tell_state()
        return response

    def _on_parameters(self, message: RingParameters) -> None:
        if not message.applied_by:
            return  # only offered
        self._offered = message
        self._use(message)
        self._stream.push(no_displacements(), no_samples())
        self._tell_state()

    def _use(self, message: RingParameters) -> None:
        try:
            self._stream.use(parameters_from_message(message).contact)
        except SaddleringError as problem:
            self.get_logger().error(str(problem))

    def _alarm_finding(self) -> Finding:
        monitor = self._stream.monitor
        figures = {
            'log evidence': f'{monitor.log_evidence:.2f}',
            'log threshold': f'{monitor.log_threshold:.2f}',
            'watched [s]': f'{monitor.seconds:.1f}', 'waiting': str(self._stream.waiting),
            'materiality [um, um, urad]': ', '.join(
                f'{1e6 * value:.3f}' for value in monitor.materiality.tolist())}
        level = {ALARM: ERROR, WAITING: WARN, LEARNING: OK}.get(monitor.state, OK)
        return Finding(level, self._words(), figures)

    def _promise_finding(self) -> Finding:
        monitor = self._stream.monitor
        lapses = [lapse for lapse in monitor.lapses
                  if lapse.is_lasting or monitor.stamp - lapse.stamp < RECENT_NS]
        figures = {'lapses': str(len(monitor.lapses)),
                   'false alarm hours': f'{self.settings["false_alarm_hours"]:g}'}
        if lapses:
            return Finding(WARN, lapses[-1].reason, figures)
        return Finding(OK, 'at most one false alarm in '
                       f'{self.settings["false_alarm_hours"]:g} h of testing', figures)

    def _events(self) -> dict[str, int]:
        return {**self._stream.counters.as_dict(),
                'malformed': sum(flow.malformed for flow in self.inputs)}


def main(args: Sequence[str] | None = None) -> None:
    """Run the node."""
    leave(run_streaming(RingAlarmNode, args))


if __name__ == '__main__':
    main()
