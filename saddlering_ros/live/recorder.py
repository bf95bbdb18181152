"""A node that records the topics of the rig and of the nodes as a rosbag2 bag."""

from collections.abc import Iterator, Mapping
from contextlib import contextmanager, ExitStack, suppress
import math
import os
from pathlib import Path
import sys
import threading
import time
from typing import Any

from diagnostic_msgs.msg import DiagnosticArray
import rclpy
from rclpy._rclpy_pybind11 import RMWError
from rclpy.serialization import deserialize_message
from rclpy.signals import SignalHandlerOptions
from std_msgs.msg import Bool

from saddlering_interfaces import msg
from saddlering_ros.bags.wire import CdrError, decode_time
from saddlering_ros.bags.write import BagWriter, RECORDED_CHUNK_SIZE
from saddlering_ros.doubts.readings import ELEVATION_TOLERANCE_DEG
from saddlering_ros.errors import LiveError
from saddlering_ros.record.topics import TOPICS
from saddlering_ros.rig import short_digest
from saddlering_ros.ros import names, raw_topics
from saddlering_ros.ros.streaming_node import StreamingNode

NAME = 'saddlering_recorder'
RING_STREAMS = tuple(f'/{name}' for name in names.DISPLACEMENTS)
KEPT: dict[str, Any] = {
    f'/{names.PARAMETERS_IN_FORCE}': msg.RingParameters, f'/{names.STATE}': msg.ReplayState,
    f'/{names.RING_ALARM}': msg.RingAlarm, f'/{names.WITHIN_LIMITS}': Bool}
"""Topics whose last message is there for late joiners."""

OTHERS: dict[str, Any] = {
    names.DIAGNOSTICS: DiagnosticArray, f'/{names.ZERO_REQUEST}': msg.ZeroRequest}


class Recorder(StreamingNode):
    """Writes every message of the topics of rig and ring; a clock in lockstep can wait.

    A bag holds them by the names of the root namespace, for any namespace of the rig.
    """

    IS_SINGLE = HAS_RIG = False

    def __init__(self, bag: BagWriter, context: Any, namespace: str = '') -> None:
        super().__init__(NAME, context=context, namespace=namespace)
        self.fault: Exception | None = None
        self.writing = threading.RLock()
        self._bag, self._namespace = bag, namespace
        self._published: dict[str, int] = {}
        self._rigs: dict[str, str] = {}
        self._elevations: dict[str, float] = {}
        self.create_subscription(
            msg.RigIdentity, names.RIG_IDENTITY,
            lambda message: self._rigs.update({message.node: message.rig_hash}),
            raw_topics.LATCHED_BY_SEVERAL)
        self.create_subscription(
            msg.RingParameters, names.PARAMETERS_IN_FORCE, lambda told: self._elevations.update(
                {told.applied_by: math.degrees(told.elevation)}), raw_topics.LATCHED_BY_SEVERAL)
        self.create_subscription(
            msg.ReplayProgress, names.PROGRESS, lambda message: self._published.update(
                zip(message.outputs, map(int, message.published), strict=False)), 200)
        for topic, kind in {**KEPT, **OTHERS}.items():
            self.create_subscription(
                kind, name_of(topic),
                lambda message, topic=topic: self._hear(topic, bytes(message)),
                raw_topics.LATCHED_BY_SEVERAL if topic in KEPT
                else raw_topics.stream_qos(depth=50),
                raw=True)

    def connect(self) -> None:
        self._flows = {topic: raw_topics.RawSubscription(self, name_of(topic), kind)
                       for topic, kind in streams().items()}
        self.inputs = list(self._flows.values())

    def process_batch(self) -> None:
        for topic, flow in self._flows.items():
            messages = flow.take()
            if messages:
                self._keep(topic, messages)
                with suppress(CdrError):  # kept as it came
                    flow.last_stamp = decode_time(messages[-1])

    def missing(self, sent: Mapping[str, int]) -> str:
        """Samples that have not arrived, of those `sent` by topic and of those nodes report."""
        words = []
        for topic, flow in self._flows.items():
            due = max(sent.get(topic, 0), self._published.get(flow.topic, 0))
            if flow.received < due:
                words.append(f'{flow.received} of {due} on {topic}')
        return ', '.join(words)

    def settle_rig(self) -> str:
        """State the nodes' one rig in the bag if it has none; a contradiction, kept too, or ''."""
        facts = self._bag.metadata
        if len(set(self._rigs.values())) == 1:
            facts.setdefault('rig_hash', min(self._rigs.values()))
        stated, elevation = facts.get('rig_hash', ''), float(facts.get('elevation_deg', 'nan'))
        others = ', '.join(f'{node} ({short_digest(digest)})' for node, digest
                           in sorted(self._rigs.items()) if digest != stated)
        said = f'the rig {short_digest(stated)}' if stated else 'no rig'
        apart = ', '.join(f'{node} ({degrees:.2f} deg)' for node, degrees in
                          sorted(self._elevations.items())
                          if node and abs(degrees - elevation) > ELEVATION_TOLERANCE_DEG)
        note = '; '.join(f'the bag states {what}, and nodes meanwhile had another: {nodes}' for
                         what, nodes in ((said, others), (f'{elevation:g} deg', apart)) if nodes)
        if note:
            facts['recorder_note'] = note
        return note

    def keep_as_incomplete(self) -> Path:
        """Keep the recording under a free name beside its own; the path of it."""
        own, number = self._bag.path, 1
        self._bag.path = own.with_name(f'{own.name}.incomplete')
        while self._bag.path.exists():
            number += 1
            self._bag.path = own.with_name(f'{own.name}.incomplete.{number}')
        return self._bag.path

    def counts(self) -> dict[str, int]:
        """Messages received of each stream, by the topic's name in the bag."""
        return {topic: flow.received for topic, flow in self._flows.items()}

    def _hear(self, topic: str, message: bytes) -> None:
        """Keep a message; of /diagnostics, which all rigs of a domain share, those of its rig."""
        with suppress(RMWError):
            told = (deserialize_message(message, DiagnosticArray).status
                    if topic == names.DIAGNOSTICS else ())
            if told and all(names.is_of_another_rig(one.name, self._namespace) for one in told):
                return
        self._keep(topic, [message])

    def _keep(self, topic: str, messages: list[bytes]) -> None:
        with self.writing:
            for number, message in enumerate(messages, start=time.time_ns()):
                self._bag.write_message(topic, number, message)

    def spin(self) -> None:
        """Record until `done` is set, or until a fault ends it; then take what has come."""
        try:
            raw_topics.spin_streaming(self)
            self.process_batch()
        except Exception as problem:  # raised where the recording ends
            self.fault, self.done = problem, True


