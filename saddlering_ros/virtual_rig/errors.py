"""Errors of requests to the virtual rig."""

from saddlering_ros.errors import SaddleringError


class VirtualRigError(SaddleringError):
    """A test that cannot be generated as asked; one line: what, where, what to do."""
