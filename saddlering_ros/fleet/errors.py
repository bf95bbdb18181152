"""Errors of fleet statistics."""

from saddlering_ros.errors import SaddleringError


class FleetError(SaddleringError):
    """Sessions or limits that fleet statistics cannot use."""
