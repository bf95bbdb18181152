"""The choice of the bag of a replay node: any at the start, later those below one folder."""

from __future__ import annotations

from pathlib import Path
from typing import Any, ClassVar

from rcl_interfaces.msg import SetParametersResult
from rclpy.parameter import Parameter as RosParameter

from saddlering_ros.files import share_directory
from saddlering_ros.ros.errors import NodeError
from saddlering_ros.ros.parameters import NodeParameter
from saddlering_ros.ros.roots import bag_below, root_folder
from saddlering_ros.ros.streaming_node import StreamingNode

BAG = NodeParameter(
    'bag', '', 'the bag to replay: a rosbag2 directory or an .mcap file; none: wait',
    changeable=True)
BAG_ROOT = NodeParameter(
    'bag_root', '', 'folder below which every bag must lie that is set while the node runs '
    '(links are resolved first); none: the folder of the bag at the start, else the shipped bags')


class BagNode(StreamingNode):
    """A node that replays a bag.

    Whoever starts it may name any bag. Whoever can reach its services while it runs is not
    trusted that far: what they name must lie below a root, as for goals.
    """

    PARAMETERS: ClassVar[tuple[NodeParameter, ...]] = (BAG, BAG_ROOT)

    def __init__(self, name: str, **options: Any) -> None:
        super().__init__(name, **options)
        self._first_bag = self.settings.text('bag')
        self._bag_root = root_folder(
            self, 'bag_root', Path(self._first_bag).absolute().parent
            if self._first_bag else share_directory() / 'bags')
        self.add_on_set_parameters_callback(self._judge_bag)

    def startable(self) -> bool:
        """Without a bag it waits: a driver of the hardware, or ros2 bag play, may do its work."""
        if not self._first_bag:
            self.get_logger().info(
                'no bag is given, so that nothing is replayed. To replay a bag of '
                f'{self._bag_root}: ros2 param '
                f'set {self.get_fully_qualified_name()} bag PATH, then ros2 lifecycle set')
            return False
        return True

    def bag_path(self) -> str:
        """The bag to replay now; NodeError if there is none, or it may not be read."""
        bag = self.settings.text('bag')
        if not bag:
            raise NodeError(f'{self.get_name()}: parameter bag is empty: give -p bag:=PATH')
        return self._allowed(bag)

    def _allowed(self, bag: str) -> str:
        return bag if bag == self._first_bag else str(bag_below(self._bag_root, bag))

    def _judge_bag(self, changes: list[RosParameter]) -> SetParametersResult:
        for change in changes:
            if change.name == BAG.name and str(change.value).strip():
                try:
                    self._allowed(str(change.value).strip())
                except NodeError as problem:
                    return SetParametersResult(successful=False, reason=str(problem))
        return SetParametersResult(successful=True)
