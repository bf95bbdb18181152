"""Errors in the start of a node or in a request to it."""

from saddlering_ros.errors import SaddleringError


class NodeError(SaddleringError):
    """A request that a node cannot fulfil; one line: fault, place, remedy."""
