"""What can be wrong with the way a node is started or asked."""

from saddlering_ros.errors import SaddleringError


class NodeError(SaddleringError):
    """A node that cannot do what it is asked; one line: what, where, what to do."""
