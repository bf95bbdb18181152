"""Generic discrepancy engine: what a simulator gets wrong, named, with its error rate kept.

Knows simulators, base parameters, effects and runs; nothing of rings. `diagnose(system, runs)`.
"""

from saddlering_ros.discrepancy.engine import diagnose
from saddlering_ros.discrepancy.next_test import Proposal
from saddlering_ros.discrepancy.nuisances import ModelErrorPrior
from saddlering_ros.discrepancy.results import Cause, Diagnosis, Estimate
from saddlering_ros.discrepancy.settings import Settings
from saddlering_ros.discrepancy.system import (
    DiscrepancyError,
    Effect,
    Parameter,
    Point,
    RestSegment,
    Run,
    System,
)

__all__ = [
    'Cause',
    'Diagnosis',
    'DiscrepancyError',
    'Effect',
    'Estimate',
    'ModelErrorPrior',
    'Parameter',
    'Point',
    'Proposal',
    'RestSegment',
    'Run',
    'Settings',
    'System',
    'diagnose',
]
