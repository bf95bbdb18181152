"""The generic engine: it names the causes that a simulator lacks, at a known error rate.

Declare a `Model` of any machine and call `diagnose(model, runs)`. `diagnose` also accepts a
`System` with its `RunBlocks`, for simulators that have nuisance parameters, combined channels or
sensitivities of their own, like that of the ring. This module exports all names that a user of the
engine may import.
"""

from saddlering_ros.discrepancy.diagnosis import check, diagnose
from saddlering_ros.discrepancy.engine import diagnose_system
from saddlering_ros.discrepancy.law.families import HYSTERESIS, MEMORY, PLAY
from saddlering_ros.discrepancy.law.proposal import describe, LawProposal, Term
from saddlering_ros.discrepancy.noise import Noise
from saddlering_ros.discrepancy.problem.fits import refits_to_held_out, stepped_misfit, tangent
from saddlering_ros.discrepancy.problem.metric import (
    model_error_columns,
    noise_metric,
    nuisance_columns,
)
from saddlering_ros.discrepancy.problem.model import Channel, Model, Run
from saddlering_ros.discrepancy.problem.problem import Assumptions, Problem
from saddlering_ros.discrepancy.problem.system import (
    DiscrepancyError,
    Effect,
    Estimate,
    ModelErrorPrior,
    Neighbourhood,
    Parameter,
    Point,
    Proposal,
    Reading,
    RunBlocks,
    Settings,
    System,
    SystemWithTangents,
)
from saddlering_ros.discrepancy.search.evidence import Evidence
from saddlering_ros.discrepancy.search.lack_of_fit import ShapeTest
from saddlering_ros.discrepancy.search.selection import space_beside_error
from saddlering_ros.discrepancy.search.signatures import DetectionLimit, Observability, observed
from saddlering_ros.discrepancy.search.space import prepare
from saddlering_ros.discrepancy.verdict import wording
from saddlering_ros.discrepancy.verdict.results import (
    Cause,
    CauseEntry,
    Diagnosis,
    PARTED,
    probabilities_of,
    ReductionEntry,
    Remainder,
    Residual,
    Separation,
    SizeEntry,
)
from saddlering_ros.estimation.rest import RestSegment
from saddlering_ros.memory_operators import direction_of

__all__ = [
    'HYSTERESIS', 'MEMORY', 'PARTED', 'PLAY', 'Assumptions', 'Cause', 'CauseEntry', 'Channel',
    'DetectionLimit', 'Diagnosis', 'DiscrepancyError', 'Effect', 'Estimate', 'Evidence',
    'LawProposal', 'Model', 'ModelErrorPrior', 'Neighbourhood', 'Noise', 'Observability',
    'Parameter', 'Point', 'Problem', 'Proposal', 'Reading', 'ReductionEntry', 'Remainder',
    'Residual', 'RestSegment', 'Run', 'RunBlocks', 'Separation', 'Settings', 'ShapeTest',
    'SizeEntry', 'System', 'SystemWithTangents', 'Term',
    'check', 'describe', 'diagnose', 'diagnose_system', 'direction_of', 'model_error_columns',
    'noise_metric', 'nuisance_columns', 'observed', 'prepare', 'probabilities_of',
    'refits_to_held_out', 'space_beside_error', 'stepped_misfit', 'tangent',
    'wording']
