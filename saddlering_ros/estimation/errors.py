"""Errors of estimation."""

from saddlering_ros.errors import SaddleringError


class EstimationError(SaddleringError):
    """Noise cannot be learnt from records, or records cannot be whitened."""
