"""Node eddy_current: replays the four probes from a bag, in place of a driver."""

from saddlering_ros.ros.bag_replay import ReplayNode
from saddlering_ros.ros.streaming_node import executable


class ProbeReplay(ReplayNode):
    """Publishes rig/eddy_current_1 to rig/eddy_current_4."""

    NAME = 'eddy_current'


main = executable(ProbeReplay)

if __name__ == '__main__':
    main()
