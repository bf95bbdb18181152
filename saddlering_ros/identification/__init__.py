"""Contact parameters from test runs, with their uncertainty and their predictions."""

from typing import TYPE_CHECKING

from saddlering_ros import names_on_first_use
from saddlering_ros.identification.settings import (
    IdentificationError,
    IdentificationSettings,
    StopReason,
    SwarmSettings,
)

if TYPE_CHECKING:
    from saddlering_ros.identification.methods import identify
    from saddlering_ros.identification.result import Identification
    from saddlering_ros.identification.validation import validate, Validation

__all__ = [
    'Identification', 'IdentificationError', 'IdentificationSettings', 'StopReason',
    'SwarmSettings', 'Validation', 'identify', 'validate']

_PLACES = {'identify': 'methods', 'Identification': 'result',
           'validate': 'validation', 'Validation': 'validation'}
"""Names whose modules import SciPy. They are imported on first use, so that a node that needs only
the settings starts in a third of the time."""

__getattr__ = names_on_first_use(__name__, _PLACES)
