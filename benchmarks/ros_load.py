"""Load on the nodes: loss and latency at 1 kHz per topic, speed in lockstep, time to cancel.

    python benchmarks/ros_load.py [--seconds 20] [--json FILE]

Everything runs between real processes over DDS on this machine, in a ROS domain of its own:
the three ring nodes and both action servers, idle first, then with an identification running.
Latency is from the stamp a driver process gives a load sample to the arrival of its residual in
this process: three hops. Beside it, what a plain rclpy node makes of the same five topics:
ordinary subscriptions, SingleThreadedExecutor.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable, Iterator
import contextlib
import functools
import json
import os
from pathlib import Path
import subprocess
import sys
import tempfile
import time
from typing import Any

import numpy as np
import rclpy
from rclpy.action import ActionClient
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rclpy.serialization import deserialize_message
from std_srvs.srv import Trigger

from saddlering_interfaces.action import IdentifyRing
from saddlering_interfaces.msg import ReplayProgress, RingDisplacement
from saddlering_ros.bags import write_bag
from saddlering_ros.bags.messages import decode_displacements, encode_samples
from saddlering_ros.record import LOAD_TOPIC, PROBE_TOPICS, TestMetadata
from saddlering_ros.record.samples import Samples
from saddlering_ros.record.topics import LOAD, PROBES
from saddlering_ros.rig import default_rig, ParameterSet, TRUE_TO_SCALE
from saddlering_ros.ring import simulate
from saddlering_ros.ros.launcher import ACTION_NODES, NodeGroup, RING_NODES, start_nodes
from saddlering_ros.ros.messages import to_stamp
from saddlering_ros.ros.names import PROGRESS
from saddlering_ros.ros.raw_topics import DataWait, RawPublisher, RawSubscription

RATE = 1000.0

Beside = Callable[[NodeGroup], contextlib.AbstractContextManager[None]]


def course(seconds: float, rate: float = RATE) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Time (N,) [s], load (N,) [N] and gaps (4, N) [m] of a dynamic run at `rate` [Hz]."""
    rig = default_rig()
    times = np.arange(round(seconds * rate)) / rate
    ramp = seconds / 2 - 1.0
    share = np.clip(np.minimum((times - 1.0) / ramp, (seconds - 1.0 - times) / ramp), 0.0, 1.0)
    load = rig.preload + 235e3 * share
    found = simulate(rig, ParameterSet(TRUE_TO_SCALE), np.radians(50.0), times, load)
    return times, load, np.float64(np.float32(1e-3 + found.probes))


