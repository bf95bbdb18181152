"""Node hydraulic_load: replays the cylinder's load from a bag, in place of a driver."""

from saddlering_ros.ros.bag_replay import ReplayNode
from saddlering_ros.ros.streaming_node import executable


class LoadReplay(ReplayNode):
    """Publishes rig/hydraulic_load, and rig/elevation of a bag that holds it."""

    NAME = 'hydraulic_load'


main = executable(LoadReplay)

if __name__ == '__main__':
    main()
