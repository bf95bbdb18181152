"""Errors of campaigns."""

from saddlering_ros.errors import SaddleringError


class CampaignError(SaddleringError):
    """A folder, a manifest or a store that a campaign cannot use."""


class CampaignInterruptedError(CampaignError):
    """The executor is gone or was stopped; what was computed is in the store."""
