"""Whether a ring still behaves as its model while the test runs: innovations and an alarm."""

from saddlering_ros.monitoring.blocks import BlockWatch
from saddlering_ros.monitoring.cause import first_guess, FIRST_GUESSES
from saddlering_ros.monitoring.detector import Alarm, Detector, threshold_of
from saddlering_ros.monitoring.errors import MonitoringError
from saddlering_ros.monitoring.innovations import block_noise, BlockNoise, ChannelInnovations
from saddlering_ros.monitoring.instruments import assumed_noise, least_wander
from saddlering_ros.monitoring.materiality import materiality
from saddlering_ros.monitoring.monitor import (
    ALARM,
    Lapse,
    LEARNING,
    Monitor,
    MonitorSettings,
    Raised,
    Sample,
    WAITING,
    watch,
    WATCHING,
)
from saddlering_ros.monitoring.rest import RestLearner, RestNoise

__all__ = [
    'ALARM',
    'FIRST_GUESSES',
    'LEARNING',
    'WAITING',
    'WATCHING',
    'Alarm',
    'BlockNoise',
    'BlockWatch',
    'ChannelInnovations',
    'Detector',
    'Lapse',
    'Monitor',
    'MonitorSettings',
    'MonitoringError',
    'Raised',
    'RestLearner',
    'RestNoise',
    'Sample',
    'assumed_noise',
    'block_noise',
    'first_guess',
    'least_wander',
    'materiality',
    'threshold_of',
    'watch',
]