def drive(seconds: float, rate: float = RATE, published: Path | None = None) -> None:
    """A driver: five topics, each sample stamped and published on its own when its time comes.

    It waits until its own writers know their readers: a reader can know the writer first, and
    what is written before the writer knows of it never reaches that reader. It keeps in
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
    start = time.time_ns() + 1_000_000_000
    stamps = start + np.round(times * 1e9).astype(np.int64)
    messages = [encode_samples(Samples(stamps, load), LOAD)]
    messages += [encode_samples(Samples(stamps, gap, 0.0, 2e-3), topic)
                 for topic, gap in zip(PROBES, gaps, strict=True)]
    late = 0
    kept = np.stack([stamps, stamps])
    for index, stamp in enumerate(stamps.tolist()):
        wait = stamp - time.time_ns()
        late = max(late, -wait)
        if wait > 0:
            time.sleep(wait / 1e9)
        kept[1, index] = time.time_ns()
        for flow, series in zip(flows, messages, strict=True):
            flow.send([series[index]], stamp)
    if published:
        np.save(published, kept)
    print(late / 1e6, flush=True)
    time.sleep(1.0)


def plain(seconds: float, rate: float = RATE) -> None:
    """What a plain node receives of the five topics: the stamp and the time of each callback."""
    from geometry_msgs.msg import WrenchStamped
    from rclpy.qos import QoSProfile
    from sensor_msgs.msg import Range
    rclpy.init()
    node = Node('plain')
    calls: dict[str, list[tuple[int, int]]] = {
        topic: [] for topic in (LOAD_TOPIC, *PROBE_TOPICS)}

    def callback(topic: str) -> Any:
        kept = calls[topic]

        def note(message: Any) -> None:
            kept.append((to_stamp(message.header.stamp), time.time_ns()))
        return note

    qos = QoSProfile(depth=1000)
    node.create_subscription(WrenchStamped, LOAD_TOPIC, callback(LOAD_TOPIC), qos)
    for topic in PROBE_TOPICS:
        node.create_subscription(Range, topic, callback(topic), qos)
    print('ready', flush=True)
    end = time.monotonic() + seconds + 25.0
    expected = 5 * round(seconds * rate)
    received, last = 0, end
    while received < expected and time.monotonic() < min(end, last + 3.0):
        rclpy.spin_once(node, timeout_sec=1.0)
        before, received = received, sum(map(len, calls.values()))
        last = time.monotonic() if received > before else last
    print(json.dumps({'calls': calls, 'cpu': time.process_time()}), flush=True)


class Calls:
    """Callbacks of the plain node: stamps and times [ns] by topic (2, N)."""

    def __init__(self, said: dict[str, Any]) -> None:
        self._topics = [np.array(calls, np.int64).reshape(-1, 2).T
                        for calls in said['calls'].values()]

    @property
    def count(self) -> int:
        """How many there were."""
        return sum(calls.shape[1] for calls in self._topics)

    @property
    def of_load(self) -> np.ndarray:
        """Those of the load alone, which is published first of the five."""
        return self._topics[0]

    @property
    def of_all(self) -> np.ndarray:
        """Those of all five topics."""
        return np.concatenate(self._topics, axis=1)

    @property
    def complete(self) -> np.ndarray:
        """The last of the five of each stamp: then a node has what a residual needs."""
        common = functools.reduce(np.intersect1d, [calls[0] for calls in self._topics])
        return np.stack([common, np.max(
            [calls[1][np.searchsorted(calls[0], common)] for calls in self._topics], axis=0)])


def busy() -> float:
    """Processor time [s] that this machine has spent since its start on anything."""
    fields = [int(word) for word in Path('/proc/stat').read_text().split('\n', 1)[0].split()[1:9]]
    return (sum(fields) - fields[3] - fields[4]) / os.sysconf('SC_CLK_TCK')


def cpu_of(pid: int) -> float:
    """Processor time a process has used [s]."""
    fields = Path(f'/proc/{pid}/stat').read_text().rpartition(')')[2].split()
    return (int(fields[11]) + int(fields[12])) / os.sysconf('SC_CLK_TCK')


def cpu_by_thread(pid: int) -> tuple[float, float]:
    """Processor time [s] of a process's main thread, and of the threads of its middleware."""
    used = {}
    for task in Path(f'/proc/{pid}/task').iterdir():
        fields = (task / 'stat').read_text().rpartition(')')[2].split()
        used[int(task.name)] = (int(fields[11]) + int(fields[12])) / os.sysconf('SC_CLK_TCK')
    own = used.pop(pid)
    return own, sum(used.values())


@contextlib.contextmanager
def listener(domain: int) -> Any:
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


@contextlib.contextmanager
def idle_servers(group: NodeGroup) -> Iterator[None]:
    """Nothing runs beside the stream."""
    yield


class Identifier:
    """A client of /identify_ring with one goal, asked for as a client does, until it runs."""

    def __init__(self, context: Any, goal: IdentifyRing.Goal) -> None:
        self.node = Node('identifier', context=context)
        self.executor = SingleThreadedExecutor(context=context)
        self.executor.add_node(self.node)
        self.client = ActionClient(self.node, IdentifyRing, '/identify_ring')
        self.client.wait_for_server(60.0)
        running: list[Any] = []
        self._sent = self.client.send_goal_async(goal, feedback_callback=running.append)
        self.executor.spin_until_future_complete(self._sent, 30.0)
        self._ended = self._sent.result().get_result_async()
        while not running and not self._ended.done():
            self.executor.spin_once(0.1)

    def cancel(self) -> float:
        """How long it takes from asking for it to the result [s]."""
        for _ in range(10):  # the feedback that has come in the meantime
            self.executor.spin_once(0.05)
        if self._ended.done():
            raise SystemExit(f'the goal ended by itself: {self._ended.result().result.message}')
        asked = time.monotonic()
        self._sent.result().cancel_goal_async()
        self.executor.spin_until_future_complete(self._ended, 30.0)
        return time.monotonic() - asked

    def close(self) -> None:
        self.executor.shutdown(timeout_sec=0.0)
        self.client.destroy()
        self.node.destroy_node()


@contextlib.contextmanager
def identifying(domain: int, goal: IdentifyRing.Goal) -> Iterator[Identifier]:
    """A goal that runs; the block may cancel it."""
    context = rclpy.Context()
    rclpy.init(context=context, domain_id=domain)
    try:
        with contextlib.closing(Identifier(context, goal)) as one:
            yield one
    finally:
        rclpy.shutdown(context=context)


