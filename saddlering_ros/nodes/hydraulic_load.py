"""Node hydraulic_load: replays the cylinder's load from a bag, in place of a driver."""

from saddlering_ros.ros.bag_replay import ReplayNode
from saddlering_ros.ros.streaming_node import executable

main = executable(lambda: ReplayNode('hydraulic_load'))

if __name__ == '__main__':
    main()
