"""Node eddy_current: replays the four probes from a bag, in place of a driver."""

from saddlering_ros.ros.bag_replay import ReplayNode
from saddlering_ros.ros.streaming_node import executable

main = executable(lambda: ReplayNode('eddy_current'))

if __name__ == '__main__':
    main()
