"""The description of a rig: geometry, loads, probes, contact parameters, and their files."""

from saddlering_ros.rig.description import (
    check_bounds,
    default_rig,
    load_rig,
    OPPOSITE,
    Probes,
    Rig,
    rig_file_of_project,
    rig_from_parameters,
    RIG_VARIABLE,
    RollerRow,
    short_digest,
)
from saddlering_ros.rig.geometry import (
    CHANNELS,
    Displacement,
    displacement_to_probes,
    gap_increment,
    measured_displacement,
    mirrored_gap,
    probes_to_displacement,
    resolve_load,
    size_factor,
    with_absent,
    zero_of_record,
    ZeroReading,
    ZeroWindow,
)
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
from saddlering_ros.rig.units import (
    force_decimals,
    FORCE_UNITS,
    force_words,
    FULL_SCALE_LOAD,
    line_contact_stiffness,
    LoadLimits,
    MICRO_UNITS,
    stiffness_per_millimetre,
    TONNE,
)

__all__ = [
    'CHANNELS', 'FORCE_UNITS', 'FULL_SCALE_LOAD', 'MICRO_UNITS', 'OPPOSITE', 'PARAMETER_NAMES',
    'PARAMETER_UNITS', 'RIG_VARIABLE', 'TONNE', 'TRUE_TO_SCALE', 'ContactParameters',
    'Displacement', 'Instruments', 'LoadLimits', 'ParameterSet', 'ParameterSource', 'Probes',
    'Rig', 'RigError', 'RollerRow', 'ZeroReading', 'ZeroWindow', 'check_bounds', 'default_rig',
    'displacement_to_probes', 'force_decimals', 'force_words', 'gap_increment',
    'line_contact_stiffness', 'load_rig', 'measured_displacement', 'mirrored_gap',
    'probes_to_displacement', 'read_parameters', 'resolve_load', 'rig_file_of_project',
    'rig_from_parameters', 'short_digest', 'size_factor', 'stiffness_per_millimetre',
    'with_absent', 'write_parameters', 'zero_of_record',
]
