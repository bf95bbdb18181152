"""Errors in the start of a node or in a request to it."""

from saddlering_ros.errors import SaddleringError


class NodeError(SaddleringError):
    """A node that cannot do what it is asked; one line: what, where, what to do."""
