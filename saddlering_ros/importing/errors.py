"""The error of importing."""

from saddlering_ros.errors import SaddleringError


class ImportingError(SaddleringError):
    """A measured file or its map cannot be used; one line that says what, where, what to do."""
