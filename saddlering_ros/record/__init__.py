"""The record of a test, and the computations from its samples to displacements and plateaus."""

from saddlering_ros.record.displacement import displacement_of_run, MeasuredRun
from saddlering_ros.record.plateaus import Plateaus, plateaus
from saddlering_ros.record.record import (
    condensed,
    fit_limit,
    RawRecord,
    RawTopic,
    Record,
    TestMetadata,
)
from saddlering_ros.record.topics import LOAD_TOPIC, PROBE_TOPICS

__all__ = [
    'LOAD_TOPIC', 'PROBE_TOPICS', 'MeasuredRun', 'Plateaus', 'RawRecord', 'RawTopic', 'Record',
    'TestMetadata', 'condensed', 'displacement_of_run', 'fit_limit', 'plateaus',
]
