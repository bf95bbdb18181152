"""The change of one ring between two sessions: common errors cancel, differences are diagnosed."""

from saddlering_ros.comparison.change import Change, compare_records, ComparisonError
from saddlering_ros.comparison.maker import MakerFigures

__all__ = ['Change', 'ComparisonError', 'MakerFigures', 'compare_records']
