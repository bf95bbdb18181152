"""Errors of campaigns."""

from saddlering_ros.errors import SaddleringError


class CampaignError(SaddleringError):
    """A folder, a manifest or a store that a campaign cannot use."""


class CampaignInterruptedError(CampaignError):
    """The executor is gone or was stopped; computed results are in the store."""
