"""Errors of the Python API."""

from saddlering_ros.errors import SaddleringError


class ApiError(SaddleringError):
    """An argument that cannot be used, or a result that cannot be saved as asked."""
