"""saddlering_ros: a test rig for saddle rings, its simulator and its diagnosis, on ROS 2."""

from importlib import import_module
from typing import Any, TYPE_CHECKING

if TYPE_CHECKING:
    from saddlering_ros.api.functions import (
        compare,
        Curves,
        diagnose,
        displacement,
        identify,
        residual,
        simulate,
        validate,
    )
    from saddlering_ros.api.inputs import Bag, read_bag
    from saddlering_ros.api.results import (
        ComparisonResult,
        DiagnosisResult,
        IdentificationResult,
        ValidationResult,
    )
    from saddlering_ros.errors import Cancelled, SaddleringError
    from saddlering_ros.identification.settings import IdentificationSettings, SwarmSettings
    from saddlering_ros.progress import Progress, show_progress
    from saddlering_ros.rig import load_rig, ParameterSet, read_parameters, Rig

__version__ = '0.1.0'

_PLACES = {name: place for place, names in {
    'api.functions': 'Curves compare diagnose displacement identify residual simulate validate',
    'api.inputs': 'Bag read_bag', 'errors': 'Cancelled SaddleringError',
    'api.results': 'ComparisonResult DiagnosisResult IdentificationResult ValidationResult',
    'identification.settings': 'IdentificationSettings SwarmSettings',
    'progress': 'Progress show_progress', 'rig': 'load_rig ParameterSet read_parameters Rig',
}.items() for name in names.split()}
"""Where the public names are defined; they are imported when first used, which keeps the package
itself cheap to import."""

__all__ = [
    'Bag', 'Cancelled', 'ComparisonResult', 'Curves', 'DiagnosisResult',
    'IdentificationResult', 'IdentificationSettings', 'ParameterSet', 'Progress', 'Rig',
    'SaddleringError', 'SwarmSettings', 'ValidationResult', '__version__', 'compare',
    'diagnose', 'displacement', 'identify', 'load_rig', 'read_bag', 'read_parameters',
    'residual', 'show_progress', 'simulate', 'validate']


def __getattr__(name: str) -> Any:
    if name not in _PLACES:
        raise AttributeError(f'module {__name__!r} has no attribute {name!r}')
    value = getattr(import_module(f'{__name__}.{_PLACES[name]}'), name)
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})
