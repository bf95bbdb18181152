"""Contact parameters from test runs, with their uncertainty and their predictions."""

from saddlering_ros.identification.errors import IdentificationError
from saddlering_ros.identification.methods import identify
from saddlering_ros.identification.result import Identification
from saddlering_ros.identification.settings import IdentificationSettings
from saddlering_ros.identification.swarm import StopReason, SwarmSettings
from saddlering_ros.identification.validation import validate, Validation

__all__ = [
    'Identification', 'IdentificationError', 'IdentificationSettings', 'StopReason',
    'SwarmSettings', 'Validation', 'identify', 'validate',
]
