"""The generic engine: it names the causes that a simulator lacks, at a known error rate.

Declare a `Model` of any machine and call `diagnose(model, runs)`. `diagnose` also accepts a
`System` with its `RunBlocks`, for simulators that have nuisance parameters, combined channels or
sensitivities of their own, like that of the ring. This module exports all names that a user of the
engine may import.
"""

from saddlering_ros.discrepancy.assumptions import Assumptions
from saddlering_ros.discrepancy.engine import diagnose_system
from saddlering_ros.discrepancy.lack_of_fit import ShapeTest
from saddlering_ros.discrepancy.model import Channel, Model, Run
from saddlering_ros.discrepancy.model_check import check
from saddlering_ros.discrepancy.model_diagnosis import diagnose
from saddlering_ros.discrepancy.noise import Noise
from saddlering_ros.discrepancy.priors import ModelErrorPrior
from saddlering_ros.discrepancy.proposal import describe, LawProposal, Term
from saddlering_ros.discrepancy.proposal.memory import direction_of
from saddlering_ros.discrepancy.results import Cause, Diagnosis, Estimate, Evidence
from saddlering_ros.discrepancy.separation import Proposal, Reading, Separation
from saddlering_ros.discrepancy.settings import Settings
from saddlering_ros.discrepancy.system import (
    DiscrepancyError,
    Effect,
    Parameter,
    Point,
    RunBlocks,
    System,
    SystemWithTangents,
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
    'Evidence',
    'LawProposal',
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
    'ShapeTest',
    'System',
    'SystemWithTangents',
    'Term',
    'check',
    'describe',
    'diagnose',
    'diagnose_system',
    'direction_of',
]
