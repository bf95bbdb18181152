"""Nodes that replay a bag: which bag they may read, and their topics as /clock reaches stamps."""

from collections.abc import Sequence
from functools import lru_cache, partial
from pathlib import Path
import time
from typing import Any, ClassVar

import numpy as np
from rcl_interfaces.msg import SetParametersResult
from rclpy.parameter import Parameter as RosParameter
from rosgraph_msgs.msg import Clock

from saddlering_interfaces.msg import ReplayState
from saddlering_ros.bags.reader import read_raw
from saddlering_ros.bags.wire import decode_time, encode_samples
from saddlering_ros.doubts.comparison import refuse_other_hash
from saddlering_ros.doubts.readings import absent_topic, check_values
from saddlering_ros.files import share_directory
from saddlering_ros.record.batches import SECOND
from saddlering_ros.record.record import RawRecord
from saddlering_ros.record.scratch import BLOCK, forget
from saddlering_ros.record.topics import TOPICS
from saddlering_ros.ros import parameters
from saddlering_ros.ros.diagnostics import ERROR, FunctionTask, OK, TaskStatus, WARN
from saddlering_ros.ros.names import CLOCK, NodeError, STATE
from saddlering_ros.ros.parameters import NodeParameter
from saddlering_ros.ros.raw_topics import LATCHED, message_class, RawPublisher, RawSubscription
from saddlering_ros.ros.streaming_node import StreamingNode

BAG = NodeParameter(
    'bag', '', 'the bag to replay, from the next `configure` on: a rosbag2 directory or an .mcap '
               'file; none: wait', changeable=True)
BAG_ROOT = NodeParameter(
    'bag_root', '', 'folder below which every bag must lie that is set while the node runs '
    '(links are resolved first); none: the folder of the bag at the start, else the shipped bags')


class BagNode(StreamingNode):
    """A node that replays a bag.

    Whoever starts it may name any bag. Whoever can reach its services while it runs is not
    trusted that far: what they name must lie below a root, as for goals.
    """

    PARAMETERS: ClassVar[tuple[NodeParameter, ...]] = (BAG, BAG_ROOT, parameters.TRUST_RIG)

    def __init__(self, name: str, **options: Any) -> None:
        super().__init__(name, **options)
        self._first_bag = self.settings['bag']
        self._bag_root = parameters.root_folder(
            self, 'bag_root', Path(self._first_bag).absolute().parent
            if self._first_bag else share_directory() / 'bags')
        self.add_on_set_parameters_callback(self._judge_bag)

    def start(self) -> None:
        """Without a bag it waits: a driver of the hardware, or ros2 bag play, may do its work."""
        if self._first_bag:
            super().start()
        elif self.settings['autostart']:
            self.get_logger().info(
                'no bag is given, so that nothing is replayed. To replay a bag of '
                f'{self._bag_root}: ros2 param '
                f'set {self.get_fully_qualified_name()} bag PATH, then ros2 lifecycle set')

    def read_record(self, topics: Sequence[str] | None = None) -> RawRecord:
        """The bag to replay now; NodeError for none, a forbidden one, or another rig's."""
        bag = self.settings['bag']
        if not bag:
            raise NodeError(f'{self.get_name()}: parameter bag is empty: set it to a bag')
        record = read_raw(self._allowed(bag), topics, rig=self._rig)
        parameters.refuse_other_rig(self, refuse_other_hash, record, self._rig)
        return record

    def _allowed(self, bag: str) -> str:
        return bag if bag == self._first_bag else str(parameters.bag_below(self._bag_root, bag))

    def _judge_bag(self, changes: list[RosParameter]) -> SetParametersResult:
        try:
            for bag in [str(one.value).strip() for one in changes if one.name == BAG.name]:
                if bag:
                    self._allowed(bag)
        except NodeError as problem:
            return SetParametersResult(successful=False, reason=str(problem))
        return SetParametersResult(successful=True)


JUMP = 2 * SECOND
"""A larger step of the clock is a move by hand: samples in between are not published."""


def topics_of(node: str) -> list[str]:
    """The topics that a node replays."""
    return [topic.name for topic in TOPICS.values() if topic.replayed_by == node]


