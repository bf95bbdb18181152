"""A ring whose motion is known: one cycle of load, a bag of it, and a driver that publishes it."""

from __future__ import annotations

from dataclasses import dataclass
import os
from pathlib import Path
import signal
import subprocess
import sys
import time

from geometry_msgs.msg import WrenchStamped
import numpy as np
import rclpy
from sensor_msgs.msg import Range

from benchmarks.frame import ROOT
from benchmarks.rigs import BEGIN, RIG
from saddlering_ros.bags import write_bag
from saddlering_ros.bags.wire import encode_samples
from saddlering_ros.record import LOAD_TOPIC, PROBE_TOPICS, TestMetadata
from saddlering_ros.record.batches import Samples
from saddlering_ros.record.topics import LOAD, PROBES
from saddlering_ros.rig import CHANNELS, ParameterSet, TRUE_TO_SCALE
from saddlering_ros.ring import simulate
from saddlering_ros.ros.launcher import NodeGroup
from saddlering_ros.ros.raw_topics import RawPublisher

ELEVATION = 50.0
RATE = 1000.0
CYCLE = 6.0
REST = 1.2
"""At preload at the beginning of a cycle, and 0.4 s at its end [s]."""

SLIP = 60e-6
"""By which probes 1 and 3 slip at SIGUSR1 [m]."""


@dataclass(frozen=True)
class Truth:
    """One cycle of load that repeats for ever: load [N] (N,), gaps [m] (4, N), motion (4, N)."""

    load: np.ndarray
    gaps: np.ndarray
    motion: np.ndarray

    @classmethod
    def make(cls, rate: float = RATE, cycle: float = CYCLE, rest: float = REST) -> Truth:
        """Rest, up to about 24 t and back; the second of two cycles, in full swing."""
        count = round(cycle * rate)
        time = np.arange(2 * count) / rate
        ramp = (cycle - rest - 0.4) / 2.0
        within = time % cycle
        near_an_end = np.minimum(within - rest, cycle - 0.4 - within) / ramp
        share = np.clip(near_an_end, 0.0, 1.0)
        load = RIG.preload + 230e3 * share
        run = simulate(RIG, ParameterSet(TRUE_TO_SCALE), np.radians(ELEVATION), time, load)
        motion = np.stack([np.asarray(getattr(run.displacement, name)) for name in CHANNELS])
        gaps = 1e-3 + np.asarray(RIG.probes.polarity)[:, None] * run.probes
        return cls(load[-count:], np.float64(np.float32(gaps[:, -count:])), motion[:, -count:])

    def at(self, seconds: np.ndarray, rate: float = RATE) -> np.ndarray:
        """Motion (4, N) at times since a cycle began."""
        place = (seconds * rate) % self.load.size
        whole = np.arange(self.load.size + 1)
        return np.stack([np.interp(place, whole, np.append(row, row[0])) for row in self.motion])


def cycle_bag(folder: Path, truth: Truth, cycles: int, rate: float = RATE) -> tuple[Path, int]:
    """A bag of `cycles` cycles; its path, and its first stamp."""
    count = truth.load.size * cycles
    stamps = BEGIN + np.round(np.arange(count) / rate * 1e9).astype(np.int64)
    bag = write_bag(folder / 'bag', TestMetadata('dynamic', ELEVATION), stamps,
                    np.tile(truth.load, cycles), [stamps] * 4,
                    list(np.tile(truth.gaps, (1, cycles))), RIG.probes)
    return bag, BEGIN


def drive(speed: float, rest: float) -> None:
    """Publish the truth's cycle at `speed` times the nominal rate until the parent ends.

    Prints the stamp [ns] at which the cycles begin.
    """
    slips: list[int] = []
    signal.signal(signal.SIGUSR1, lambda *_: slips.append(1))
    truth = Truth.make(cycle=CYCLE - REST + rest, rest=rest)
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
                slip = (1, 0, -1, 0)[number] * SLIP * bool(slips)
                samples = Samples(stamps, truth.gaps[number][place] + slip, low, high)
                flow.send(encode_samples(samples, PROBES[number]), int(stamps[-1]))
            sent = int(index[-1]) + 1
        time.sleep(0.004)


def start_driver(group: NodeGroup, speed: float = 1.0, rest: float = REST,
                 ) -> tuple[subprocess.Popen[str], int]:
    """A driver process, and the stamp at which its first cycle begins."""
    driver = subprocess.Popen(
        [sys.executable, '-m', 'benchmarks.faults.driver', str(speed), str(rest)],
        cwd=ROOT,
        env=group.environment, stdout=subprocess.PIPE, text=True)
    assert driver.stdout is not None
    return driver, int(driver.stdout.readline())


if __name__ == '__main__':
    drive(*map(float, sys.argv[1:]))
