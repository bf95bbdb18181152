"""Print the residual once a second: measured minus simulated displacement, in micrometres.

    python examples/residual_listener.py
"""

import signal

import rclpy
from rclpy.node import Node
from rclpy.qos import QoSProfile
from rclpy.signals import SignalHandlerOptions

from saddlering_interfaces.msg import RingDisplacement


class ResidualListener(Node):
    def __init__(self) -> None:
        super().__init__('residual_listener')
        self.latest: RingDisplacement | None = None
        self.count = 0
        self.create_subscription(RingDisplacement, 'ring/residual', self.hear,
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


# On Ctrl-C the message in hand is finished first; rclpy's own handler would break into it.
rclpy.init(signal_handler_options=SignalHandlerOptions.NO)
told_to_stop: list[int] = []  # no Event: its lock can stop a second handler
signal.signal(signal.SIGINT, lambda number, _: told_to_stop.append(number))
listener = ResidualListener()
while not told_to_stop:
    rclpy.spin_once(listener, timeout_sec=0.1)
listener.destroy_node()
rclpy.shutdown()
