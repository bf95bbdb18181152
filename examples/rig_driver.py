"""A driver of the rig in rclpy: replace `Daq` by your device; everything else can stay.

    python examples/rig_driver.py          then, in another terminal: saddlering check-driver

A DAQ hands over blocks of samples. Each sample is stamped with the time of its measurement, by the
device's sample count, not with the time at which its block is read.
"""

import math
import random
import signal
import time

from builtin_interfaces.msg import Time
from geometry_msgs.msg import WrenchStamped
import rclpy
from rclpy.node import Node
from rclpy.qos import QoSProfile
from rclpy.signals import SignalHandlerOptions
from sensor_msgs.msg import Range

RATE = 200  # samples a second of each channel
MIN_RANGE, MAX_RANGE = 0.0, 2e-3  # m, of the probes
PRELOAD = 4903.325  # N


class Daq:
    """Stands for the device: a load at preload and four gaps, with noise."""

    def __init__(self) -> None:
        self.started = time.time_ns()  # of sample 0, by a clock that is synchronised
        self.count = 0

    def read(self) -> list[tuple[int, float, list[float]]]:
        """The samples since the last call: time [ns], load [N], four gaps [m]."""
        due = (time.time_ns() - self.started) * RATE // 1_000_000_000
        first, self.count = self.count, due
        return [(self.started + number * 1_000_000_000 // RATE,
                 PRELOAD + random.gauss(0.0, 20.0),
                 [1e-3 + random.gauss(0.0, 3e-7) for _ in range(4)])
                for number in range(first, due)]


class RigDriver(Node):
    """Publishes the five topics; relative names, so that a namespace goes before them."""

    def __init__(self, daq: Daq) -> None:
        super().__init__('rig_driver')
        self.daq = daq
        every_sample = QoSProfile(depth=5000)  # reliable: nothing is lost while a reader is busy
        self.load = self.create_publisher(WrenchStamped, 'rig/hydraulic_load', every_sample)
        self.probes = [self.create_publisher(Range, f'rig/eddy_current_{number}', every_sample)
                       for number in (1, 2, 3, 4)]
        self.create_timer(0.01, self.publish)

    def publish(self) -> None:
        for stamp, load, gaps in self.daq.read():
            measured = Time(sec=stamp // 1_000_000_000, nanosec=stamp % 1_000_000_000)
            wrench = WrenchStamped()
            wrench.header.stamp, wrench.header.frame_id = measured, 'hydraulic_cylinder'
            wrench.wrench.force.x = load  # positive: the cylinder pushes
            self.load.publish(wrench)
            for number, (probe, gap) in enumerate(zip(self.probes, gaps, strict=True), 1):
                if math.isfinite(gap):  # leave out what was not measured
                    reading = Range(min_range=MIN_RANGE, max_range=MAX_RANGE, range=gap)
                    reading.header.stamp = measured
                    reading.header.frame_id = f'eddy_current_{number}'
                    probe.publish(reading)


# On Ctrl-C the block in hand is finished first; rclpy's own handler would break into it.
rclpy.init(signal_handler_options=SignalHandlerOptions.NO)
told_to_stop: list[int] = []  # no Event: its lock can stop a second handler
for number in (signal.SIGINT, signal.SIGTERM):
    signal.signal(number, lambda number, _: told_to_stop.append(number))
driver = RigDriver(Daq())
while not told_to_stop:
    rclpy.spin_once(driver, timeout_sec=0.1)
driver.destroy_node()
rclpy.shutdown()
