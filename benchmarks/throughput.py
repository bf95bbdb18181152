"""Throughput as a ratio: all nodes in lockstep against one plain rclpy node, in turns.

    python benchmarks/throughput.py [--seconds 10] [--rounds 3] [--profile] [--json FILE]

Both read the same five topics on this machine. The plain node has ordinary subscriptions on a
SingleThreadedExecutor and computes nothing; a process publishes to it as fast as it takes the
messages. The nodes (two that replay, displacement, simulation, residual, clock) take a bag as fast
as they follow, and lose nothing. On a busy machine six processes get more of it than one: both
rates are therefore given by processor time as well, as if they had all cores to themselves.
Latency is measured in real time on one driver to which the plain node and the nodes listen at the
same time: from the publication of the samples of one moment to the callbacks of the plain node,
and to the arrival of the residual in another process. The plain node has callbacks for five
topics, of which the load is published first; a residual needs all five. Each process has a session
of its own. With --profile, what each node's time goes into, by function.
"""

from __future__ import annotations

import argparse
import json
import os
from pathlib import Path
import pstats
import subprocess
import sys
import tempfile
import time
from typing import Any

import numpy as np
import ros_load
from ros_load import course, in_lockstep, listener, wait_matched

from saddlering_ros.bags import write_bag
from saddlering_ros.bags.messages import encode_samples
from saddlering_ros.record import LOAD_TOPIC, PROBE_TOPICS, TestMetadata
from saddlering_ros.record.samples import Samples
from saddlering_ros.record.topics import LOAD, PROBES
from saddlering_ros.rig import default_rig
from saddlering_ros.ros.launcher import NodeGroup, RING_NODES, start_nodes
from saddlering_ros.ros.raw_topics import RawPublisher

PROFILER = """
import atexit, cProfile, os, sys
if any('saddlering_ros.nodes' in word for word in sys.orig_argv):
    profile = cProfile.Profile()
    profile.enable()
    def keep():
        profile.disable()
        name = next(word for word in sys.orig_argv if 'saddlering_ros.nodes' in word)
        profile.dump_stats(os.path.join(os.environ['PROFILES'], name.rpartition('.')[2]))
    atexit.register(keep)
"""
SHOWN = 6
AHEAD = 900
"""Messages on their way to the plain node: it always has work, and its queues lose none."""


def flood(seconds: float, counter: Path) -> None:
    """Publish the five topics in turn, as far ahead of the reader as its queues hold."""
    from geometry_msgs.msg import WrenchStamped
    import rclpy
    from sensor_msgs.msg import Range
    rclpy.init()
    node = rclpy.create_node('flood')
    flows = [RawPublisher(node, LOAD_TOPIC, WrenchStamped)]
    flows += [RawPublisher(node, topic, Range) for topic in PROBE_TOPICS]
    while any(not flow.subscriptions() for flow in flows):
        time.sleep(0.01)
    _, load, gaps = course(4.0)
    stamps = time.time_ns() + np.arange(len(load)) * 1_000_000
    series = [encode_samples(Samples(stamps, load), LOAD)]
    series += [encode_samples(Samples(stamps, gap, 0.0, 2e-3), topic)
               for topic, gap in zip(PROBES, gaps, strict=True)]
    received = np.memmap(counter, np.int64, 'r')
    sent, end = 0, time.monotonic() + seconds + 30.0
    while time.monotonic() < end:
        for messages in zip(*series, strict=True):
            for flow, message in zip(flows, messages, strict=True):
                flow.send([message], 1)
            sent += len(flows)
            waiting = time.monotonic() + 1.0  # what is lost is not waited for
            while sent - received[0] > AHEAD and time.monotonic() < waiting:
                time.sleep(0.0005)
            sent = min(sent, int(received[0]) + AHEAD)


