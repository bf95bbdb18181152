"""Settings of an identification."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

from saddlering_ros.identification.errors import IdentificationError
from saddlering_ros.identification.swarm import SwarmSettings
from saddlering_ros.rig import check_bounds, PARAMETER_NAMES, Rig, RigError

METHODS = ('default', 'paper')

Bounds = dict[str, tuple[float, float]]


@dataclass(frozen=True, slots=True)
class IdentificationSettings:
    """Settings of one identification.

    method: 'default' (all channels, both branches, joint least squares) or 'paper' (two steps,
    mean of the branches, swarm alone). bounds replace those of the rig for their names (SI).
    logarithmic_stiffness: the paper's swarm searches K on a logarithmic scale; the default
    method always does. use_delta_y None: the usual choice of the method (paper: without).
    fit_rate [Hz]: grid of the block means of dynamic records (its bandwidth is 0.44 of it);
    None keeps every sample.
    """

    method: str = 'default'
    bounds: Mapping[str, tuple[float, float]] = field(default_factory=dict)
    swarm: SwarmSettings = field(default_factory=SwarmSettings)
    logarithmic_stiffness: bool = False
    use_delta_y: bool | None = None
    seed: int = 0
    fit_rate: float | None = 50.0

    def __post_init__(self) -> None:
        if self.method not in METHODS:
            raise IdentificationError(
                f'method {self.method!r} is unknown: give one of {", ".join(METHODS)}'
            )
        unknown = sorted(set(self.bounds) - set(PARAMETER_NAMES))
        if unknown:
            raise IdentificationError(
                f'bounds for {unknown[0]!r}: there is no such parameter: give '
                f'{", ".join(PARAMETER_NAMES)}'
            )
        if self.fit_rate is not None and not self.fit_rate > 0.0:
            raise IdentificationError(
                f'fit rate {self.fit_rate} Hz: give a rate above zero, or none for every sample'
            )

    def bounds_for(self, rig: Rig) -> Bounds:
        """Bounds of all six parameters; IdentificationError if one pair is reversed."""
        bounds = {name: self.bounds.get(name, rig.bounds[name]) for name in PARAMETER_NAMES}
        try:
            return check_bounds(bounds, 'identification bounds')
        except RigError as problem:
            raise IdentificationError(str(problem)) from problem

    @property
    def channels(self) -> tuple[int, ...]:
        """Indices of the channels (delta_x, delta_y, gamma) of the objective."""
        use_delta_y = self.method == 'default' if self.use_delta_y is None else self.use_delta_y
        return (0, 1, 2) if use_delta_y else (0, 2)