@lru_cache(maxsize=8)  # it is asked for with every sample
def _is_same(theirs: Path, own: Path) -> bool:
    """Whether both are one bag, as its folder or as a file in it; elsewhere, by their names."""
    pairs = ((theirs, own), (theirs.parent, own), (theirs, own.parent))
    if theirs.exists() and own.exists():
        return any(one.samefile(other) for one, other in pairs)
    return any(one.name == other.name for one, other in pairs)


class ReplayNode(BagNode):
    """Publishes as /clock reaches their stamps the topics of a bag that name it as replayer.

    Nothing while a replay_clock has another bag: load and probes would be of two recordings.
    """

    def __init__(self, name: str) -> None:
        super().__init__(name)
        self._topics = topics_of(name)
        self._state = ReplayState()
        self._states = self.create_subscription(
            ReplayState, STATE, partial(setattr, self, '_state'), LATCHED)

    def configure(self) -> None:
        record = self.read_record(self._topics)
        for topic in record:
            check_values(f'{record.path}: {topic}', record[topic].stamps, record[topic].values)
        for note in (*record.notes, *(note for name in record for note in record[name].notes)):
            self.get_logger().warning(f'{record.path}: {note}')
        absent = absent_topic(self._rig)
        self._replayed = [record[name] for name in record if name != absent]
        self._now = 0
        self._heard = time.monotonic()
        self._jumps = 0
        self._path = record.path
        self.tasks = [FunctionTask('replay', self._task_status), self._agreement, self.sources()]

    def connect(self) -> None:
        self._clock_flow = RawSubscription(self, CLOCK, Clock, depth=100)
        self.inputs = [self._clock_flow]
        self.outputs = [RawPublisher(self, topic.relative, message_class(topic.type))
                        for topic in (TOPICS[raw.topic] for raw in self._replayed)]

    def process_batch(self) -> None:
        # The executor could serve the announced bag after these messages of /clock.
        while taken := self._states.handle.take_message(ReplayState, False):
            self._state = taken[0]
        for now in self._clock_flow.take_each(decode_time):
            self._heard = time.monotonic()
            self._follow(now)

    def _follow(self, now: int) -> None:
        before, self._now = self._now, now
        is_jump = before == 0 or now < before or now - before > JUMP
        self._jumps += is_jump and before != 0
        for raw, flow in zip(self._replayed, self.outputs, strict=True):
            start, stop = np.searchsorted(raw.stamps, (before, now), side='right').tolist()
            if is_jump or start == stop:
                continue
            if start // BLOCK != stop // BLOCK:
                forget(raw.stamps, raw.values)
            if mixed := self._mixed():
                self.get_logger().error(mixed, once=True)
            else:
                samples = raw.samples.pick(slice(start, stop))
                flow.send(encode_samples(samples, TOPICS[raw.topic], raw.frame_id),
                          int(samples.stamps[-1]))

    def _mixed(self) -> str:
        """Why nothing is published, in words: a replay_clock has another bag; '' else."""
        theirs = Path(self._state.bag)
        if not self._state.bag or _is_same(theirs, self._path) or not self.count_publishers(STATE):
            return ''
        return (f'nothing is published: this node replays {self._path}, and replay_clock '
                f'{theirs}: give both the same bag')

    def replayed_until(self) -> int:
        """The clock's time; 1 ns before there is any."""
        return self._now or 1

    def _task_status(self) -> TaskStatus:
        sent = {flow.topic: str(flow.published) for flow in self.outputs}
        figures = {**sent, 'bag': self._path.name, 'jumps of the clock': str(self._jumps),
                   'malformed clock': str(sum(flow.malformed for flow in self.inputs))}
        if mixed := self._mixed():
            return TaskStatus(ERROR, mixed, figures)
        if not self._now:
            return TaskStatus(WARN, 'no /clock yet: start replay_clock, or ros2 bag play --clock',
                              figures)
        if all((raw.stamps[-1:] <= self._now).all() for raw in self._replayed):
            return TaskStatus(OK, 'all messages are published', figures)
        silent = time.monotonic() - self._heard
        if silent > 2.0:
            return TaskStatus(ERROR, f'/clock has been silent for {silent:.0f} s', figures)
        return TaskStatus(OK, 'follows the clock', figures)
