"""Running nodes, a driver and a listener: the stage on which faults are put in."""

from __future__ import annotations

from collections.abc import Callable, Iterator
import contextlib
from dataclasses import dataclass, field
from functools import partial
import random
import subprocess
import time

from diagnostic_msgs.msg import DiagnosticArray
import numpy as np
from rclpy.serialization import deserialize_message
from std_srvs.srv import Trigger

from benchmarks.served_node import ServedNode
from saddlering_interfaces.msg import ReplayProgress, RingDisplacement
from saddlering_ros.bags.wire import decode_displacements
from saddlering_ros.record.batches import Displacements
from saddlering_ros.ros.launcher import NodeGroup, RING_NODES
from saddlering_ros.ros.names import PROGRESS
from saddlering_ros.ros.raw_topics import RawSubscription

from .driver import CYCLE, ELEVATION, start_driver, Truth

TOLERANCE = 2e-6
"""Of a published number [m, rad]; the truth is known to 0.1 of it."""

NOTICE = 2.0
"""A wrong number must be covered by a diagnostic within so many seconds before or after it."""

REST = round(0.5e9)
"""After its zero [ns] a simulation is in full swing."""

OUTPUTS = {'ring_displacement': '/ring/displacement',
           'ring_simulator': '/ring/simulated_displacement', 'ring_residual': '/ring/residual'}


@dataclass(frozen=True)
class Heard:
    """A batch of one topic, and when it came (monotonic) [s]."""

    batch: Displacements
    arrived: float


class Listener(ServedNode):
    """A node of this process that keeps everything the ring nodes say, with its time."""

    def __init__(self, domain: int) -> None:
        super().__init__(domain, f'listener_{time.monotonic_ns()}')
        self.heard: dict[str, list[Heard]] = {topic: [] for topic in OUTPUTS.values()}
        self.said: list[tuple[float, str, int, str]] = []
        self.alive: dict[str, float] = {}
        self._flows = {topic: RawSubscription(self.node, topic, RingDisplacement)
                       for topic in OUTPUTS.values()}
        self._progress = RawSubscription(self.node, PROGRESS, ReplayProgress)
        self._diagnostics = RawSubscription(self.node, '/diagnostics', DiagnosticArray)
        self.serve()

    def take(self) -> None:
        """Keep what has come."""
        now = time.monotonic()
        for topic, flow in self._flows.items():
            messages = flow.take()
            if messages:
                self.heard[topic].append(Heard(decode_displacements(messages), now))
        for message in self._progress.take():
            self.alive[deserialize_message(message, ReplayProgress).node] = now
        for message in self._diagnostics.take():
            for status in deserialize_message(message, DiagnosticArray).status:
                self.said.append((now, status.name, status.level[0], status.message))

    def last(self, topic: str) -> float:
        """When something came last on a topic [s, monotonic]; 0 for never."""
        with self.lock:
            return self.heard[topic][-1].arrived if self.heard[topic] else 0.0

    def since(self, topic: str, when: float) -> int:
        """How many samples came on a topic after `when`."""
        with self.lock:
            return sum(len(item.batch) for item in self.heard[topic] if item.arrived > when)

    def warned(self, when: float, until: float, node: str = '') -> list[str]:
        """What was said above OK between two times, by one node or all."""
        with self.lock:
            return [f'{name}: {words}' for at, name, level, words in self.said
                    if when <= at <= until and 0 < level < 3 and name.startswith(node)]

    def call(self, name: str) -> bool:
        """Call a Trigger service."""
        with self.lock:
            client = self.node.create_client(Trigger, name)
        end = time.monotonic() + 20.0
        while not client.service_is_ready() and time.monotonic() < end:
            time.sleep(0.02)
        with self.lock:
            future = client.call_async(Trigger.Request())
        while not future.done() and time.monotonic() < end:
            time.sleep(0.01)
        return future.done() and bool(future.result().success)

    def forget(self) -> None:
        """Forget what was heard."""
        with self.lock:
            for items in self.heard.values():
                items.clear()
            self.said.clear()


