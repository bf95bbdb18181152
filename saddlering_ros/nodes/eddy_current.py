"""Node eddy_current: replays the four probes from a bag, in place of a driver."""

from __future__ import annotations

from collections.abc import Sequence
import sys

from sensor_msgs.msg import Range

from saddlering_ros.bags import PROBE_TOPICS
from saddlering_ros.ros.bag_replay import ReplayNode
from saddlering_ros.ros.run import run_streaming
from saddlering_ros.streams import wire


class ProbeReplay(ReplayNode):
    """Publishes /rig/eddy_current_1 to /rig/eddy_current_4."""

    TOPICS = PROBE_TOPICS
    MESSAGE = Range

    def __init__(self) -> None:
        super().__init__('eddy_current')

    def encode(self, samples: wire.Samples, frame_id: str) -> list[bytes]:
        """Range messages."""
        return wire.encode_gaps(samples, frame_id)


def main(args: Sequence[str] | None = None) -> None:
    """Run the node."""
    sys.exit(run_streaming(ProbeReplay, args))


if __name__ == '__main__':
    main()
