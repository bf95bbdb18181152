"""Errors of rig descriptions and parameter files."""

from saddlering_ros.errors import SaddleringError


class RigError(SaddleringError):
    """A rig or parameter file that cannot be used; one line: fault, place, remedy."""
