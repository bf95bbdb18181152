"""Campaigns: every bag under a folder, grouped into sessions of one ring, each given a verdict."""

from saddlering_ros.campaign.coordinator import run_campaign, Summary
from saddlering_ros.campaign.discovery import find_bags, FoundBag
from saddlering_ros.campaign.errors import CampaignError, CampaignInterruptedError
from saddlering_ros.campaign.manifest import read_manifest, write_manifest
from saddlering_ros.campaign.sessions import group_sessions, Grouping, Session
from saddlering_ros.campaign.store import Store
from saddlering_ros.campaign.task import SessionLimits, SessionTask, tasks_of

__all__ = [
    'CampaignError',
    'CampaignInterruptedError',
    'FoundBag',
    'Grouping',
    'Session',
    'SessionLimits',
    'SessionTask',
    'Store',
    'Summary',
    'find_bags',
    'group_sessions',
    'read_manifest',
    'run_campaign',
    'tasks_of',
    'write_manifest',
]
