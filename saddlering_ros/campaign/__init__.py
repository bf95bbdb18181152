"""Campaigns: every bag under a folder, grouped into sessions of one ring, each given a verdict."""

from saddlering_ros.campaign.running import run_campaign, Summary
from saddlering_ros.campaign.sessions import (
    find_bags,
    FoundBag,
    group_sessions,
    read_manifest,
    Session,
    write_manifest,
)
from saddlering_ros.campaign.store import CampaignError, CampaignInterruptedError, Store
from saddlering_ros.campaign.task import SessionLimits, SessionTask, tasks_of

__all__ = [
    'CampaignError', 'CampaignInterruptedError', 'FoundBag', 'Session',
    'SessionLimits', 'SessionTask', 'Store', 'Summary', 'find_bags', 'group_sessions',
    'read_manifest', 'run_campaign', 'tasks_of', 'write_manifest',
]
