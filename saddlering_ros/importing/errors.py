"""The error of importing."""

from saddlering_ros.errors import SaddleringError


class ImportingError(SaddleringError):
    """A measured file or its map cannot be used; one line: fault, place, remedy."""
