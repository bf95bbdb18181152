"""Throughput as a ratio: all nodes in lockstep against one plain rclpy node, in turns.

    python benchmarks/throughput.py [--seconds 10] [--rounds 3] [--profile] [--json FILE]

Both read the same five topics on this machine. The plain node has ordinary subscriptions on a
SingleThreadedExecutor and computes nothing; a process publishes to it as fast as it can. The nodes
(two that replay, displacement, simulation, residual, clock) take a bag as fast as they
follow, and lose nothing. Latency is compared at 1 kHz a topic: from the stamp of a load sample to
its residual, and to the callback of the plain node. With --profile, what each node's time
goes into, by function.
"""

from __future__ import annotations

import argparse
import contextlib
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
from ros_load import course, idle_servers, in_lockstep, in_real_time, RATE, with_plain_rclpy

from saddlering_ros.bags import LOAD_TOPIC, PROBE_TOPICS, TestFacts, write_bag
from saddlering_ros.bags.topics import LOAD, PROBES
from saddlering_ros.rig import default_rig
from saddlering_ros.ros.launcher import NodeGroup, start_nodes
from saddlering_ros.ros.raw_topics import RawPublisher
from saddlering_ros.streams import batches

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


def flood(seconds: float) -> None:
    """Publish the five topics in turn as fast as the middleware takes them."""
    from geometry_msgs.msg import WrenchStamped
    import rclpy
    from rclpy._rclpy_pybind11 import RCLError
    from rclpy.qos import HistoryPolicy, QoSProfile
    from sensor_msgs.msg import Range
    rclpy.init()
    node = rclpy.create_node('flood')
    qos = QoSProfile(history=HistoryPolicy.KEEP_ALL)
    flows = [RawPublisher(node, LOAD_TOPIC, WrenchStamped, qos)]
    flows += [RawPublisher(node, topic, Range, qos) for topic in PROBE_TOPICS]
    while any(not flow.subscriptions() for flow in flows):
        time.sleep(0.01)
    _, load, gaps = course(4.0)
    stamps = time.time_ns() + np.arange(len(load)) * 1_000_000
    series = [batches.encode_samples(batches.Samples(stamps, load), LOAD)]
    series += [batches.encode_samples(batches.Samples(stamps, gap, 0.0, 2e-3), topic)
               for topic, gap in zip(PROBES, gaps, strict=True)]
    end = time.monotonic() + seconds + 2.0
    while time.monotonic() < end:
        for messages in zip(*series, strict=True):
            for flow, message in zip(flows, messages, strict=True):
                with contextlib.suppress(RCLError):  # the reader's queue has been full for 0.1 s
                    flow.send([message], 1)


def receive(seconds: float) -> None:
    """Count what ordinary subscriptions receive in `seconds` of a flood."""
    from geometry_msgs.msg import WrenchStamped
    import rclpy
    from rclpy.qos import QoSProfile
    from sensor_msgs.msg import Range
    rclpy.init()
    node = rclpy.create_node('plain')
    count = 0

    def on_message(_: Any) -> None:
        nonlocal count
        count += 1

    qos = QoSProfile(depth=1000)
    node.create_subscription(WrenchStamped, LOAD_TOPIC, on_message, qos)
    for topic in PROBE_TOPICS:
        node.create_subscription(Range, topic, on_message, qos)
    while count < 1000:
        rclpy.spin_once(node, timeout_sec=1.0)
    count, began = 0, time.monotonic()
    while time.monotonic() - began < seconds:
        rclpy.spin_once(node, timeout_sec=1.0)
    print(count / (time.monotonic() - began), flush=True)


def plain_rate(seconds: float) -> float:
    """Messages a second that a plain node receives when as many come as it can take."""
    with NodeGroup() as group:
        command = [sys.executable, __file__, '--seconds', str(seconds), '--role']
        reader = subprocess.Popen([*command, 'receive'], env=group.environment,
                                  stdout=subprocess.PIPE, text=True)
        source = subprocess.Popen([*command, 'flood'], env=group.environment)
        try:
            assert reader.stdout is not None
            return float(reader.stdout.readline())
        finally:
            for process in (reader, source):
                process.kill()
                process.wait()


def profiles(seconds: float) -> dict[str, list[tuple[str, float]]]:
    """Share of each node's time in lockstep by function, the largest first."""
    times, load, gaps = course(seconds)
    stamps = 1_700_000_000_000_000_000 + np.round(times * 1e9).astype(np.int64)
    with tempfile.TemporaryDirectory() as folder:
        kept = Path(folder) / 'profiles'
        kept.mkdir()
        (kept / 'sitecustomize.py').write_text(PROFILER)
        bag = write_bag(Path(folder) / 'bag', TestFacts('dynamic', 50.0), stamps, load,
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
    parser.add_argument('--no-latency', action='store_true')
    parser.add_argument('--json', type=Path)
    parser.add_argument('--role', choices=('flood', 'receive'), help=argparse.SUPPRESS)
    args = parser.parse_args()
    if args.role:
        {'flood': flood, 'receive': receive}[args.role](args.seconds)
        return
    print(f'{os.cpu_count()} cores, load average before: {os.getloadavg()[0]:.1f}')
    found: dict[str, Any] = {'rounds': []}
    for number in range(args.rounds):
        alone = plain_rate(args.seconds)
        together = in_lockstep(args.seconds)
        one = {'plain [1/s]': alone, 'lockstep [1/s]': together['raw messages a second'],
               'lost': together['residuals lost'],
               'ratio': together['raw messages a second'] / alone,
               'load average': os.getloadavg()[0]}
        found['rounds'].append(one)
        print(f'round {number + 1}: ' + ', '.join(
            f'{name} {value:.4g}' for name, value in one.items()), flush=True)
    if not args.no_latency:
        plain, nodes = (with_plain_rclpy(args.seconds), in_real_time(args.seconds, idle_servers))
        found['latency'] = {
            'callback p99 [ms]': plain['callback latency p99 [ms]'],
            'residual p99 [ms]': nodes['latency p99 [ms]'],
            'lost by the plain node': plain['lost'],
            'residuals lost': nodes['residuals lost']}
        print(f'at {RATE:g} Hz a topic: {found["latency"]}', flush=True)
    if args.profile:
        found['profiles'] = profiles(args.seconds)
        for name, functions in found['profiles'].items():
            print(f'{name}: ' + ', '.join(f'{words} {100 * share:.0f} %'
                                          for words, share in functions))
    if args.json:
        args.json.write_text(json.dumps(found, indent=2) + '\n')


if __name__ == '__main__':
    main()
