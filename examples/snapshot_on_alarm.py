"""Write the newest messages as a bag when the alarm comes: `ros2 bag record` keeps them in memory.

    ros2 bag record --snapshot-mode --all --max-cache-size 500000000
    python examples/snapshot_on_alarm.py [SERVICE]      default: /rosbag2_recorder/snapshot

Needs rosbag2_interfaces, which every ROS 2 with rosbag2 has.
"""

import contextlib
import sys

import rclpy
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, QoSProfile
from rosbag2_interfaces.srv import Snapshot

from saddlering_interfaces.msg import RingAlarm

AFTER = 2.0
"""Time [s] after the alarm that is kept too."""


class SnapshotOnAlarm(Node):
    def __init__(self, service: str) -> None:
        super().__init__('snapshot_on_alarm')
        self.is_raised = True  # a latched alarm of before is no reason to write
        self.recorder = self.create_client(Snapshot, service)
        self.waiting = None
        self.create_subscription(RingAlarm, 'ring/alarm', self.hear, QoSProfile(
            depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL))

    def hear(self, message: RingAlarm) -> None:
        was_raised, self.is_raised = self.is_raised, message.state == RingAlarm.ALARM
        if self.is_raised and not was_raised and self.waiting is None:
            self.waiting = self.create_timer(AFTER, self.write)

    def write(self) -> None:
        self.waiting.cancel()
        self.waiting = None
        if not self.recorder.service_is_ready():
            print(f'{self.recorder.srv_name}: not there: start ros2 bag record --snapshot-mode')
            return
        self.recorder.call_async(Snapshot.Request()).add_done_callback(
            lambda done: print('written' if done.result().success else 'the recorder refused'))


rclpy.init()
node = SnapshotOnAlarm(sys.argv[1] if sys.argv[1:] else '/rosbag2_recorder/snapshot')
with contextlib.suppress(KeyboardInterrupt):
    rclpy.spin(node)
