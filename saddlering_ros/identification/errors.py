"""The error of the identification layer."""

from saddlering_ros.errors import SaddleringError


class IdentificationError(SaddleringError):
    """Runs, bounds or an objective that cannot be used; the message is one line."""
