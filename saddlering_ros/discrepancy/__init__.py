"""Generic discrepancy engine: what a simulator gets wrong, named, with its error rate kept.

Knows simulators, base parameters, effects and runs; nothing of rings. `diagnose(system, runs)`.
"""

from saddlering_ros.discrepancy.engine import (
    Cause,
    diagnose,
    Diagnosis,
    Estimate,
    Settings,
)
from saddlering_ros.discrepancy.likelihood import Allowance
from saddlering_ros.discrepancy.next_test import Proposal
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
    'Allowance',
    'Cause',
    'Diagnosis',
    'DiscrepancyError',
    'Effect',
    'Estimate',
    'Parameter',
    'Point',
    'Proposal',
    'RestSegment',
    'Run',
    'Settings',
    'System',
    'diagnose',
]
