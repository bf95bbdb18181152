"""What nodes hear of the rig and of each other: elevation, hash of the rig, zero, readiness.

Of the sources of the elevation, the first that is known counts: the node's own setting, the bag
that is replayed (replay/state), the bag that the node was started with, the inclinometer
(rig/elevation).
"""

from collections.abc import Callable, Sequence
import math
import time

from geometry_msgs.msg import Vector3Stamped
from rclpy.node import Node

from saddlering_interfaces.msg import Elevation as ElevationMessage
from saddlering_interfaces.msg import ReplayState, RigIdentity
from saddlering_ros.doubts.on_rig import below_preload, units_of_preload
from saddlering_ros.quantities import first_of
from saddlering_ros.record.batches import ANY_TIME
from saddlering_ros.record.record import HIGHEST_ELEVATION, LOWEST_ELEVATION
from saddlering_ros.record.topics import ELEVATION
from saddlering_ros.rig import geometry, Rig, short_digest
from saddlering_ros.ros.diagnostics import ACTIVE, ERROR, Events, OK, STATE_TASK, TaskStatus, WARN
from saddlering_ros.ros.messages import to_stamp
from saddlering_ros.ros.names import INCLINOMETER, RIG_IDENTITY, STATE
from saddlering_ros.ros.raw_topics import LATCHED, LATCHED_BY_SEVERAL, OF_ANY_SENSOR

SAME_BAG = math.radians(0.01)
"""Elevations of a setting and of a bag that differ by more contradict each other."""

SAME_MEASURED = math.radians(0.5)
"""An inclinometer that differs by more from the elevation in use contradicts it."""

FOLLOWED = math.radians(0.02)
"""The elevation of the inclinometer is read again when it has moved by more: beyond its noise."""

MOVED = math.radians(0.1)
"""An elevation that has moved by more since the zero is told: 1.7 mrad of give in the gear."""


class ElevationWatch:
    """Hears of the elevation on replay/state and rig/elevation; `on_news` is called on changes.

    recording: first and last stamp [ns] of the bag that is replayed, or ANY_TIME.
    """

    def __init__(self, node: Node, on_news: Callable[[], None] = lambda: None) -> None:
        self.of_bag = self.measured = math.nan
        self.recording, self.is_paused = ANY_TIME, False
        self.doubt = ''  # about the newest reading of the inclinometer, in words
        self.due = self._heard = math.nan  # time of the next and the last reading [s, monotonic]
        self._read: dict[str, float] = {}  # the last reading [rad] by topic
        self._on_news, self._node = on_news, node
        node.create_subscription(ReplayState, STATE, self._on_state, LATCHED)
        node.create_subscription(Vector3Stamped, ELEVATION.relative, lambda message:
                                 self._on_measured(message.vector.x), OF_ANY_SENSOR)
        node.create_subscription(ElevationMessage, INCLINOMETER, lambda told:
                                 self._on_measured(told.elevation, INCLINOMETER), OF_ANY_SENSOR)

    def resolve(self, given: float, started_with: float = math.nan) -> tuple[float, str]:
        """The elevation that counts [rad], NaN if none is known, and its source in words.

        given, started_with: that of the setting and of the first bag [rad], or NaN.
        """
        sources = ((given, 'set'), (self.of_bag, 'of the replayed bag'),
                   (started_with, 'of the given bag'), (self.measured, 'measured'))
        for value, source in sources:
            if not math.isnan(value):
                return value, source
        return math.nan, 'not known'

    def contradiction(self, used: float) -> str:
        """Contradiction to the elevation in use [rad], in words; '' if there is none."""
        known = ('set: correct elevation_deg' if used != self.measured else
                 f'measured by {min(self._read)}: stop the wrong one, or correct it')
        for value, limit, whose in ((self.of_bag, SAME_BAG, 'the replayed bag has'), *(
                (read, SAME_MEASURED, f'{topic} measures') for topic, read in self._read.items())):
            if abs(value - used) > limit:  # False for NaN
                return (f'{whose} {math.degrees(value):.2f} deg, and '
                        f'{math.degrees(used):.2f} deg is {known}')
        return ''

    def _on_state(self, message: ReplayState) -> None:
        self.recording = to_stamp(message.start), to_stamp(message.end)
        self.is_paused = message.state in (ReplayState.WAITING, ReplayState.PAUSED)
        value = float(message.elevation)
        if value != self.of_bag and not (math.isnan(value) and math.isnan(self.of_bag)):
            self.of_bag = value
            self._on_news()

    def _on_measured(self, value: float, topic: str = ELEVATION.relative) -> None:
        now = time.monotonic()  # after a single reading, none is due: NaN
        self.due, self._heard = now + max(3.0 * (now - self._heard), SILENT), now
        if not LOWEST_ELEVATION <= math.degrees(value) <= HIGHEST_ELEVATION:
            remedy = 'see to it' if math.isnan(value) else 'publish radians'
            self.doubt = f'the inclinometer reads {value:g} rad, which no barrel has: {remedy}'
            return
        self.doubt = ''
        self._read = {other: read for other, read in self._read.items()
                      if other != topic and self._node.count_publishers(other)} | {topic: value}
        value = self._read[min(self._read)]  # that of rig/elevation, if both read
        if math.isnan(self.measured) or abs(value - self.measured) > FOLLOWED:
            self.measured = value
            self._on_news()