def receive(seconds: float, counter: Path) -> None:
    """Count what ordinary subscriptions receive in `seconds` of a flood."""
    from geometry_msgs.msg import WrenchStamped
    import rclpy
    from rclpy.executors import SingleThreadedExecutor
    from rclpy.qos import QoSProfile
    from sensor_msgs.msg import Range
    rclpy.init()
    node = rclpy.create_node('plain')
    count = np.memmap(counter, np.int64, 'r+')

    def on_message(_: Any) -> None:
        count[0] += 1

    qos = QoSProfile(depth=1000)
    node.create_subscription(WrenchStamped, LOAD_TOPIC, on_message, qos)
    for topic in PROBE_TOPICS:
        node.create_subscription(Range, topic, on_message, qos)
    executor = SingleThreadedExecutor()
    executor.add_node(node)
    while count[0] < 1000:
        executor.spin_once(1.0)
    before, began, used = int(count[0]), time.monotonic(), time.process_time()
    while time.monotonic() - began < seconds:
        executor.spin_once(1.0)
    received = int(count[0]) - before
    print(json.dumps([received / (time.monotonic() - began),
                      received / (time.process_time() - used)]), flush=True)


def plain_rate(seconds: float) -> tuple[float, float]:
    """Messages a second that a plain node receives when as many come as it can take.

    By the clock, and by the processor: what it would receive with a core to itself.
    """
    with NodeGroup() as group, tempfile.NamedTemporaryFile() as counter:
        counter.write(bytes(8))
        counter.flush()
        command = [sys.executable, __file__, '--seconds', str(seconds), '--counter', counter.name,
                   '--role']
        reader = subprocess.Popen([*command, 'receive'], env=group.environment,
                                  stdout=subprocess.PIPE, text=True)
        source = subprocess.Popen([*command, 'flood'], env=group.environment)
        try:
            assert reader.stdout is not None
            by_clock, by_processor = json.loads(reader.stdout.readline())
            return by_clock, by_processor
        finally:
            for process in (reader, source):
                process.kill()
                process.wait()


def side_by_side(seconds: float, rate: float) -> dict[str, float]:
    """Latency of the plain node's callbacks and of residuals [ms], beside one driver."""
    command = [sys.executable, ros_load.__file__, '--seconds', str(seconds), '--rate', str(rate),
               '--role']
    with (NodeGroup() as group, tempfile.TemporaryDirectory() as folder,
          listener(group.domain_id) as (node, residual, progress)):
        for name in RING_NODES:
            group.start(name)
        kept = Path(folder) / 'published.npy'
        plain = subprocess.Popen([*command, 'plain'], env=group.environment,
                                 stdout=subprocess.PIPE, text=True, start_new_session=True)
        driver = subprocess.Popen([*command, 'drive', '--published', str(kept)],
                                  env=group.environment, stdin=subprocess.PIPE,
                                  stdout=subprocess.PIPE, text=True, start_new_session=True)
        assert plain.stdout is not None
        assert driver.stdin is not None
        plain.stdout.readline()
        wait_matched(progress)
        progress.close()  # as beside a driver, where no clock in lockstep listens
        processes = [os.getpid(), plain.pid, driver.pid,
                     *(one.process.pid for one in group.processes.values())]
        spent, own = ros_load.busy(), sum(ros_load.cpu_of(pid) for pid in processes)
        driver.stdin.write('3 2 2 2 2\n')
        driver.stdin.flush()
        stamps, arrivals = ros_load.receive(node, [residual], round(seconds * rate), seconds + 10)
        said = json.loads(plain.stdout.readline())
        own = sum(ros_load.cpu_of(pid) for pid in processes) - own
        spent = ros_load.busy() - spent
        driver.wait()
        plain.wait()
        published = np.load(kept)
    calls = ros_load.Calls(said)
    found: dict[str, float] = {}
    for name, when in (('callback', calls.of_all), ('callback of the load', calls.of_load),
                       ('last callback of a stamp', calls.complete),
                       ('residual', np.stack([stamps, arrivals]))):
        waited = delays(published, *when)
        found |= {f'{name} p{share} [ms]': float(np.percentile(waited, share))
                  for share in (50, 99)}
    return {**found, 'lost by the plain node': 5 * round(seconds * rate) - calls.count,
            'residuals lost': round(seconds * rate) - len(stamps),
            'processor of other programs [s]': spent - own,
            'load average': os.getloadavg()[0]}


def delays(published: np.ndarray, stamps: np.ndarray, arrivals: np.ndarray) -> np.ndarray:
    """Time from publication to arrival [ms] by stamp; the first 1.5 s, with the zero, left out.

    published (2, N): stamp and time of publication [ns].
    """
    kept = stamps > published[0, 0] + 1_500_000_000
    rows = np.searchsorted(published[0], stamps[kept])
    return np.asarray((arrivals[kept] - published[1][rows]) / 1e6)