def streams() -> dict[str, Any]:
    """Message classes of the streams by topic: those of the rig and those computed from them."""
    return {**{name: raw_topics.message_class(topic.type) for name, topic in TOPICS.items()},
            **dict.fromkeys(RING_STREAMS, msg.RingDisplacement)}


def name_of(topic: str) -> str:
    """The name to subscribe to: relative, but for /diagnostics."""
    return topic if topic == names.DIAGNOSTICS else topic.removeprefix('/')


def definitions() -> dict[str, str]:
    """The texts of our own message definitions, by type."""
    prefixes = [*os.environ.get('AMENT_PREFIX_PATH', '').split(os.pathsep), sys.prefix]
    folders = [Path(prefix, 'share', 'saddlering_interfaces', 'msg') for prefix in prefixes if
               prefix]
    folder = next(filter(Path.is_dir, folders), None)
    if folder is None:
        raise LiveError(f'{folders[-1]}: the definitions of our messages are not there: build '
                        'and source saddlering_interfaces again (docs/install.md)')
    return {f'saddlering_interfaces/msg/{file.stem}': file.read_text(encoding='utf-8')
            for file in sorted(folder.glob('*.msg'))}


@contextmanager
def recording(path: Path | str, domain_id: int, *, facts: Mapping[str, str] | None = None,
              overwrite: bool = False, namespace: str = '') -> Iterator[Recorder]:
    """Record a namespace of the ROS domain into a bag at `path` until the block ends.

    Yields the recorder. BagError if the bag cannot be written. A block that raises loses nothing.
    """
    topics = {topic: raw_topics.type_name(kind)
              for topic, kind in {**streams(), **KEPT, **OTHERS}.items()}
    context = rclpy.Context()
    with ExitStack() as network, BagWriter(  # the bag is closed first: leaving may hang or crash
            path, topics, facts or {}, definitions=definitions(), latched=frozenset(KEPT),
            overwrite=overwrite, chunk_size=RECORDED_CHUNK_SIZE, recorded=True) as bag:
        rclpy.init(context=context, args=[], domain_id=domain_id,
                   signal_handler_options=SignalHandlerOptions.NO)
        network.callback(rclpy.try_shutdown, context=context)
        node = Recorder(bag, context, namespace)
        network.callback(node.destroy_node)
        node.start()
        thread = threading.Thread(target=node.spin, daemon=True)
        thread.start()
        try:
            yield node
        finally:
            node.done = True
            thread.join(5.0)
            node.writing.acquire()  # a thread that still hangs writes nothing into a closed bag
        if node.fault is not None:
            raise node.fault
