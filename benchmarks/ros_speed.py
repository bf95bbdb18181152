"""How fast are the nodes: latency hop by hop, loss, speed in lockstep, time to cancel?

    python benchmarks/ros_speed.py [--seconds 8] [--rates 200 500 1000]
    chrt -r 10 python benchmarks/ros_speed.py          as in the unit of systemd

Everything runs between real processes over DDS on this machine. A driver publishes five topics to
the ring nodes. Every node notes when it takes a message and when it sends one, by stamp. Then
follow the same stream while an identification runs, a bag in lockstep, and the cancel of an
identification.
"""

from __future__ import annotations

from collections.abc import Iterator
import contextlib
import functools
import itertools
import os
from pathlib import Path
import subprocess
import sys
import tempfile
import time
from typing import Any

from frame import arguments, table
import numpy as np
import rclpy
from rclpy.action import ActionClient
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rclpy.serialization import deserialize_message
from rigs import course, course_bag
from std_srvs.srv import Trigger

from saddlering_interfaces.action import IdentifyRing
from saddlering_interfaces.msg import ReplayProgress, RingDisplacement
from saddlering_ros.bags.wire import decode_displacements, encode_samples
from saddlering_ros.record.batches import Samples
from saddlering_ros.record.topics import LOAD, LOAD_TOPIC, PROBE_TOPICS, PROBES
from saddlering_ros.ros.launcher import NodeGroup, RING_NODES, start_nodes
from saddlering_ros.ros.names import PROGRESS
from saddlering_ros.ros.raw_topics import DataWait, RawPublisher, RawSubscription

TRACER = """
import sys
if any('saddlering_ros.nodes' in word for word in sys.orig_argv):
    import atexit, os, time
    from saddlering_ros.ros import raw_topics
    taken, sent = {}, {}
    take, send = raw_topics.RawSubscription.take, raw_topics.RawPublisher.send
    def traced_take(flow):
        messages = take(flow)
        if messages:
            taken.setdefault(flow.topic, []).append(
                (time.time_ns(), [message[4:12] for message in messages]))
        return messages
    def traced_send(flow, messages, last_stamp):
        send(flow, messages, last_stamp)
        if messages:
            sent.setdefault(flow.topic, []).append(
                (time.time_ns(), [message[4:12] for message in messages]))
    raw_topics.RawSubscription.take, raw_topics.RawPublisher.send = traced_take, traced_send
    def keep():
        import numpy as np
        arrays = {}
        for kind, flows in (('taken', taken), ('sent', sent)):
            for topic, batches in flows.items():
                raw = np.frombuffer(b''.join(b''.join(words) for _, words in batches), '<u4')
                stamps = raw[0::2].astype(np.int64) * 1_000_000_000 + raw[1::2]
                counts = [len(words) for _, words in batches]
                times = np.repeat(np.array([when for when, _ in batches], np.int64), counts)
                arrays[kind + topic] = np.stack([stamps, times])
        name = next(word for word in sys.orig_argv if 'saddlering_ros.nodes' in word)
        np.savez(os.path.join(os.environ['TRACES'], name.rpartition('.')[2]), **arrays)
    atexit.register(keep)
"""
HOPS = ('to displacement', 'displacement', 'to residual', 'residual', 'to listener')
SETTLED_NS = 1_500_000_000
"""Rows of the first 1.5 s wait for the zero and are left out."""

LOCKSTEP_RATE = 1000.0


# -- the driver, a process of its own ------------------------------------------------------------


def drive(seconds: float, rate: float, published: Path) -> None:
    """Five topics, each sample stamped and published on its own when its time comes.

    The driver waits until its own writers know their readers: a reader can know the writer first,
    and what is written before the writer knows of it never reaches that reader. It keeps in
    `published` the stamp of each load sample and the time at which it was published [ns].
    """
    from geometry_msgs.msg import WrenchStamped
    from sensor_msgs.msg import Range
    times, load, gaps = course(seconds, rate)
    rclpy.init()
    node = rclpy.create_node('driver')
    flows = [RawPublisher(node, LOAD_TOPIC, WrenchStamped)]
    flows += [RawPublisher(node, topic, Range) for topic in PROBE_TOPICS]
    readers = [int(word) for word in sys.stdin.readline().split()]
    while any(flow.subscriptions() < count for flow, count in zip(flows, readers, strict=True)):
        time.sleep(0.01)
    stamps = time.time_ns() + 1_000_000_000 + np.round(times * 1e9).astype(np.int64)
    messages = [encode_samples(Samples(stamps, load), LOAD)]
    messages += [encode_samples(Samples(stamps, gap, 0.0, 2e-3), topic)
                 for topic, gap in zip(PROBES, gaps, strict=True)]
    kept = np.stack([stamps, stamps])
    for index, stamp in enumerate(stamps.tolist()):
        time.sleep(max(0.0, (stamp - time.time_ns()) / 1e9))
        kept[1, index] = time.time_ns()
        for flow, series in zip(flows, messages, strict=True):
            flow.send([series[index]], stamp)
    np.save(published, kept)
    time.sleep(1.0)


