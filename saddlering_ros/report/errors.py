"""Errors of reports."""

from saddlering_ros.errors import SaddleringError


class ReportError(SaddleringError):
    """A report that cannot be drawn or written."""
