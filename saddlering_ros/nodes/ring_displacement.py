"""Node ring_displacement: four probes and the load in, the measured displacement out."""

import math
import time

from geometry_msgs.msg import Quaternion, Transform, TransformStamped, Vector3, WrenchStamped
import numpy as np
from sensor_msgs.msg import Range
from std_msgs.msg import Header
from std_srvs.srv import Trigger

from saddlering_interfaces.msg import RingDisplacement, ZeroRequest
from saddlering_ros.bags.wire import encode_displacements
from saddlering_ros.doubts.driver import CLOCK_LIMIT, machine_findings, skew_findings
from saddlering_ros.doubts.wiring import wiring_findings
from saddlering_ros.errors import counted
from saddlering_ros.quantities import quantity
from saddlering_ros.record.batches import Displacements, is_pause
from saddlering_ros.record.displacement import DisplacementStream, ZeroNoise
from saddlering_ros.record.topics import LOAD, PROBES
from saddlering_ros.rig.geometry import displaced_frame
from saddlering_ros.ros import diagnostics, streaming_node
from saddlering_ros.ros.diagnostics import ERROR, OK, TaskStatus, WARN
from saddlering_ros.ros.messages import to_time
from saddlering_ros.ros.names import DISPLACEMENT, NodeError, ZERO_REQUEST
from saddlering_ros.ros.parameters import NodeParameter
from saddlering_ros.ros.raw_topics import message_class, RawPublisher, RawSubscription, ZERO_QOS
from saddlering_ros.ros.rig_state import ElevationWatch, zero_status

FLUSH_AFTER = 0.2
"""Time [s] without data after which held samples are taken."""

MAX_ROWS = 2000
"""Of more rows since the zero, in which wiring is looked for, every second one is kept."""

PARITY_SIGMAS = 5.0
"""A mean parity beyond so many times its noise is no noise: once in two million periods."""

FRAME_PERIOD = 0.02
"""Shortest time [s] from one transform on /tf to the next; viewers draw no faster."""


class DisplacedFrame:
    """Publishes the transform from the frame `parent` to that of the displaced ring on /tf."""

    def __init__(self, node: streaming_node.StreamingNode, parent: str, name: str) -> None:
        try:
            self._kind = message_class('tf2_msgs/msg/TFMessage')
        except ImportError as problem:
            raise NodeError(f'{node.get_name()}: displaced_frame_id needs the package tf2_msgs: '
                            'sudo apt install ros-jazzy-tf2-msgs, or leave it out') from problem
        self._parent, self._name = parent, name
        self._publisher = node.create_publisher(self._kind, '/tf', 100)
        self._told = 0.0

    def tell(self, batch: Displacements) -> None:
        """Publish the newest displacement, if it is known and due."""
        motion = batch.channels[:3, -1]
        if time.monotonic() - self._told < FRAME_PERIOD or np.isnan(motion).any():
            return
        self._told = time.monotonic()
        frame = displaced_frame(*motion.tolist())
        x, y, z = frame.translation
        of_x, of_y, of_z, w = frame.rotation
        self._publisher.publish(self._kind(transforms=[TransformStamped(
            header=Header(stamp=to_time(int(batch.stamps[-1])), frame_id=self._parent),
            child_frame_id=self._name, transform=Transform(
                translation=Vector3(x=x, y=y, z=z),
                rotation=Quaternion(x=of_x, y=of_y, z=of_z, w=w)))]))


