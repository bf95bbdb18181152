"""A client of running nodes: hears what they say, calls their services, publishes by hand."""

from collections.abc import Callable, Iterator
import contextlib
import subprocess
import time
from typing import Any

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from geometry_msgs.msg import WrenchStamped
from lifecycle_msgs.msg import Transition
from lifecycle_msgs.srv import ChangeState
import numpy as np
from rcl_interfaces.msg import Parameter, ParameterType, ParameterValue
from rcl_interfaces.srv import SetParameters
from rclpy.action import ActionClient
from rclpy.qos import QoSProfile
from rclpy.serialization import deserialize_message
from sensor_msgs.msg import Range

from benchmarks.served_node import ServedNode
from saddlering_interfaces.msg import ReplayProgress, RingDisplacement
from saddlering_ros.bags.wire import decode_displacements, encode_samples
from saddlering_ros.record.batches import Displacements, Samples
from saddlering_ros.record.topics import LOAD, LOAD_TOPIC, PROBE_TOPICS, PROBES
from saddlering_ros.ros import raw_topics
from saddlering_ros.ros.names import PROGRESS
from saddlering_ros.ros.raw_topics import RawPublisher, RawSubscription

OUTPUTS = ('/ring/displacement', '/ring/simulated_displacement', '/ring/residual')

READERS = ('ring_displacement', 'ring_simulator')
"""The nodes that read raw topics, the load first."""


def wait_until(condition: Callable[[], bool], seconds: float = 60.0, what: str = '') -> None:
    """Poll `condition`; fail with `what` if it does not come true."""
    deadline = time.monotonic() + seconds
    while not condition():
        if time.monotonic() > deadline:
            raise AssertionError(f'not within {seconds:g} s: {what or condition}')
        time.sleep(0.01)


@contextlib.contextmanager
def ended(process: subprocess.Popen[Any]) -> Iterator[None]:
    """Leave no process in the domain, whatever the test comes to."""
    try:
        yield
    finally:
        process.kill()


class Client(ServedNode):
    """The test's own node: keeps what the ring nodes publish, their progress and diagnostics."""

    def __init__(self, domain: int) -> None:
        super().__init__(domain, 'test_client')
        self.subscriptions = {topic: RawSubscription(self.node, topic, RingDisplacement)
                              for topic in OUTPUTS}
        self.raw: dict[str, list[bytes]] = {topic: [] for topic in OUTPUTS}
        self.diagnostics: dict[str, tuple[int, str]] = {}
        self.figures: dict[str, dict[str, str]] = {}
        self.warnings: list[str] = []
        self.progress: dict[str, ReplayProgress] = {}
        self._actions: list[ActionClient] = []
        self._progress = RawSubscription(self.node, PROGRESS, ReplayProgress)
        self._diagnostics = RawSubscription(self.node, '/diagnostics', DiagnosticArray)
        self.serve()

    def take(self) -> None:
        """Keep what has come."""
        for topic, subscription in self.subscriptions.items():
            self.raw[topic] += subscription.take()
        for said in self._progress.take_each(lambda raw: deserialize_message(raw, ReplayProgress)):
            self.progress[said.node] = said
        for told in self._diagnostics.take_each(
                lambda raw: deserialize_message(raw, DiagnosticArray)):
            for status in told.status:
                self._note(status)

    def _note(self, status: DiagnosticStatus) -> None:
        self.diagnostics[status.name] = (status.level[0], status.message)
        self.figures[status.name] = {pair.key: pair.value for pair in status.values}
        if status.level[0]:
            self.warnings.append(f'{status.name}: {status.message}')

    def listen(self, kind: Any, topic: str, qos: Any = raw_topics.LATCHED_BY_SEVERAL) -> list[Any]:
        """All messages on a topic from now on; by default also those that it has latched."""
        said: list[Any] = []
        with self.lock:
            self.node.create_subscription(kind, topic, said.append, qos)
        return said

    def heard(self, topic: str) -> Displacements:
        """All displacements heard on `topic` so far."""
        with self.lock:
            return decode_displacements(list(self.raw[topic]))

    def forget(self) -> None:
        """Forget what was heard."""
        with self.lock:
            for messages in self.raw.values():
                messages.clear()
            self.diagnostics.clear()

    def matched(self, topics: tuple[str, ...] = OUTPUTS) -> bool:
        """Whether each of `topics` reaches this client and all others who subscribe to it.

        Both ends must know of each other: a reader may be matched with a writer that has not yet
        heard of it, and then gets nothing of what is sent before.
        """
        return all(self.subscriptions[topic].publishers() and self._sent_to_all(topic)
                   for topic in topics)

    def _sent_to_all(self, topic: str) -> bool:
        readers = self.node.count_subscribers(topic)
        return any(count >= readers for said in self.progress.values()
                   for output, count in zip(said.outputs, said.subscriptions, strict=True)
                   if output == topic)

    def counted(self, node: str, *events: str) -> int:
        """How many of the named events a node has told of on /diagnostics, all in all."""
        figures = self.figures.get(f'{node}: events', {})
        return sum(int(figures.get(event, 0)) for event in events)

    def ring_nodes_matched(self) -> bool:
        """Whether displacement and simulator are matched with residual and this client."""
        said = self.progress
        names = ('ring_displacement', 'ring_simulator', 'ring_residual')
        return (self.matched() and all(name in said for name in names)
                and all(said[name].subscriptions[0] >= 2 for name in names[:2])
                and min(said['ring_residual'].publishers) >= 1)

    def call(self, kind: Any, name: str, request: Any = None, seconds: float = 60.0) -> Any:
        """Call a service and return its response.

        A server drops an answer if it has not found the client's reader within 0.1 s, as may be on
        a saturated machine. The call is then made again.
        """
        with self.lock:
            client = self.node.create_client(kind, name)
        wait_until(client.service_is_ready, seconds, f'{name} is there')
        deadline = time.monotonic() + seconds
        while time.monotonic() < deadline:
            with self.lock:
                future = client.call_async(request or kind.Request())
            with contextlib.suppress(AssertionError):
                wait_until(future.done, seconds / 4.0)
                return future.result()
        raise AssertionError(f'not within {seconds:g} s: {name} answers')

    def action(self, kind: Any, name: str) -> ActionClient:
        """A client of an action, destroyed with this one: its node does not do it.

        Its queues hold all answers of a test, so that none is lost while the machine is busy.
        """
        deep = QoSProfile(depth=1000)
        with self.lock:
            self._actions.append(ActionClient(
                self.node, kind, name, goal_service_qos_profile=deep,
                cancel_service_qos_profile=deep, result_service_qos_profile=deep))
        return self._actions[-1]

    def release(self) -> None:
        """Destroy the clients of actions: their node does not."""
        for action in self._actions:
            action.destroy()