def profiles(seconds: float) -> dict[str, list[tuple[str, float]]]:
    """Share of each node's time in lockstep by function, the largest first."""
    times, load, gaps = course(seconds)
    stamps = 1_700_000_000_000_000_000 + np.round(times * 1e9).astype(np.int64)
    with tempfile.TemporaryDirectory() as folder:
        kept = Path(folder) / 'profiles'
        kept.mkdir()
        (kept / 'sitecustomize.py').write_text(PROFILER)
        bag = write_bag(Path(folder) / 'bag', TestMetadata('dynamic', 50.0), stamps, load,
                        [stamps + 100_000 * probe for probe in range(4)], list(gaps),
                        default_rig().probes)
        before = os.environ.copy()
        os.environ |= {'PYTHONPATH': str(kept), 'PROFILES': str(kept)}
        try:
            with start_nodes(bag) as group:
                group.wait('replay_clock', 600.0)
        finally:
            os.environ.clear()
            os.environ.update(before)
        return {file.name: largest(file) for file in sorted(kept.iterdir())
                if file.suffix == '' and file.is_file()}


def largest(file: Path) -> list[tuple[str, float]]:
    """The functions in which most of the time of a node was spent, imports and waits left out."""
    stats = pstats.Stats(str(file)).stats  # type: ignore[attr-defined]
    own = {f'{Path(key[0]).name}:{key[2]}': value[2] for key, value in stats.items()
           if not any(word in key[2] for word in ('wait', 'sleep', 'import', 'compile', 'exec'))
           and 'importlib' not in key[0]}
    total = sum(own.values())
    return sorted(((name, used / total) for name, used in own.items()),
                  key=lambda item: -item[1])[:SHOWN]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument('--seconds', type=float, default=10.0)
    parser.add_argument('--rounds', type=int, default=3)
    parser.add_argument('--profile', action='store_true')
    parser.add_argument('--rate', type=float, default=1000.0, help='of a topic for the latency')
    parser.add_argument('--no-throughput', action='store_true')
    parser.add_argument('--no-latency', action='store_true')
    parser.add_argument('--json', type=Path)
    parser.add_argument('--role', choices=('flood', 'receive'), help=argparse.SUPPRESS)
    parser.add_argument('--counter', type=Path, help=argparse.SUPPRESS)
    args = parser.parse_args()
    if args.role:
        {'flood': flood, 'receive': receive}[args.role](args.seconds, args.counter)
        return
    print(f'{os.cpu_count()} cores, load average before: {os.getloadavg()[0]:.1f}')
    found: dict[str, Any] = {'rounds': []}
    for number in range(0 if args.no_throughput else args.rounds):
        by_clock, by_processor = plain_rate(args.seconds)
        together = in_lockstep(args.seconds)
        rate = together['raw messages a second']
        one = {'plain [1/s]': by_clock, 'plain by a whole core [1/s]': by_processor,
               'lockstep [1/s]': rate,
               'lockstep by all cores [1/s]': os.cpu_count() * together[
                   'raw messages a processor second, all nodes'],
               'lost': together['residuals lost'], 'ratio': rate / by_clock,
               'load average': os.getloadavg()[0]}
        one['ratio by processor time'] = one['lockstep by all cores [1/s]'] / by_processor
        found['rounds'].append({**one, 'nodes': together})
        print(f'round {number + 1}: ' + ', '.join(
            f'{name} {value:.4g}' for name, value in one.items()), flush=True)
        if args.profile:
            print(', '.join(f'{name} {value:.2f}' for name, value in together.items()
                            if name.endswith('[s]')))
    found['latency'] = []
    for number in range(0 if args.no_latency else args.rounds):
        one = side_by_side(args.seconds, args.rate)
        found['latency'].append(one)
        print(f'latency {number + 1}, {args.rate:g} Hz a topic: ' + ', '.join(
            f'{name} {value:.4g}' for name, value in one.items()), flush=True)
    if args.profile:
        found['profiles'] = profiles(args.seconds)
        for name, functions in found['profiles'].items():
            print(f'{name}: ' + ', '.join(f'{words} {100 * share:.0f} %'
                                          for words, share in functions))
    if args.json:
        args.json.write_text(json.dumps(found, indent=2) + '\n')


if __name__ == '__main__':
    main()
