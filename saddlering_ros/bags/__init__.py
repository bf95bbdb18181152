"""The format of bags: reading and writing, and the faults of a bag.

Writing is imported when it is first used: its libraries take a quarter of a second.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from saddlering_ros import names_on_first_use
from saddlering_ros.bags.info import bag_info, BagInfo, TopicInfo
from saddlering_ros.bags.reader import read_raw, read_run
from saddlering_ros.bags.repeats import refuse_repeats
from saddlering_ros.bags.same_rig import refuse_other_rig, rig_in_words

if TYPE_CHECKING:
    from saddlering_ros.bags.write import write_bag

__all__ = [
    'BagInfo', 'TopicInfo', 'bag_info', 'read_raw', 'read_run', 'refuse_other_rig',
    'refuse_repeats', 'rig_in_words', 'write_bag',
]

__getattr__ = names_on_first_use(__name__, {'write_bag': 'write'})
