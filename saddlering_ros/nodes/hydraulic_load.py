"""Node hydraulic_load: replays the cylinder's load from a bag, in place of a driver."""

from __future__ import annotations

from collections.abc import Sequence
import sys

from geometry_msgs.msg import WrenchStamped

from saddlering_ros.bags import LOAD_TOPIC
from saddlering_ros.ros.bag_replay import ReplayNode
from saddlering_ros.ros.run import run_streaming
from saddlering_ros.streams import wire


class LoadReplay(ReplayNode):
    """Publishes /rig/hydraulic_load."""

    TOPICS = (LOAD_TOPIC,)
    MESSAGE = WrenchStamped

    def __init__(self) -> None:
        super().__init__('hydraulic_load')

    def encode(self, samples: wire.Samples, frame_id: str) -> list[bytes]:
        """WrenchStamped messages."""
        return wire.encode_loads(samples, frame_id)


def main(args: Sequence[str] | None = None) -> None:
    """Run the node."""
    sys.exit(run_streaming(LoadReplay, args))


if __name__ == '__main__':
    main()