def wrong_numbers(listener: Listener, truth: Truth, starts: list[int],
                  tolerance: float = TOLERANCE) -> list[str]:
    """Numbers that went out, differ from the truth, and about which nothing was said.

    starts: stamps [ns] at which the cycles of each source of samples began; a number that fits one
    of them is right.
    """
    still = truth.motion[:, 400:1100].mean(axis=1, keepdims=True)
    faults = []
    with listener.lock:
        heard = {topic: list(items) for topic, items in listener.heard.items()}
    for topic, items in heard.items():
        for item in items:
            error = np.full(len(item.batch), np.inf)
            for start in starts:
                expected = truth.at((item.batch.stamps - start) / 1e9) - still
                if topic == '/ring/residual':
                    expected = np.zeros_like(expected)
                error = np.minimum(error, np.abs(item.batch.channels - expected).max(axis=0))
            # The zero is taken for rest; a ring still coming to rest then differs until it is.
            error[item.batch.stamps < item.batch.zero_stamps + REST] = 0.0
            worst = float(error.max(initial=0.0))
            if worst > tolerance or not np.isfinite(item.batch.channels).all():
                noticed = listener.warned(item.arrived - NOTICE, item.arrived + NOTICE)
                if not noticed:
                    stamp = item.batch.stamps[int(np.argmax(error))]
                    faults.append(f'{topic}: off by {worst * 1e6:.1f} um at stamp {stamp}, '
                                  'nothing said')
    return faults[:5]


PARAMETERS = {'ring_simulator': {'elevation_deg': ELEVATION}}


@dataclass
class Outcome:
    """Of one scenario: what was put in, which promises were broken, figures worth showing."""

    put_in: int = 0
    faults: list[str] = field(default_factory=list)
    figures: dict[str, float] = field(default_factory=dict)


@dataclass
class Stage:
    """The three ring nodes, a driver, and a listener."""

    group: NodeGroup
    listener: Listener
    truth: Truth
    driver: subprocess.Popen[str]
    start: int
    chance: random.Random
    faults: list[str] = field(default_factory=list)
    put_in: int = 0

    def expect(self, condition: Callable[[], object], seconds: float, what: str) -> float:
        """Wait for a condition; a broken promise if it does not come true. How long it took."""
        began = time.monotonic()
        while not condition():
            if time.monotonic() - began > seconds:
                now = time.monotonic()
                words = sorted(set(self.listener.warned(now - 1.5, now)))
                self.faults.append(f'not within {seconds:g} s: {what} (said: {words})')
                break
            time.sleep(0.005)
        return time.monotonic() - began

    def others_run(self, *but: str) -> None:
        """Every process that was left alone still runs."""
        for name, node in self.group.processes.items():
            if name not in but and not node.running:
                self.faults.append(f'{name} ended with status {node.process.returncode}: '
                                   f'{node.said()[-200:]}')

    def in_flow(self, *names: str, seconds: float = 20.0) -> None:
        """The named nodes publish (again)."""
        now = time.monotonic()
        for name in names or tuple(OUTPUTS):
            came = partial(self.listener.since, OUTPUTS[name], now)
            self.expect(came, seconds, f'{name} publishes')

    def kill(self, name: str) -> None:
        """Kill -9."""
        self.group.processes[name].process.kill()
        self.group.processes[name].process.wait()

    def numbers(self) -> None:
        """Compare all that was heard with the truth, and forget it."""
        time.sleep(1.2)  # the diagnostics of the last second
        self.faults += wrong_numbers(self.listener, self.truth, [self.start])
        self.listener.forget()

    def zero_together(self) -> None:
        """A node that zeroed anew alone is said not to fit the other; one call puts that right."""
        began = time.monotonic()
        self.expect(lambda: self.listener.since('/ring/residual', began) > 0 or any(
            at > began and name.startswith('ring_residual') and level > 0
            for at, name, level, _ in list(self.listener.said)),
            3.0, 'residual, or a word about why there is none')
        for _ in range(5):
            if self.listener.since('/ring/residual', time.monotonic() - 0.3):
                return
            while not 0.2 < (time.time_ns() - self.start) / 1e9 % CYCLE < 0.5:
                time.sleep(0.02)  # at preload, as someone who knows the test would
            self.listener.call('/ring_displacement/zero')
            time.sleep(1.5)
        self.in_flow('ring_residual', seconds=2.0)

    def pause(self, low: float = 0.1, high: float = CYCLE) -> None:
        """A random while."""
        time.sleep(self.chance.uniform(low, high))


@contextlib.contextmanager
def stage(chance: random.Random, nodes: tuple[str, ...] = RING_NODES,
          domain: int | None = None) -> Iterator[Stage]:
    """Everything started, matched and in full swing; ended again whatever happens."""
    truth = Truth.make()
    with NodeGroup(domain_id=domain) as group:
        assert group.domain_id is not None
        listener = Listener(group.domain_id)
        for name in nodes:
            group.start(name, PARAMETERS.get(name))
        driver, start = start_driver(group)
        one = Stage(group, listener, truth, driver, start, chance)
        try:
            one.in_flow(*[name for name in nodes if name in OUTPUTS], seconds=60.0)
            one.listener.forget()
            yield one
        finally:
            one.driver.kill()
            one.driver.wait()
            listener.close()
