"""What can be wrong with a rig description or a parameter file."""

from saddlering_ros.errors import SaddleringError


class RigError(SaddleringError):
    """A rig or parameter file that cannot be used; one line: what, where, what to do."""
