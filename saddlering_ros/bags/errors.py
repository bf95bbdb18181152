"""What can be wrong with a bag."""

from __future__ import annotations

from saddlering_ros.errors import SaddleringError


class BagError(SaddleringError):
    """A bag that cannot be used; one line: what, where, what to do."""
