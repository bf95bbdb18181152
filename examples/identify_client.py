"""Ask /identify_ring for the contact parameters, show its progress, cancel it on Ctrl-C.

    python examples/identify_client.py static_50 dynamic_50      names below the server's bag_root
"""

import signal
import sys

import rclpy
from rclpy.action import ActionClient
from rclpy.signals import SignalHandlerOptions

from saddlering_interfaces.action import IdentifyRing


def show(message: IdentifyRing.Impl.FeedbackMessage) -> None:
    now = message.feedback
    print(f'{now.stage} {now.iteration}/{now.iterations}: best {now.best_objective:.4g}')


def main() -> None:
    rclpy.init(signal_handler_options=SignalHandlerOptions.NO)
    node = rclpy.create_node('identify_client')
    client = ActionClient(node, IdentifyRing, 'identify_ring')
    if not client.wait_for_server(10.0):
        sys.exit('no /identify_ring: start it with ros2 run saddlering_ros ring_identification')
    interrupted: list[int] = []
    signal.signal(signal.SIGINT, lambda number, _: interrupted.append(number))
    sent = client.send_goal_async(IdentifyRing.Goal(bags=sys.argv[1:]), feedback_callback=show)
    rclpy.spin_until_future_complete(node, sent, timeout_sec=10.0)
    if not sent.done():
        sys.exit('no answer of /identify_ring within 10 s: ask again')
    if not sent.result().accepted:
        sys.exit('rejected: the server is busy with another goal')
    ended = sent.result().get_result_async()
    while not ended.done():
        rclpy.spin_once(node, timeout_sec=0.1)
        if not client.server_is_ready():
            sys.exit('the server is gone: start it again, and ask again')
        if interrupted:
            interrupted.clear()
            sent.result().cancel_goal_async()
    result = ended.result().result
    print(result.message)
    if result.status == IdentifyRing.Result.SUCCEEDED:
        for name in ('k1', 'n1', 'd1', 'k2', 'n2', 'd2'):
            print(f'{name} = {getattr(result.parameters, name):.5g}')
    sys.exit(result.status)


main()
