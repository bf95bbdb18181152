"""A driver process that publishes the five raw topics of a known motion."""

from __future__ import annotations

import os
from pathlib import Path
import subprocess
import sys
import time

from geometry_msgs.msg import WrenchStamped
import numpy as np
import rclpy
from sensor_msgs.msg import Range

from saddlering_ros.bags.messages import encode_samples
from saddlering_ros.record import LOAD_TOPIC, PROBE_TOPICS
from saddlering_ros.record.samples import Samples
from saddlering_ros.record.topics import LOAD, PROBES
from saddlering_ros.ros.launcher import NodeGroup
from saddlering_ros.ros.raw_topics import RawPublisher

from .truth import RATE, RIG, Truth

REPOSITORY = Path(__file__).resolve().parents[2]


def drive(speed: float) -> None:
    """Publish the truth's cycle at `speed` times the nominal rate until the parent ends.

    Prints the stamp [ns] at which the cycles begin.
    """
    truth = Truth.make()
    rate = RATE * speed
    rclpy.init()
    node = rclpy.create_node('driver')
    flows = [RawPublisher(node, LOAD_TOPIC, WrenchStamped)]
    flows += [RawPublisher(node, topic, Range) for topic in PROBE_TOPICS]
    start = time.time_ns() + 500_000_000
    print(start, flush=True)
    sent = 0
    count = truth.load.size
    while os.getppid() != 1:
        due = int((time.time_ns() - start) / 1e9 * rate)
        if due > sent:
            index = np.arange(sent, min(due, sent + 2000))
            stamps = start + np.round(index / rate * 1e9).astype(np.int64)
            place = np.round(index / speed).astype(int) % count
            low, high = RIG.probes.min_range, RIG.probes.max_range
            load = Samples(stamps, truth.load[place])
            flows[0].send(encode_samples(load, LOAD), int(stamps[-1]))
            for number, flow in enumerate(flows[1:]):
                samples = Samples(stamps, truth.gaps[number][place], low, high)
                flow.send(encode_samples(samples, PROBES[number]),
                          int(stamps[-1]))
            sent = int(index[-1]) + 1
        time.sleep(0.004)


def start_driver(group: NodeGroup, speed: float = 1.0) -> tuple[subprocess.Popen[str], int]:
    """A driver process, and the stamp at which its first cycle begins."""
    driver = subprocess.Popen(
        [sys.executable, '-m', 'benchmarks.faults.driver', str(speed)], cwd=REPOSITORY,
        env=group.environment, stdout=subprocess.PIPE, text=True)
    assert driver.stdout is not None
    return driver, int(driver.stdout.readline())


if __name__ == '__main__':
    drive(float(sys.argv[1]))
