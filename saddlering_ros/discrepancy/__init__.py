"""The generic engine: it names the causes that a simulator lacks, at a known error rate.

Declare a `Model` of any machine and `diagnose(model, runs)`. What lies under it, `diagnose_system`
of anything that follows `System`, is for simulators with nuisance parameters of their own.
"""

from saddlering_ros.discrepancy.assumptions import Assumptions
from saddlering_ros.discrepancy.engine import diagnose_system
from saddlering_ros.discrepancy.model import Channel, Model, Run
from saddlering_ros.discrepancy.model_check import check
from saddlering_ros.discrepancy.model_diagnosis import diagnose
from saddlering_ros.discrepancy.noise import Noise
from saddlering_ros.discrepancy.priors import ModelErrorPrior
from saddlering_ros.discrepancy.results import Cause, Diagnosis, Estimate
from saddlering_ros.discrepancy.separation import Proposal, Reading, Separation
from saddlering_ros.discrepancy.settings import Settings
from saddlering_ros.discrepancy.system import (
    DiscrepancyError,
    Effect,
    Parameter,
    Point,
    RunBlocks,
    System,
)
from saddlering_ros.estimation.rest import RestSegment

__all__ = [
    'Assumptions',
    'Cause',
    'Channel',
    'Diagnosis',
    'DiscrepancyError',
    'Effect',
    'Estimate',
    'Model',
    'ModelErrorPrior',
    'Noise',
    'Parameter',
    'Point',
    'Proposal',
    'Reading',
    'RestSegment',
    'Run',
    'RunBlocks',
    'Separation',
    'Settings',
    'System',
    'check',
    'diagnose',
    'diagnose_system',
]
