"""Errors of bags."""

from __future__ import annotations

from saddlering_ros.errors import SaddleringError


class BagError(SaddleringError):
    """A bag that cannot be used; one line: fault, place, remedy."""

    def __init__(self, message: str) -> None:
        # Names read from a damaged file may hold anything.
        super().__init__(message.replace('\r', ' ').replace('\n', ' '))