@contextlib.contextmanager
def running_identification(group: NodeGroup) -> Iterator[None]:
    """An identification that outlasts the stream runs beside it."""
    goal = IdentifyRing.Goal(bags=['dynamic_70'], particles=400, iterations=1_000_000)
    with identifying(group.domain_id, goal) as one:
        yield
        one.cancel()


def in_real_time(seconds: float, beside: Beside) -> dict[str, Any]:
    """Five topics at 1 kHz from a driver, all nodes running."""
    with NodeGroup() as group, listener(group.domain_id) as (node, residual, progress):
        for name in (*RING_NODES, *ACTION_NODES):
            group.start(name)
        driver = subprocess.Popen(
            [sys.executable, __file__, '--role', 'drive', '--seconds', str(seconds)],
            env=group.environment, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True)
        wait_matched(progress)
        with beside(group):
            return streamed(seconds, group, driver, node, residual)


def streamed(seconds: float, group: NodeGroup, driver: subprocess.Popen[str], node: Node,
             residual: RawSubscription) -> dict[str, Any]:
    """What becomes of the driver's samples, and what it costs."""
    before = {name: cpu_of(one.process.pid) for name, one in group.processes.items()}
    assert driver.stdin is not None
    assert driver.stdout is not None
    began = time.monotonic()
    driver.stdin.write('2 1 1 1 1\n')
    driver.stdin.flush()
    stamps, arrivals = receive(node, [residual], round(seconds * RATE), seconds + 20.0)
    took = time.monotonic() - began
    used = {name: (cpu_of(one.process.pid) - before[name]) / took
            for name, one in group.processes.items()}
    late = float(driver.stdout.readline())
    driver.wait()
    settled = stamps > stamps[0] + 1e9  # the zero window's rows wait for it by design
    delays = (arrivals - stamps)[settled] / 1e6
    sent = 5 * round(seconds * RATE)
    return {'raw messages a second': sent / seconds, 'residuals': len(stamps),
            'residuals lost': round(seconds * RATE) - len(stamps),
            'latency p50 [ms]': float(np.percentile(delays, 50)),
            'latency p99 [ms]': float(np.percentile(delays, 99)),
            'driver late by at most [ms]': late,
            **{f'cpu of {name} [%]': 100.0 * value for name, value in used.items()}}


def receive(node: Node, subscriptions: list[RawSubscription], count: int, seconds: float,
            ) -> tuple[np.ndarray, np.ndarray]:
    """Stamps and arrival times [ns] of residuals."""
    data = DataWait(node.context)
    stamps: list[np.ndarray] = []
    arrivals: list[np.ndarray] = []
    deadline = time.monotonic() + seconds
    while sum(map(len, stamps)) < count and time.monotonic() < deadline:
        data.wait(subscriptions, 0.1)
        messages = subscriptions[0].take()
        if messages:
            now = time.time_ns()
            stamps.append(decode_displacements(messages).stamps)
            arrivals.append(np.full(len(messages), now))
        time.sleep(0.0005)
    return np.concatenate(stamps), np.concatenate(arrivals)


def with_plain_rclpy(seconds: float) -> dict[str, Any]:
    """The same driver and one plain node, nothing else running."""
    with NodeGroup() as group:
        reader = subprocess.Popen(
            [sys.executable, __file__, '--role', 'plain', '--seconds', str(seconds)],
            env=group.environment, stdout=subprocess.PIPE, text=True)
        driver = subprocess.Popen(
            [sys.executable, __file__, '--role', 'drive', '--seconds', str(seconds)],
            env=group.environment, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True)
        assert reader.stdout is not None
        assert driver.stdin is not None
        reader.stdout.readline()
        driver.stdin.write('1 1 1 1 1\n')
        driver.stdin.flush()
        said = json.loads(reader.stdout.readline())
        driver.wait()
        reader.wait()
    calls = Calls(said)
    delays = (calls.of_all[1] - calls.of_all[0]) / 1e6
    sent = 5 * round(seconds * RATE)
    return {'raw messages received': calls.count, 'lost': sent - calls.count,
            'callback latency p50 [ms]': float(np.percentile(delays, 50)),
            'callback latency p99 [ms]': float(np.percentile(delays, 99)),
            'cpu [%] (receives only, computes nothing)': 100.0 * said['cpu'] / seconds}


