"""Errors of monitoring."""

from saddlering_ros.errors import SaddleringError


class MonitoringError(SaddleringError):
    """A record or settings that cannot be monitored."""
