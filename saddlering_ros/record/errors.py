"""Errors of bags."""

from __future__ import annotations

from saddlering_ros.errors import SaddleringError


class BagError(SaddleringError):
    """A bag cannot be used. The message is one line: fault, place, remedy."""

    def __init__(self, message: str) -> None:
        # Names from a damaged file may contain any characters.
        super().__init__(message.replace('\r', ' ').replace('\n', ' '))
