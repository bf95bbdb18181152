"""Errors of the demo."""

from saddlering_ros.errors import SaddleringError


class DemoError(SaddleringError):
    """Bags the demo cannot use, or nodes that do not do their part."""