class RigAgreement:
    """The diagnostics task `rig`: the hash of the node's rig, and who has another."""

    name = 'rig'

    def __init__(self, node: Node, rig: Rig) -> None:
        self._node = node
        self.digest = rig.digest
        self._others: dict[str, str] = {}
        self._publisher = node.create_publisher(RigIdentity, RIG_IDENTITY, LATCHED)
        node.create_subscription(RigIdentity, RIG_IDENTITY, lambda message: self._others.update(
            {message.node: message.rig_hash}), LATCHED_BY_SEVERAL)
        self._publisher.publish(RigIdentity(
            node=node.get_fully_qualified_name(), rig_hash=self.digest))

    def report(self, elapsed: float) -> TaskStatus:
        there = {f'{info.node_namespace.rstrip("/")}/{info.node_name}'
                 for info in self._node.get_publishers_info_by_topic(
                     self._publisher.topic_name)}
        figures = {'rig hash': self.digest}
        others = {name: digest for name, digest in sorted(self._others.items())
                  if digest != self.digest and name in there}
        if others:
            words = ', '.join(f'{name} ({short_digest(digest)})'
                              for name, digest in others.items())
            return TaskStatus(ERROR, f'this node has rig {short_digest(self.digest)}, and others '
                              f'have another, {words}: give all nodes the same rig file', figures)
        return TaskStatus(OK, f'rig {short_digest(self.digest)}', figures)


def zero_status(rig: Rig, zero: geometry.ZeroReading | None, zero_stamp: int, newest_stamp: int,
                load: float) -> TaskStatus:
    """Whether the zero is taken, by stamps [ns] (0: none) and the load [N] of a waiting node."""
    if zero is not None:
        words, level = f'zero at {rig.force_words(zero.load, 3)}', OK
        if units := units_of_preload(rig, zero.load):
            words, level = (f'zero at {zero.load:.4g} N, which looks like {" or ".join(units)}: '
                            'publish newtons'), WARN
        elif low := below_preload(rig, zero.load):
            words, level = f'{words} {low}: go to preload, then call ~/zero', WARN
        return TaskStatus(level, words, {
            'zero stamp': str(zero_stamp), 'zero load [N]': f'{zero.load:.1f}'})
    if not newest_stamp:
        return TaskStatus(OK, 'waiting for samples')
    words = f'(load is {rig.force_words(load, 2)})'
    if abs(load - rig.preload) <= geometry.NEAR_PRELOAD_SHARE * rig.full_scale_load:
        return TaskStatus(WARN, f'waiting for {geometry.MIN_SAMPLES} samples in a steady '
                                f'{geometry.WINDOW_SECONDS:g} s at preload {words}: keep the load '
                                'at rest, and see to its rate')
    return TaskStatus(WARN, f'waiting for preload {words}: go to preload, or call ~/zero')


SILENT = 3.0
"""A node that has not reported for so long [s] is not there."""

EVENTS_COUNT = 10.0
"""A sample refused, lost or late keeps a rig from being ready for so long [s]."""


class Readiness:
    """The diagnostics task `ready to test`: the reasons that prevent one, from nodes' statuses.

    needed: names of nodes as /diagnostics shows them. Ready means that each of them reports, is
    active, and reports nothing but OK: every stream comes at its rate, the zero is taken, the rig
    files agree, and no sample was refused or lost for EVENTS_COUNT.
    """

    name = 'ready to test'

    def __init__(self, needed: Sequence[str]) -> None:
        self._heard: dict[str, dict[str, tuple[TaskStatus, float]]] = {name: {} for name in needed}
        self._events: dict[str, tuple[float, str]] = {}

    def hear(self, name: str, level: int, words: str, now: float) -> None:
        """Take the status 'NODE: TASK' at `now` [s, monotonic]; its own does not count."""
        node, _, task = name.partition(': ')
        if node not in self._heard or task == self.name:
            return
        self._heard[node][task] = TaskStatus(level, words), now
        if task == Events.name and level > OK:
            self._events[node] = now, words

    def reasons(self, now: float) -> list[str]:
        """Reasons that prevent a test at `now` [s, monotonic], one line each; none: ready."""
        reasons = []
        for node, heard in self._heard.items():
            current = {task: status for task, (status, at) in heard.items() if now - at <= SILENT}
            state = current.get(STATE_TASK)
            if state is None:
                reasons.append(f'{node} does not report')
            elif state.words != ACTIVE:
                reasons.append(f'{node}: {state.words}')
            else:
                reasons += [f'{node}: {task}: {status.words}' for task, status in current.items()
                            if status.level > OK and task != Events.name]
                at, words = self._events.get(node, (-EVENTS_COUNT, ''))
                if now - at < EVENTS_COUNT:
                    reasons.append(f'{node}: {words}, less than {EVENTS_COUNT:g} s ago')
        return reasons

    def report(self, elapsed: float) -> TaskStatus:
        reasons = self.reasons(time.monotonic())
        if not reasons:
            return TaskStatus(OK, 'ready to test')
        return TaskStatus(WARN, f'not ready: {first_of(reasons)}',
                          {f'reason {number}': reason for number, reason in enumerate(reasons, 1)})
