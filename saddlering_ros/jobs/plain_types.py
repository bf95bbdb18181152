"""Dataclasses that jobs of either action exchange with their node."""

from saddlering_ros.progress import Progress, SearchStep
from saddlering_ros.rig import (
    Carriage,
    ContactParameters,
    ParameterSet,
    ParameterSource,
    Probes,
    Rig,
    RollerRow,
    Trunnion,
)

RIG_TYPES = (Rig, RollerRow, Carriage, Trunnion, Probes)
PARAMETER_TYPES = (ParameterSet, ParameterSource, ContactParameters)
PROGRESS_TYPES = (Progress, SearchStep)
