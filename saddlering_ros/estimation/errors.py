"""Errors of estimation."""

from saddlering_ros.errors import SaddleringError


class EstimationError(SaddleringError):
    """Records that noise cannot be learnt from, or that cannot be whitened."""