class RingDisplacementNode(streaming_node.StreamingNode):
    """Aligns the probes on the load's stamps, zeroes them, publishes /ring/displacement."""

    PARAMETERS = (
        streaming_node.INPUT_RELIABILITY, streaming_node.MAX_GAP,
        streaming_node.DISPLACEMENT_FRAME,
        NodeParameter('displaced_frame_id', '', 'frame of the displaced ring, published below '
                      'frame_id on /tf (needs tf2_msgs); none: not published'),
        NodeParameter('parity_noise', 0.3e-6, 'noise of the parity [m]; a mean of more than five '
                      'times this value is reported', low=1e-9, high=1e-3, changeable=True),
        NodeParameter(
            'elevation_deg', math.nan, 'elevation of the load [deg], which every displacement '
            'carries; nan: that of the replayed bag, else that of rig/elevation', low=-10.0,
            high=90.0, nan_allowed=True, while_inactive=True),
        NodeParameter(
            'lowest_rate', 0.0, 'rate of a topic [messages/s] below which diagnostics warn',
            low=0.0, high=1e5),
    )

    def __init__(self) -> None:
        super().__init__('ring_displacement')
        self._watch = ElevationWatch(self)
        self._arrivals = streaming_node.Arrivals()
        self._awaited, self._zero_stamp, self._told_rows = 0, 0, 0
        self._given_at = -math.inf
        self.offer(Trigger, '~/zero', self._on_zero)
        self._zero_request = self.create_publisher(ZeroRequest, ZERO_REQUEST, ZERO_QOS)
        name = self.settings['displaced_frame_id']
        self._frame = DisplacedFrame(self, self.settings['frame_id'], name) if name else None

    def configure(self) -> None:
        probes = self._rig.probes
        self._topics = (LOAD, *(PROBES[number - 1] for number in probes.present))
        self._stream = DisplacementStream(self._rig, max_gap=self.settings['max_gap'])
        self._noise = ZeroNoise()
        self._parity, self._since_zero = diagnostics.Kept(), diagnostics.Kept()
        lowest = self.settings['lowest_rate']
        names = [topic.name for topic in self._topics]
        self._streams = [diagnostics.StreamTask(topic, lowest_rate=lowest) for topic in names]
        self._saturation = [diagnostics.SaturationTask(topic, probes.min_range, probes.max_range)
                            for topic in names[1:]]
        self.tasks = [
            diagnostics.FunctionTask('zero', self._zero_status),
            diagnostics.FunctionTask('probes', self._probes_status), *self._streams,
            diagnostics.FunctionTask('clocks', self._clocks_status),
            *self._saturation, diagnostics.FunctionTask('parity', self._parity_status),
            self._agreement, self.sources(),
            self.events(self._stream.events, ('reordered',), self._stream.guards)]

    def connect(self) -> None:
        wanted = self.settings['input_reliability']
        self.inputs = [
            RawSubscription(self, topic.relative, WrenchStamped if topic is LOAD else Range,
                            reliability=wanted, task=task)
            for topic, task in zip(self._topics, self._streams, strict=True)]
        self.outputs = [RawPublisher(self, DISPLACEMENT, RingDisplacement)]

    def process_batch(self) -> None:
        load, *gaps = (flow.take_samples(topic)
                       for flow, topic in zip(self.inputs, self._topics, strict=True))
        for watch, samples in zip(self._saturation, gaps, strict=True):
            watch.push(samples.values)
        now = time.monotonic()
        self._arrivals.note(now)
        self._stream.elevation, _ = self._watch.resolve(
            math.radians(self.settings['elevation_deg']))
        self._stream.recording = self._watch.recording
        rows = self._stream.rows
        self._send(self._stream.push(load, gaps, now))
        if self._stream.rows > rows:
            self._given_at = now
        awaited = self._stream.awaited(rows)
        self._awaited = self._awaited if awaited is None else awaited

    def awaited(self) -> list[RawSubscription]:
        """The topic whose sample brings the next row."""
        return self.inputs[self._awaited:self._awaited + 1]

    def at_intervals(self, now: float) -> float:
        """Take the samples that wait for successors, after a time without data."""
        if not self._stream.held:
            return 1.0
        if self._arrivals.have_ended(now, FLUSH_AFTER):
            self._send(self._stream.flush())
            self._untold = True
        return FLUSH_AFTER / 2

    def _send(self, batch: Displacements) -> None:
        if len(batch):
            if batch.zero_stamps[-1] != self._zero_stamp:
                self._zero_stamp = int(batch.zero_stamps[-1])
                self._since_zero.taken()
            for rows in self._stream.aligned:
                self._since_zero.push(np.vstack([rows.loads, rows.gaps]).ravel('F'))
            self._parity.push(batch.channels[3])
            self._noise.push(batch.zero_stamps, batch.channels)
            self.outputs[0].send(encode_displacements(batch, self.settings['frame_id'],
                                                      self._noise.covariance),
                                 int(batch.stamps[-1]))
            if self._frame is not None:
                self._frame.tell(batch)

    def _on_zero(self, _: Trigger.Request) -> str:
        self.refuse_silence(self._given_at, self._watch.is_paused)
        stamp = self._stream.newest_stamp
        if not stamp:
            raise NodeError('no aligned samples yet: start the driver or the replay first')
        self._stream.zero_after(stamp)
        self._zero_request.publish(ZeroRequest(
            header=Header(stamp=to_time(stamp), frame_id=self.settings['frame_id']),
            node=self.get_fully_qualified_name()))
        return (f'zero is taken from the first steady stretch after {stamp / 1e9:.3f} s, at '
                f'{self._rig.force_words(self._stream.load, 2)}; the simulator follows')

    def _probes_status(self) -> TaskStatus:
        since_zero = self._since_zero.taken().reshape(-1, 5)
        self._since_zero.push(since_zero[::1 + len(since_zero) // MAX_ROWS].ravel())
        absent, zero = self._rig.probes.absent, self._stream.zero
        silent = [number for number, count in enumerate(self._stream.take_missing(), 1)
                  if count and number != absent]
        missing = silent or [number for number, gap in enumerate(
            zero.reading.gaps if zero else (), 1) if math.isnan(gap) and number != absent]
        wrong = [] if missing or not len(since_zero) else wiring_findings(
            self._rig, self._stream.elevation, since_zero[:, 0], since_zero[:, 1:].T)
        if wrong:
            return TaskStatus(WARN, '; '.join(wrong))
        rows, self._told_rows = self._stream.rows - self._told_rows, self._stream.rows
        if not missing:
            return TaskStatus(OK, 'no readings in this period' if not rows else
                              'all four read' if not absent else
                              f'the other three read; probe {absent} is absent '
                              '(rig.probes.absent), parity unknown')
        if len(silent) == len(self._rig.probes.present):
            return TaskStatus(ERROR, 'no probe reads at the stamps of the load, and nothing is '
                                     'published: see to the probes, or to the clocks (status '
                                     'clocks)')
        channels = ' and '.join(sorted({'delta_x' if number % 2 else 'delta_y and gamma'
                                        for number in missing}))
        who, verb, them = (('probes ' + ' and '.join(map(str, missing)), 'do', 'them')
                           if len(missing) > 1 else (f'probe {missing[0]}', 'does', 'the probe'))
        fault, remedy = ((f'{verb} not read', f'repair {them}, then') if silent else
                         ('did not read at the zero', 'go to preload, and'))
        return TaskStatus(ERROR, f'{who} {fault}, {channels} unknown: {remedy} call ~/zero; the '
                                 'other channels continue')

    def _clocks_status(self) -> TaskStatus:
        """By arrival, as check-driver judges it; the stamps of a replay are too old for that."""
        delays = {one.topic: one.delay for one in self._streams}
        newest = int(self._streams[0].last.max(initial=0))
        is_replayed = (self.get_parameter('use_sim_time').value
                       or is_pause(self._watch.recording, newest, newest))
        if is_replayed and abs(delays[LOAD.name]) > CLOCK_LIMIT:
            delays = {}
        of_machine = machine_findings(delays)
        found = [*of_machine, *skew_findings(delays)]
        if not found:
            return TaskStatus(OK, 'no difference between load and probes is seen')
        count = len({one.where for one in found})
        more = f'; {counted(count - 1, "more topic")} likewise' if count > 1 else ''
        hint = (' (if ros2 bag play sends them: start it with --clock, and the nodes with '
                '-p use_sim_time:=true)') if of_machine else ''
        return TaskStatus(WARN, f'{found[0]}{more}{hint}')

    def _parity_status(self) -> TaskStatus:
        """Mean parity against its noise; NaN where a probe is missing."""
        parity = self._parity.taken()
        parity = parity[np.isfinite(parity)]
        if not len(parity):
            return TaskStatus(OK, 'no displacement in this period')
        mean, limit = float(parity.mean()), PARITY_SIGMAS * self.settings['parity_noise']
        figures = {'mean [um]': f'{mean * 1e6:.3f}',
                   'peak [um]': f'{float(np.abs(parity).max()) * 1e6:.3f}',
                   'limit of the mean [um]': f'{limit * 1e6:.3f}'}
        if abs(mean) > limit:
            return TaskStatus(WARN, f'{quantity(mean, "m")}, beyond noise: the readings of probes '
                                    '1 and 3 do not belong to one rigid ring', figures)
        return TaskStatus(OK, 'zero within noise', figures)

    def _zero_status(self) -> TaskStatus:
        zero = self._stream.zero
        return zero_status(self._rig, zero.reading if zero else None, zero.stamp if zero else 0,
                           self._stream.newest_stamp, self._stream.load)


main = streaming_node.executable(RingDisplacementNode)

if __name__ == '__main__':
    main()