# -- listening -----------------------------------------------------------------------------------


@contextlib.contextmanager
def listener(domain: int | None) -> Iterator[Any]:
    """A node of this process, and the subscriptions of residual and progress."""
    context = rclpy.Context()
    rclpy.init(context=context, domain_id=domain)
    node = Node('listener', context=context)
    try:
        yield (node, RawSubscription(node, '/ring/residual', RingDisplacement),
               RawSubscription(node, PROGRESS, ReplayProgress))
    finally:
        node.destroy_node()
        rclpy.shutdown(context=context)


def wait_matched(progress: RawSubscription, seconds: float = 60.0) -> None:
    """Until every ring node is matched with all its neighbours."""
    said: dict[str, Any] = {}
    deadline = time.monotonic() + seconds
    while time.monotonic() < deadline:
        for raw in progress.take():
            message = deserialize_message(raw, ReplayProgress)
            said[message.node] = message
        if set(RING_NODES) <= said.keys() and all(
                min(said[name].publishers) >= 1 and min(said[name].subscriptions) >= 1
                for name in RING_NODES):
            return
        time.sleep(0.05)
    raise SystemExit('the nodes did not find each other')


def receive(node: Node, residual: RawSubscription, count: int, seconds: float) -> np.ndarray:
    """Stamps and arrival times [ns] of residuals, (2, N)."""
    data = DataWait(node.context)
    batches: list[np.ndarray] = []
    deadline, received = time.monotonic() + seconds, 0
    while received < count and time.monotonic() < deadline:
        data.wait([residual], 0.1)
        messages = residual.take()
        if messages:
            stamps = decode_displacements(messages).stamps
            batches.append(np.stack([stamps, np.full(stamps.size, time.time_ns())]))
            received += stamps.size
        time.sleep(0.0005)
    return np.concatenate(batches, axis=1)


# -- measuring -----------------------------------------------------------------------------------


def between(begin: np.ndarray, end: np.ndarray, first: int) -> np.ndarray:
    """Time [ms] between two stages, each (2, N): stamps and times [ns]; begin in order."""
    places = np.minimum(np.searchsorted(begin[0], end[0]), begin.shape[1] - 1)
    both = (begin[0][places] == end[0]) & (end[0] > first + SETTLED_NS)
    return np.asarray((end[1] - begin[1][places])[both] / 1e6)


def complete(flows: list[np.ndarray]) -> np.ndarray:
    """Stamps, and the time at which the last of several messages of each was taken."""
    common = functools.reduce(np.intersect1d, [flow[0] for flow in flows])
    return np.stack([common, np.max([flow[1][np.searchsorted(flow[0], common)] for flow in flows],
                                    axis=0)])


def ring_nodes(seconds: float, rate: float, *, identifying: bool) -> tuple[list[np.ndarray], int]:
    """Times [ms] of each hop and of all, and how many residuals were lost."""
    count = round(seconds * rate)
    with tempfile.TemporaryDirectory() as folder:
        (Path(folder) / 'sitecustomize.py').write_text(TRACER)
        traced = {'PYTHONPATH': folder, 'TRACES': folder}
        with (NodeGroup(extra_environment=traced) as group,
              listener(group.domain_id) as (node, residual, progress),
              contextlib.ExitStack() as beside):
            for name in RING_NODES:
                group.start(name)
            published_in = Path(folder) / 'published.npy'
            driver = subprocess.Popen(
                [sys.executable, __file__, '--seconds', str(seconds), '--rates', str(rate),
                 '--drive', str(published_in)],
                env=group.environment, stdin=subprocess.PIPE, text=True)
            wait_matched(progress)
            progress.close()
            if identifying:
                group.start('ring_identification')
                beside.enter_context(Identifier(group.domain_id, seed=0))
            assert driver.stdin is not None
            driver.stdin.write('2 1 1 1 1\n')  # readers of each topic
            driver.stdin.flush()
            heard = receive(node, residual, count, seconds + 10.0)
            driver.wait()
        ring, simulator, last = (dict(np.load(Path(folder) / f'{name}.npz'))
                                 for name in RING_NODES)
        published = np.load(published_in)
    assert 'taken' + LOAD_TOPIC in simulator
    stages = [
        published, complete([ring['taken' + topic] for topic in (LOAD_TOPIC, *PROBE_TOPICS)]),
        ring['sent/ring/displacement'],
        complete([last['taken/ring/displacement'], last['taken/ring/simulated_displacement']]),
        last['sent/ring/residual'], heard]
    hops = [between(*pair, published[0, 0]) for pair in itertools.pairwise(stages)]
    return [*hops, between(published, heard, published[0, 0])], count - heard.shape[1]


