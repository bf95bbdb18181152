"""Statistics of many sessions: rings, rigs, and changes over time. Input are results, not bags."""

from saddlering_ros.fleet.attention import fleet_document, judge_fleet, limits_from_text
from saddlering_ros.fleet.observations import COORDINATES, figures_of, FleetError, SessionFigures

__all__ = [
    'COORDINATES', 'FleetError', 'SessionFigures', 'figures_of', 'fleet_document', 'judge_fleet',
    'limits_from_text',
]
