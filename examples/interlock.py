"""Stop the hydraulics on an alarm of ring_alarm, and whenever ring_alarm is not heard.

    python examples/interlock.py

Publishes rig/hydraulics_enabled (std_msgs/Bool, ten times a second): true only while
ring/within_limits is true and not older than 0.5 s. A stop is kept until somebody calls ~/reset,
even if ring_alarm is started again and has forgotten its alarm. A valve driver must treat silence
of this topic as false, too. This is no safety device: keep the limits of the hydraulics.
"""

import signal
import time

import rclpy
from rclpy.node import Node
from rclpy.signals import SignalHandlerOptions
from std_msgs.msg import Bool
from std_srvs.srv import Trigger

SILENCE = 0.5
"""Without a message for so long [s], ring_alarm counts as dead; it publishes every 0.1 s."""

PERIOD = 0.1


class Interlock(Node):
    def __init__(self) -> None:
        super().__init__('interlock')
        self.within_limits = False
        self.heard = -SILENCE  # nothing yet
        self.stopped = 'ring_alarm has not been heard yet: call ~/reset when it runs'
        self.enabled = self.create_publisher(Bool, 'rig/hydraulics_enabled', 1)
        self.create_subscription(Bool, 'ring/within_limits', self.hear, 10)
        self.create_service(Trigger, '~/reset', self.reset)
        self.create_timer(PERIOD, self.tell)
        print(f'stopped: {self.stopped}')

    def hear(self, message: Bool) -> None:
        self.within_limits, self.heard = message.data, time.monotonic()
        if not message.data:
            self.tell()  # at once

    def danger(self) -> str:
        """Why the hydraulics must not run now; '' if they may."""
        if time.monotonic() - self.heard > SILENCE:
            return f'ring_alarm has been silent for more than {SILENCE:g} s'
        return '' if self.within_limits else 'ring_alarm reports an alarm'

    def tell(self) -> None:
        danger = self.danger()
        if danger and not self.stopped:
            self.stopped = danger
            print(f'stopped: {danger}')
        self.enabled.publish(Bool(data=not self.stopped))

    def reset(self, request: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        danger = self.danger()
        response.success = not danger
        response.message = danger or 'enabled'
        if not danger and self.stopped:
            self.stopped = ''
            print('enabled')
        return response


# On Ctrl-C the message in hand is finished first; rclpy's own handler would break into it.
rclpy.init(signal_handler_options=SignalHandlerOptions.NO)
told_to_stop: list[int] = []  # no Event: its lock can stop a second handler
signal.signal(signal.SIGINT, lambda number, _: told_to_stop.append(number))
interlock = Interlock()
while not told_to_stop:
    rclpy.spin_once(interlock, timeout_sec=0.1)
interlock.destroy_node()
rclpy.shutdown()
