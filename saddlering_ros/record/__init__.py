"""The record of a test, and the computations from its samples to displacements and plateaus."""

from saddlering_ros.record.aligner import Aligner
from saddlering_ros.record.batches import align, seconds_array
from saddlering_ros.record.displacement import displacement_of_run, MeasuredRun
from saddlering_ros.record.plateaus import plateau_means, Plateaus, plateaus
from saddlering_ros.record.record import (
    condensed,
    fit_limit,
    RawRecord,
    RawTopic,
    Record,
    TestMetadata,
)
from saddlering_ros.record.topics import LOAD_TOPIC, PROBE_TOPICS, RIG_TOPICS

__all__ = [
    'LOAD_TOPIC', 'PROBE_TOPICS', 'RIG_TOPICS', 'Aligner', 'MeasuredRun', 'Plateaus',
    'RawRecord', 'RawTopic', 'Record', 'TestMetadata', 'align', 'condensed',
    'displacement_of_run', 'fit_limit', 'plateau_means', 'plateaus', 'seconds_array',
]
