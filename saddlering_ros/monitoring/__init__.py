"""Whether a ring still behaves as its model while the test runs: innovations and an alarm."""

from saddlering_ros.monitoring.detector import (
    Alarm,
    block_noise,
    BlockNoise,
    BlockWatch,
    ChannelInnovations,
    Detector,
    threshold_of,
)
from saddlering_ros.monitoring.monitor import (
    ALARM,
    first_guess,
    FIRST_GUESSES,
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
from saddlering_ros.monitoring.noise import (
    assumed_noise,
    least_wander,
    materiality,
    MonitoringError,
    RestLearner,
    RestNoise,
)

__all__ = [
    'ALARM', 'FIRST_GUESSES', 'LEARNING', 'WAITING', 'WATCHING', 'Alarm', 'BlockNoise',
    'BlockWatch', 'ChannelInnovations', 'Detector', 'Lapse', 'Monitor', 'MonitorSettings',
    'MonitoringError', 'Raised', 'RestLearner', 'RestNoise', 'Sample', 'assumed_noise',
    'block_noise', 'first_guess', 'least_wander', 'materiality', 'threshold_of', 'watch',
]
