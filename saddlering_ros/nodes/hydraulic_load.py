"""Node hydraulic_load: replays the cylinder's load from a bag, in place of a driver."""

from __future__ import annotations

from collections.abc import Sequence

from saddlering_ros.ros.bag_replay import ReplayNode
from saddlering_ros.ros.streaming_node import leave, run_streaming


class LoadReplay(ReplayNode):
    """Publishes rig/hydraulic_load, and rig/elevation of a bag that holds it."""

    NAME = 'hydraulic_load'


def main(args: Sequence[str] | None = None) -> None:
    """Run the node."""
    leave(run_streaming(LoadReplay, args))


if __name__ == '__main__':
    main()
