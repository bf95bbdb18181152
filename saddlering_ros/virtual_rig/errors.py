"""Errors of requests to the virtual rig."""

from saddlering_ros.errors import SaddleringError


class VirtualRigError(SaddleringError):
    """A test that cannot be generated as requested; one line: fault, place, remedy."""
