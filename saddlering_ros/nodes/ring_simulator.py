"""Node ring_simulator: the load in, the simulated displacement of the ring out, stamp by stamp."""

import math
import time

from geometry_msgs.msg import WrenchStamped
import numpy as np
from std_srvs.srv import Trigger

from saddlering_interfaces.msg import RingDisplacement, RingExpected, RingParameters, ZeroRequest
from saddlering_ros.bags.wire import encode_displacements
from saddlering_ros.doubts.comparison import refuse_parameters_of_other_rig
from saddlering_ros.errors import counted, SaddleringError
from saddlering_ros.monitoring.expected import ExpectedMotion
from saddlering_ros.nodes.ring_displacement import FLUSH_AFTER as GUARD_FLUSH_AFTER
from saddlering_ros.record.batches import Displacements
from saddlering_ros.record.residual import SimulationStream
from saddlering_ros.record.topics import LOAD, LOAD_TOPIC
from saddlering_ros.rig import (
    beyond_bounds,
    parameter_file,
    ParameterSet,
    ParameterSource,
    TRUE_TO_SCALE,
)
from saddlering_ros.ros import diagnostics, messages, names, raw_topics, rig_state, streaming_node
from saddlering_ros.ros import parameters as node_parameters
from saddlering_ros.ros.diagnostics import ERROR, OK, TaskStatus, WARN
from saddlering_ros.ros.names import NodeError, PARAMETERS_IN_FORCE
from saddlering_ros.ros.parameters import NodeParameter, refuse_other_rig
from saddlering_ros.ros.raw_topics import LATCHED, PROMISED_QOS, RawPublisher, RawSubscription

ASSUMED_ELEVATION_DEG = 50.0  # of most shipped bags; a warning states it
FUTURE_NS = 60_000_000_000
"""Parameters stamped later than this from now [ns] are refused."""

FLUSH_AFTER = 0.02
"""Time [s] without data after which held samples are simulated."""


