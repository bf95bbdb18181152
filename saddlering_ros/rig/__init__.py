"""The description of a rig: geometry, loads, probes, contact parameters, and their files."""

from saddlering_ros.rig.description import (
    beyond_bounds,
    default_rig,
    load_rig,
    Rig,
    RollerRow,
    short_digest,
)
from saddlering_ros.rig.geometry import CHANNELS, Displacement, MOTION, probes_to_displacement
from saddlering_ros.rig.instruments import Instruments
from saddlering_ros.rig.parameter_file import (
    ContactParameters,
    PARAMETER_NAMES,
    PARAMETER_UNITS,
    ParameterSet,
    ParameterSource,
    read_parameters,
    RigError,
    TRUE_TO_SCALE,
    write_parameters,
)
from saddlering_ros.rig.units import FORCE_UNITS, FULL_SCALE_LOAD, MICRO_UNITS, TONNE

__all__ = [
    'CHANNELS', 'FORCE_UNITS', 'FULL_SCALE_LOAD', 'MICRO_UNITS', 'MOTION', 'PARAMETER_NAMES',
    'PARAMETER_UNITS', 'TONNE', 'TRUE_TO_SCALE', 'ContactParameters', 'Displacement',
    'Instruments', 'ParameterSet', 'ParameterSource', 'Rig', 'RigError', 'RollerRow',
    'beyond_bounds', 'default_rig', 'load_rig', 'probes_to_displacement', 'read_parameters',
    'short_digest', 'write_parameters']
