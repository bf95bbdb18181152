"""Node eddy_current: replays the four probes from a bag, in place of a driver."""

from __future__ import annotations

from collections.abc import Sequence

from saddlering_ros.ros.bag_replay import ReplayNode
from saddlering_ros.ros.streaming_node import leave, run_streaming


class ProbeReplay(ReplayNode):
    """Publishes rig/eddy_current_1 to rig/eddy_current_4."""

    NAME = 'eddy_current'


def main(args: Sequence[str] | None = None) -> None:
    """Run the node."""
    leave(run_streaming(ProbeReplay, args))


if __name__ == '__main__':
    main()
