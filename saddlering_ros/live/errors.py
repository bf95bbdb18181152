"""Errors of the live page."""

from saddlering_ros.errors import SaddleringError


class LiveError(SaddleringError):
    """A page that cannot be served with these options."""