class Identifier:
    """A client of /identify_ring whose goal outlasts the block and is canceled at its end."""

    def __init__(self, domain: int | None, seed: int) -> None:
        self.context = rclpy.Context()
        rclpy.init(context=self.context, domain_id=domain)
        self.node = Node('identifier', context=self.context)
        self.executor = SingleThreadedExecutor(context=self.context)
        self.executor.add_node(self.node)
        self.client = ActionClient(self.node, IdentifyRing, '/identify_ring')
        self.goal = IdentifyRing.Goal(bags=['static_50'], method='paper', particles=400,
                                      iterations=1_000_000, seed=seed)
        self.seconds = float('nan')

    def __enter__(self) -> Identifier:
        self.client.wait_for_server(60.0)
        running: list[Any] = []
        self.sent = self.client.send_goal_async(self.goal, feedback_callback=running.append)
        self.executor.spin_until_future_complete(self.sent, 30.0)
        self.ended = self.sent.result().get_result_async()
        while not running and not self.ended.done():
            self.executor.spin_once(0.1)
        return self

    def __exit__(self, *exception: object) -> None:
        """Cancel; `seconds` is the time from asking for it to the result."""
        for _ in range(10):  # the feedback that has come in the meantime
            self.executor.spin_once(0.05)
        was_running = not self.ended.done()
        asked = time.monotonic()
        self.sent.result().cancel_goal_async()
        self.executor.spin_until_future_complete(self.ended, 30.0)
        self.seconds = time.monotonic() - asked
        self.executor.shutdown(timeout_sec=0.0)
        self.client.destroy()
        self.node.destroy_node()
        rclpy.shutdown(context=self.context)
        if not was_running:
            raise SystemExit(f'the goal ended by itself: {self.ended.result().result.message}')


def in_lockstep(seconds: float) -> str:
    """A bag of five topics at 1 kHz through all nodes as fast as they follow."""
    count = round(seconds * LOCKSTEP_RATE) - 1
    with (tempfile.TemporaryDirectory() as folder,
          start_nodes(course_bag(Path(folder), seconds, LOCKSTEP_RATE),
                      start_paused=True) as group,
          listener(group.domain_id) as (node, residual, progress)):
        wait_matched(progress)
        play = node.create_client(Trigger, '/replay_clock/play')
        play.wait_for_service(30.0)
        answer = play.call_async(Trigger.Request())
        stamps, arrivals = receive(node, residual, count, 120.0)
        answer.cancel()
        group.wait('replay_clock', 60.0)
    first = np.searchsorted(arrivals, arrivals[0], side='right') - 1
    speed = float(stamps[-1] - stamps[first]) / float(arrivals[-1] - arrivals[0])
    return (f'lockstep: {speed:.1f} times real time, {5 * LOCKSTEP_RATE * speed:.0f} raw messages '
            f'a second, {count - stamps.size} residuals lost')


def to_cancel() -> str:
    """From asking for the cancel of a running identification to its result."""
    seconds = []
    with NodeGroup() as group:
        group.start('ring_identification')
        for seed in range(5):
            with Identifier(group.domain_id, seed) as one:
                pass
            seconds.append(1e3 * one.seconds)
    return (f'cancel of an identification: {np.median(seconds):.0f} ms, slowest of 5 '
            f'{max(seconds):.0f} ms')


def main() -> None:
    args = arguments(__doc__, {'seconds': 5.0, 'rates': [500.0]}, seconds=8.0,
                     rates=(200.0, 500.0, 1000.0), drive=Path)
    if args.drive:
        drive(args.seconds, args.rates[0], args.drive)
        return
    rows: list[list[object]] = []
    for rate, identifying in [*((rate, False) for rate in args.rates), (args.rates[-1], True)]:
        stages, lost = ring_nodes(args.seconds, rate, identifying=identifying)
        rows.append([f'{rate:g}{", one identifies" if identifying else ""}',
                     '{:.2f} and {:.2f}'.format(*np.percentile(stages[-1], (50, 99))),
                     *(f'{np.median(times):.2f}' for times in stages[:-1]), lost])
    table(f'p50 and p99 [ms], p50 of each hop; load average {os.getloadavg()[0]:.1f}',
          ('rate [Hz]', 'residual', *HOPS, 'lost'), rows)
    print(in_lockstep(args.seconds), flush=True)
    print(to_cancel(), flush=True)


if __name__ == '__main__':
    main()
