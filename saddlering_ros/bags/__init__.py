"""The format of bags: reading and writing.

Every name is imported when it is first used. A node that decodes topics imports `bags.wire` only,
and no library of a file format.
"""

from typing import TYPE_CHECKING

from saddlering_ros import names_on_first_use

if TYPE_CHECKING:
    from saddlering_ros.bags.reader import bag_info, BagInfo, read_raw, read_run, TopicInfo
    from saddlering_ros.bags.write import write_bag

__all__ = ['BagInfo', 'TopicInfo', 'bag_info', 'read_raw', 'read_run', 'write_bag']

__getattr__ = names_on_first_use(__name__, {
    'BagInfo': 'reader', 'TopicInfo': 'reader', 'bag_info': 'reader', 'read_raw': 'reader',
    'read_run': 'reader', 'write_bag': 'write'})