def in_lockstep(seconds: float) -> dict[str, Any]:
    """A bag of five topics at 1 kHz through all nodes as fast as they follow."""
    times, load, gaps = course(seconds)
    stamps = 1_700_000_000_000_000_000 + np.round(times * 1e9).astype(np.int64)
    with tempfile.TemporaryDirectory() as folder:
        bag = write_bag(Path(folder) / 'bag', TestMetadata('dynamic', 50.0), stamps, load,
                        [stamps + 100_000 * probe for probe in range(4)], list(gaps),
                        default_rig().probes)
        with (start_nodes(bag, start_paused=True) as group,
              listener(group.domain_id) as (node, residual, progress)):
            wait_matched(progress)
            play = node.create_client(Trigger, '/replay_clock/play')
            play.wait_for_service(30.0)
            answer = play.call_async(Trigger.Request())
            before = threads_of(group)
            found, arrivals = receive(node, [residual], round(seconds * RATE) - 1, 120.0)
            after = threads_of(group)
            used = float(sum((after[name] - before[name]).sum() for name in after))
            answer.cancel()
            group.wait('replay_clock', 60.0)
    took = (arrivals[-1] - arrivals[0]) / 1e9
    span = (found[-1] - found[np.searchsorted(arrivals, arrivals[0], side='right') - 1]) / 1e9
    return {'residuals': len(found), 'residuals lost': round(seconds * RATE) - 1 - len(found),
            'times real time': span / took, 'raw messages a second': 5 * RATE * span / took,
            'raw messages a processor second, all nodes': 5 * len(found) / used,
            **{f'{name}, {part} [s]': float(seconds) for name in after
               for part, seconds in zip(('Python', 'middleware'), after[name] - before[name],
                                        strict=True)}}


def threads_of(group: NodeGroup) -> dict[str, np.ndarray]:
    """Processor time [s] of each node so far: main thread, middleware."""
    return {name: np.array(cpu_by_thread(one.process.pid))
            for name, one in group.processes.items()}


def to_cancel() -> dict[str, Any]:
    """From asking for the cancel of a running identification to its result."""
    times, load, gaps = course(10.0)
    stamps = 1_700_000_000_000_000_000 + np.round(times * 1e9).astype(np.int64)
    noise = np.random.default_rng(0).normal(0.0, 3e-7, gaps.shape)
    seconds = []
    with tempfile.TemporaryDirectory() as folder, NodeGroup() as group:
        write_bag(Path(folder) / 'bag', TestMetadata('dynamic', 50.0), stamps, load, [stamps] * 4,
                  list(np.float64(np.float32(gaps + noise))), default_rig().probes)
        group.start('ring_identification', {'bag_root': folder})
        for seed in range(5):
            goal = IdentifyRing.Goal(bags=['bag'], particles=400, iterations=2000, seed=seed)
            with identifying(group.domain_id, goal) as one:
                seconds.append(one.cancel())
    return {'cancel of an identification, median [ms]': 1e3 * float(np.median(seconds)),
            'slowest of 5 [ms]': 1e3 * max(seconds)}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument('--seconds', type=float, default=20.0)
    parser.add_argument('--json', type=Path)
    parser.add_argument('--role', choices=('drive', 'plain'), help=argparse.SUPPRESS)
    parser.add_argument('--rate', type=float, default=RATE, help=argparse.SUPPRESS)
    parser.add_argument('--published', type=Path, help=argparse.SUPPRESS)
    args = parser.parse_args()
    if args.role == 'drive':
        drive(args.seconds, args.rate, args.published)
        return
    if args.role == 'plain':
        plain(args.seconds, args.rate)
        return
    figures = {}
    print(f'{os.cpu_count()} cores, load average before: {os.getloadavg()[0]:.1f}')
    for title, measure in [
            ('real time, five topics at 1 kHz, all nodes',
             lambda: in_real_time(args.seconds, idle_servers)),
            ('real time, five topics at 1 kHz, all nodes, while one identifies',
             lambda: in_real_time(args.seconds, running_identification)),
            ('the same topics, plain rclpy node', lambda: with_plain_rclpy(args.seconds)),
            ('lockstep', lambda: in_lockstep(args.seconds)), ('cancel', to_cancel)]:
        figures[title] = measure()
        print(f'\n{title}')
        for name, value in figures[title].items():
            print(f'  {name:45} {value:12.2f}' if isinstance(value, float)
                  else f'  {name:45} {value:12d}', flush=True)
    if args.json:
        args.json.write_text(json.dumps(figures, indent=2) + '\n')


if __name__ == '__main__':
    main()
