"""Print the residual once a second: measured minus simulated displacement, in micrometres.

    python examples/residual_listener.py
"""

import rclpy
from rclpy.executors import ExternalShutdownException
from rclpy.node import Node
from rclpy.qos import QoSProfile

from saddlering_interfaces.msg import RingDisplacement


class ResidualListener(Node):
    def __init__(self) -> None:
        super().__init__('residual_listener')
        self.latest: RingDisplacement | None = None
        self.count = 0
        self.create_subscription(RingDisplacement, '/ring/residual', self.hear,
                                 QoSProfile(depth=1000))
        self.create_timer(1.0, self.tell)

    def hear(self, message: RingDisplacement) -> None:
        self.latest, self.count = message, self.count + 1

    def tell(self) -> None:
        if self.latest is None:
            print('nothing yet')
            return
        one, stamp = self.latest, self.latest.header.stamp
        print(f'{stamp.sec}.{stamp.nanosec:09d}  delta_x {one.delta_x * 1e6:8.2f} um  '
              f'delta_y {one.delta_y * 1e6:8.2f} um  gamma {one.gamma * 1e6:8.2f} urad  '
              f'({self.count} messages)')
        self.count = 0


rclpy.init()
try:
    rclpy.spin(ResidualListener())
except (KeyboardInterrupt, ExternalShutdownException):
    rclpy.try_shutdown()