@contextlib.contextmanager
def client(domain: int) -> Iterator[Client]:
    one = Client(domain)
    try:
        yield one
    finally:
        one.close()


class Driver:
    """Publishes the five raw topics as a hardware driver would, in portions.

    A portion waits until the nodes have taken the one before: however slow they are, no queue
    overflows and no topic runs ahead of another.
    """

    def __init__(self, one: Client, reliable: bool = True) -> None:
        qos = raw_topics.stream_qos(reliable)
        self.heard = one
        self.load = RawPublisher(one.node, LOAD_TOPIC, WrenchStamped, qos)
        self.probes = [RawPublisher(one.node, topic, Range, qos) for topic in PROBE_TOPICS]

    def matched(self, readers_of_load: int, readers_of_probes: int = 1) -> bool:
        """Whether both ends know of each other; best effort loses what comes before that."""
        return (self.load.subscriptions() >= readers_of_load
                and all(probe.subscriptions() >= readers_of_probes for probe in self.probes)
                and all(min(said.publishers, default=1) for said in self._readers()))

    def _readers(self) -> list[ReplayProgress]:
        return [said for node, said in self.heard.progress.items() if node in READERS]

    def taken(self) -> bool:
        """Whether every node has taken all that was sent."""
        sent = [self.load.published, *(probe.published for probe in self.probes)]
        return all(count >= own for said in self._readers()
                   for count, own in zip(said.received, sent, strict=False))

    def send_load(self, stamps: np.ndarray, load: np.ndarray) -> None:
        if len(stamps):
            self.load.send(encode_samples(Samples(stamps, load), LOAD), int(stamps[-1]))

    def send_gap(self, probe: int, stamps: np.ndarray, gaps: np.ndarray) -> None:
        if len(stamps):
            samples = Samples(stamps, gaps, 0.0, 2e-3)
            self.probes[probe].send(encode_samples(samples, PROBES[probe]), int(stamps[-1]))

    def send(self, record: Any, rows: Any = slice(None), pace: int = 50) -> None:
        """Send rows of a record (see conftest) in portions of `pace`, load and probes together."""
        index = np.arange(len(record.stamps))[rows]
        for start in range(0, len(index), pace):
            part = index[start:start + pace]
            self.send_load(record.stamps[part], record.load[part])
            for probe in range(4):
                self.send_gap(probe, record.probe_stamps[probe][part], record.gaps[probe][part])
            wait_until(self.taken, what='the nodes take a portion')


def set_parameter(heard: Client, node: str, name: str, value: str | float) -> Any:
    """Set a parameter of a node; what the node answers."""
    kind = (ParameterValue(type=ParameterType.PARAMETER_STRING, string_value=value)
            if isinstance(value, str) else
            ParameterValue(type=ParameterType.PARAMETER_DOUBLE, double_value=value))
    request = SetParameters.Request(parameters=[Parameter(name=name, value=kind)])
    return heard.call(SetParameters, f'/{node}/set_parameters', request).results[0]


def lead(heard: Client, node: str, *transitions: int) -> None:
    """Lead a node through transitions of its lifecycle."""
    for transition in transitions:
        request = ChangeState.Request(transition=Transition(id=transition))
        assert heard.call(ChangeState, f'/{node}/change_state', request).success


DEACTIVATE, ACTIVATE = Transition.TRANSITION_DEACTIVATE, Transition.TRANSITION_ACTIVATE
ANEW = (DEACTIVATE, Transition.TRANSITION_CLEANUP, Transition.TRANSITION_CONFIGURE, ACTIVATE)
