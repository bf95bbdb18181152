"""Bags in and out: reading, alignment, plateaus, writing, and the faults of a bag.

Writing is imported when it is first used: its libraries take a quarter of a second.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from saddlering_ros.bags.alignment import align, seconds, seconds_array
from saddlering_ros.bags.condense import condensed, fit_limit
from saddlering_ros.bags.errors import BagError
from saddlering_ros.bags.facts import FoundFacts, TestFacts
from saddlering_ros.bags.info import bag_info, BagInfo, TopicInfo
from saddlering_ros.bags.measured import displacement_of_run, MeasuredRun
from saddlering_ros.bags.plateaus import plateau_means, PlateauMeans, Plateaus, plateaus
from saddlering_ros.bags.reader import RawRecord, RawTopic, read_raw, read_run, TestRun
from saddlering_ros.bags.repeats import refuse_repeats
from saddlering_ros.bags.same_rig import refuse_other_rig, rig_in_words
from saddlering_ros.bags.stream_aligner import AlignedRow, AlignmentCounters, StreamAligner
from saddlering_ros.bags.topics import LOAD_TOPIC, PROBE_TOPICS, RIG_TOPICS
from saddlering_ros.lazy_names import names_on_first_use

if TYPE_CHECKING:
    from saddlering_ros.bags.writer import write_bag

__all__ = [
    'LOAD_TOPIC', 'PROBE_TOPICS', 'RIG_TOPICS', 'AlignedRow', 'AlignmentCounters', 'BagError',
    'BagInfo', 'FoundFacts', 'MeasuredRun', 'PlateauMeans', 'Plateaus', 'RawRecord', 'RawTopic',
    'StreamAligner', 'TestFacts', 'TestRun', 'TopicInfo', 'align', 'bag_info',
    'condensed', 'displacement_of_run', 'fit_limit', 'plateau_means', 'plateaus', 'read_raw',
    'read_run', 'refuse_other_rig', 'refuse_repeats', 'rig_in_words', 'seconds', 'seconds_array',
    'write_bag',
]

__getattr__ = names_on_first_use(__name__, {'write_bag': 'writer'})
