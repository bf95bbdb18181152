"""Node hydraulic_load: replays the cylinder's load from a bag, in place of a driver."""

from __future__ import annotations

from collections.abc import Sequence
import sys

from geometry_msgs.msg import WrenchStamped

from saddlering_ros.bags import LOAD_TOPIC
from saddlering_ros.nodes import wire
from saddlering_ros.nodes.replay import ReplayNode
from saddlering_ros.nodes.run import run_streaming


class HydraulicLoadNode(ReplayNode):
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
    sys.exit(run_streaming(HydraulicLoadNode, args))


if __name__ == '__main__':
    main()
