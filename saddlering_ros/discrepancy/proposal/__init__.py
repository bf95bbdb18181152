"""A law proposed for a misfit that no effect of the catalogue explains: functions of arrays."""

from saddlering_ros.discrepancy.proposal.matching import LawParameter, Term
from saddlering_ros.discrepancy.proposal.misfit import Misfit, ObservedRun
from saddlering_ros.discrepancy.proposal.of_fit import Proposer
from saddlering_ros.discrepancy.proposal.propose import (
    Alternative,
    describe,
    LawProposal,
    propose_law,
)

__all__ = [
    'Alternative', 'LawParameter', 'LawProposal', 'Misfit', 'ObservedRun', 'Proposer', 'Term',
    'describe', 'propose_law',
]
