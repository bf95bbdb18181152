"""Whether a ring still behaves as its model while the test runs: innovations and an alarm."""

from saddlering_ros.monitoring.detector import Alarm, Detector, threshold_of
from saddlering_ros.monitoring.errors import MonitoringError
from saddlering_ros.monitoring.innovations import block_noise, BlockNoise, Whitener
from saddlering_ros.monitoring.monitor import Monitor, MonitorSettings, Report, watch

__all__ = [
    'Alarm', 'BlockNoise', 'Detector', 'Monitor', 'MonitorSettings', 'MonitoringError', 'Report',
    'Whitener', 'block_noise', 'threshold_of', 'watch',
]
