"""Contact parameters from test runs, with their uncertainty and their predictions."""

from typing import Any, TYPE_CHECKING

from saddlering_ros.identification.errors import IdentificationError
from saddlering_ros.identification.settings import IdentificationSettings
from saddlering_ros.identification.swarm import StopReason, SwarmSettings

if TYPE_CHECKING:
    from saddlering_ros.identification.methods import identify
    from saddlering_ros.identification.result import Identification
    from saddlering_ros.identification.validation import validate, Validation

__all__ = [
    'Identification', 'IdentificationError', 'IdentificationSettings', 'StopReason',
    'SwarmSettings', 'Validation', 'identify', 'validate',
]

_PLACES = {'identify': 'methods', 'Identification': 'result',
           'validate': 'validation', 'Validation': 'validation'}
"""Names whose modules import SciPy. They are imported on first use, so that a node that needs only
the settings starts in a third of the time."""


def __getattr__(name: str) -> Any:
    """A name of the package, imported from where it is defined."""
    if name not in _PLACES:
        raise AttributeError(f'module {__name__!r} has no attribute {name!r}')
    from importlib import import_module

    value = getattr(import_module(f'{__name__}.{_PLACES[name]}'), name)
    globals()[name] = value
    return value