class RingSimulatorNode(streaming_node.StreamingNode):
    """One simulated state per load sample on /ring/simulated_displacement, same stamp."""

    PARAMETERS = (
        streaming_node.INPUT_RELIABILITY, streaming_node.MAX_GAP, node_parameters.TRUST_RIG,
        NodeParameter('parameters_file', '', 'file of contact parameters and effects, from '
                      '`saddlering identify --out` (or pass the file by --params-file); none: the '
                      'true-to-scale values'),
        NodeParameter('follow_parameters', False, 'use parameters that are offered on '
                      '/ring/parameters (the simulation then restarts)'),
        NodeParameter('bag', '', 'a bag whose elevation is used, unless elevation_deg is given'),
        NodeParameter('elevation_deg', math.nan, 'elevation of the load [deg]; nan: that of the '
                      'bag, else that of rig/elevation, else 50', low=-10.0, high=90.0,
                      nan_allowed=True, while_inactive=True),
        NodeParameter(
            'max_step', 1e-3, 'longest time step of the integration [s]', low=1e-6, high=0.1),
        streaming_node.DISPLACEMENT_FRAME,
    )

    def __init__(self) -> None:
        super().__init__('ring_simulator')
        self._watch = rig_state.ElevationWatch(self, self._on_elevation)
        self._elevation, self._elevation_source = math.nan, ''
        self._given = node_parameters.given_sections(self, ('contact', 'effects', 'source'))
        self._arrivals = streaming_node.Arrivals()
        self._refused, self._parameters_stamp = '', 0
        self.offer(Trigger, '~/restart', self._on_restart)
        self.offer(Trigger, '~/zero', self._on_zero)
        self.create_subscription(ZeroRequest, names.ZERO_REQUEST, self._on_zero_request,
                                 raw_topics.ZERO_QOS)
        self._in_force: ParameterSet | None = None
        self._offered: RingParameters | None = None
        self._doubtful = ''
        self._teller = self.create_publisher(RingParameters, PARAMETERS_IN_FORCE, LATCHED)
        self._in_force_message = RingParameters()
        self._expected: ExpectedMotion | None = None
        self._expectation = self.create_publisher(RingExpected, names.EXPECTED, PROMISED_QOS)
        if self.settings['follow_parameters']:
            self.create_subscription(RingParameters, PARAMETERS_IN_FORCE, self._on_parameters,
                                     raw_topics.LATCHED_BY_SEVERAL)

    def configure(self) -> None:
        """Read parameters and elevation; compile and make the simulation."""
        path = self.settings['parameters_file']
        if path and self._given:
            raise NodeError(f'{self.get_name()}: parameters_file and {next(iter(self._given))}.* '
                            'are both given: give one of them')
        if path:
            chosen = parameter_file.read_parameters(path)
        elif self._given:
            chosen = parameter_file.parameters_from_mapping(
                self._given, f'parameters of {self.get_name()}')
        else:
            chosen = ParameterSet(
                TRUE_TO_SCALE, source=ParameterSource(method='default', note='true to scale'))
        refuse_other_rig(self, refuse_parameters_of_other_rig, chosen, self._rig)
        bag = self.settings['bag']
        self._started_with = math.nan
        if bag and math.isnan(self.settings['elevation_deg']):
            from saddlering_ros.bags.reader import read_raw, usable_facts
            record = read_raw(bag, [LOAD_TOPIC])
            stated = usable_facts(record.path, record.facts, None, None).elevation_deg
            self._started_with = math.nan if stated is None else math.radians(stated)
        self._take_elevation()
        self._make(chosen)
        self._in_force = chosen  # from now on, news of the elevation start it anew
        # Load the compiled kernels before the first sample needs them.
        from saddlering_ros.ring.simulator import simulate
        times = [0.001 * step for step in range(10)]
        simulate(self._rig, self._in_force, self._elevation, times, [self._rig.preload] * 10)
        self._tell_in_force()
        self._stream_task = diagnostics.StreamTask(LOAD_TOPIC)
        self._failed_steps = 0
        self.tasks = [
            diagnostics.FunctionTask('zero', self._zero_status), self._stream_task,
            diagnostics.FunctionTask('solver', self._solver_status),
            diagnostics.FunctionTask('parameters', self._parameters_status),
            diagnostics.FunctionTask('elevation', self._elevation_status), self._agreement,
            self.sources(),
            self.events(lambda: vars(self._stream.guard.counters) | vars(self._stream.counters),
                        ('reordered',), lambda: [self._stream.guard])]

    def connect(self) -> None:
        self.inputs = [RawSubscription(self, LOAD.relative, WrenchStamped, task=self._stream_task,
                                       reliability=self.settings['input_reliability'])]
        self.outputs = [RawPublisher(self, names.SIMULATED, RingDisplacement)]
        self._on_elevation()
        offered, self._offered = self._offered, None
        if offered is not None:
            self._follow(offered)

    def _take_elevation(self) -> bool:
        """Settle the elevation to simulate at; whether it is another than before."""
        before, known_by = self._elevation, self._elevation_source
        self._elevation, self._elevation_source = self._watch.resolve(
            math.radians(self.settings['elevation_deg']), self._started_with)
        if math.isnan(self._elevation):
            self._elevation = math.radians(ASSUMED_ELEVATION_DEG)
            self._elevation_source = 'assumed'
            if known_by != 'assumed':
                self.get_logger().warning(
                    f'no elevation_deg and no bag: {ASSUMED_ELEVATION_DEG:g} deg is assumed')
        return self._elevation != before

    def _on_elevation(self) -> None:
        """Simulate at an elevation that the bag or the inclinometer reports, if it counts."""
        before = self._elevation_source
        if self._in_force is None or not self._take_elevation():
            return
        stream = self._stream
        gave = abs(self._elevation - stream.zero_elevation)
        words = f'elevation {math.degrees(self._elevation):.3f} deg, {self._elevation_source}'
        if self._elevation_source == before == 'measured' and gave <= rig_state.SAME_MEASURED:
            stream.turn(self._elevation)
            self._tell_in_force()
            if gave > rig_state.MOVED:
                self.get_logger().warning(f'{words}: it is followed, and the zero stays')
            return
        self._make(self._in_force, stream.hold)
        self._tell_in_force()
        self.get_logger().info(f'{words}: restarts')

    def _make(self, parameters: ParameterSet, hold: int = 0) -> None:
        """Simulate anew; samples are held back for `hold` [ns]."""
        self._stream = SimulationStream(
            self._rig, parameters, self._elevation, max_step=self.settings['max_step'],
            max_gap=self.settings['max_gap'])
        self._stream.hold = hold
        told, self._doubtful = self._doubtful, beyond_bounds(
            parameters.contact, self._rig.bounds)
        if self._doubtful not in ('', told):
            self.get_logger().warning(self._doubtful)

    def _tell_in_force(self) -> None:
        """Publish the parameters in use on /ring/parameters, latched for late joiners."""
        assert self._in_force is not None
        message = messages.parameters_to_message(self._in_force, self.get_clock().now().to_msg())
        message.applied_by = self.get_fully_qualified_name()
        message.elevation, message.rig_hash = self._elevation, self._agreement.digest
        self._teller.publish(message)
        self._in_force_message, self._expected = message, None

    def process_batch(self) -> None:
        load = self.inputs[0].take_samples(LOAD)
        if not len(load):
            return
        self._arrivals.note(time.monotonic())
        self._stream.recording = self._watch.recording
        if not self._watch.contradiction(self._elevation):
            self._send(self._stream.push(load))

    def at_intervals(self, now: float) -> float:
        """Simulate the samples held for late ones, after a time without data."""
        stream, arrivals = self._stream, self._arrivals
        if not stream.held and not stream.guard.holds:
            return 1.0
        if stream.guard.holds and arrivals.have_ended(now, GUARD_FLUSH_AFTER):
            self._send(stream.flush_guard())
            self._untold = True
        elif stream.held and now - arrivals.last >= FLUSH_AFTER:
            self._send(stream.flush())
            self._untold = True
        return FLUSH_AFTER / 2

    def _send(self, states: Displacements) -> None:
        if not len(states):
            return
        covariance = None
        assert self._in_force is not None
        # The motion expected at the load now, if anybody could use it.
        if self._in_force.source.covariance is not None \
                or self._expectation.get_subscription_count():
            if self._expected is None:
                self._expected = ExpectedMotion(self._rig, self._in_force, self._elevation)
            expected = self._expected.at(self._stream.load, float(states.zero_loads[-1]))
            covariance = np.zeros((4, 4))
            covariance[:3, :3] = expected.covariance
            self._expectation.publish(messages.expected_message(
                expected, int(states.stamps[-1]), self._stream.load, self._in_force_message,
                self.settings['frame_id']))
        self.outputs[0].send(encode_displacements(states, self.settings['frame_id'], covariance),
                             int(states.stamps[-1]))

    def _on_restart(self, _: Trigger.Request) -> str:
        self._stream.restart()
        return 'restarts at the next preload'

    def _on_zero(self, _: Trigger.Request) -> str:
        self.refuse_silence(self._arrivals.last, self._watch.is_paused)
        if not self._stream.newest_stamp:
            raise NodeError('no load yet: start the driver or the replay first')
        self._stream.zero_after(self._stream.newest_stamp)
        return ('restarts, zeroed at the first steady stretch from '
                f'{self._rig.force_words(self._stream.load, 2)}')

    def _on_zero_request(self, message: ZeroRequest) -> None:
        if self.active:
            self._stream.zero_after(messages.to_stamp(message.header.stamp))

    def _on_parameters(self, message: RingParameters) -> None:
        if message.applied_by:
            return
        stamp = messages.to_stamp(message.header.stamp) or time.time_ns()
        if stamp > time.time_ns() + FUTURE_NS:
            self._refuse('its stamp lies in the future: stamp it with the present time, or 0')
        elif stamp < self._parameters_stamp:
            # Of two servers that publish here, each keeps its last for late joiners.
            self._refuse('its stamp is older than that of the parameters in force: stamp it with '
                         'the present time, or 0')
        elif not self.active:
            self._offered, self._parameters_stamp = message, stamp
        elif self._follow(message):
            self._parameters_stamp = stamp

    def _refuse(self, why: str) -> None:
        self._refused = why
        self.get_logger().error(f'/{PARAMETERS_IN_FORCE}: refused: {why}')

    def _follow(self, message: RingParameters) -> bool:
        """Start anew with the parameters of a message; whether they can be used.

        The same numbers from another source cause no restart, which costs samples and the zero.
        """
        before = self._in_force
        try:
            offered = messages.parameters_from_message(message)
            refuse_other_rig(self, refuse_parameters_of_other_rig, offered, self._rig)
            if before is None or (offered.contact, offered.effects) != (
                    before.contact, before.effects):
                self._make(offered, self._stream.hold)
        except SaddleringError as problem:
            self._refuse(str(problem))
            return False
        self._in_force, self._refused = offered, ''
        self._tell_in_force()
        self.get_logger().info(f'parameters from /{PARAMETERS_IN_FORCE}: {message.source}')
        return True

    def _elevation_status(self) -> TaskStatus:
        figures = {'elevation [deg]': f'{math.degrees(self._elevation):.3f}',
                   'source': self._elevation_source}
        wrong = self._watch.contradiction(self._elevation)
        if wrong:
            return TaskStatus(ERROR, f'nothing is simulated: {wrong}', figures)
        words = f'{math.degrees(self._elevation):.3f} deg, {self._elevation_source}'
        doubt = self._watch.doubt
        if self._elevation_source == 'measured' and self._arrivals.last > self._watch.due:
            doubt = 'the inclinometer has stopped: see to it, or give elevation_deg'
        if doubt:
            return TaskStatus(WARN, f'{doubt} (simulated: {words})', figures)
        gave = self._elevation - self._stream.zero_elevation
        if abs(gave) > rig_state.MOVED:
            return TaskStatus(WARN, f'has moved by {math.degrees(gave):+.3f} deg since the zero, '
                              'and is followed: see to the elevating gear', figures)
        if self._elevation_source == 'assumed':
            return TaskStatus(WARN, f'{ASSUMED_ELEVATION_DEG:g} deg is assumed: '
                              'give elevation_deg', figures)
        return TaskStatus(OK, words, figures)

    def _zero_status(self) -> TaskStatus:
        stream = self._stream
        return rig_state.zero_status(self._rig, stream.simulator.zero, stream.zero_stamp,
                                     stream.newest_stamp, stream.load)

    def _solver_status(self) -> TaskStatus:
        simulator = self._stream.simulator
        failed = simulator.failed_steps
        new, self._failed_steps = failed - self._failed_steps, failed
        figures = {'iterations': str(simulator.iterations), 'not converged': str(failed)}
        if new > 0:
            return TaskStatus(ERROR, f'{counted(new, "step")} did not converge, not published: '
                              'check load and parameters', figures)
        return TaskStatus(OK, 'converges', figures)

    def _parameters_status(self) -> TaskStatus:
        message = self._in_force_message
        figures = {name: f'{getattr(message, name):.6g}' for name in messages.FIELDS}
        figures.update(zip(message.effect_parameter_names,
                           (f'{value:.6g}' for value in message.effect_parameter_values),
                           strict=True))
        figures['elevation [deg]'] = f'{math.degrees(self._elevation):.3f}'
        if self._refused:
            return TaskStatus(WARN, f'refused: {self._refused}', figures)
        if self._doubtful:
            return TaskStatus(WARN, self._doubtful, figures)
        return TaskStatus(OK, message.source, figures)


main = streaming_node.executable(RingSimulatorNode)

if __name__ == '__main__':
    main()
