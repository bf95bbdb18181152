"""The motion that the model expects at a load, with its covariance by that of the parameters."""

from dataclasses import dataclass

import numpy as np

from saddlering_ros.memory_operators import Array
from saddlering_ros.rig import ParameterSet, Rig
from saddlering_ros.rig.geometry import STEADY_SHARE
from saddlering_ros.ring.sensitivity import static_sensitivities
from saddlering_ros.ring.simulator import static_response

LOADS = 41
"""Loads from preload to full scale between which the motion is interpolated."""

NO_ZERO, OUTSIDE, NO_COVARIANCE, WITHOUT_EFFECTS, NO_EQUILIBRIUM = 1, 2, 4, 8, 16
"""Bits of validity, as in RingExpected.msg."""


@dataclass(frozen=True)
class Expected:
    """The expected motion at a load."""

    motion: Array  # (3,) [m, m, rad] from the zero
    by_load: Array  # (3,), its derivative [1/N of these]
    covariance: Array  # (3, 3) by the parameters, 0 where not known
    validity: int  # sum of bits, 0 if all hold


class ExpectedMotion:
    """The static equilibrium of a ring over the load at one elevation [rad], with derivatives."""

    def __init__(self, rig: Rig, parameters: ParameterSet, elevation: float) -> None:
        self._tolerance = STEADY_SHARE * rig.full_scale_load  # noise at preload is not outside
        self._loads = np.linspace(rig.preload, rig.full_scale_load, LOADS)
        values = parameters.contact.to_array()
        self._motion = static_response(rig, values, elevation, self._loads)
        self._slope = np.gradient(self._motion, self._loads, axis=1)
        self._covariance = parameters.source.covariance
        self._bits = WITHOUT_EFFECTS if parameters.effects else 0
        if self._covariance is not None and not np.isfinite(self._covariance).all():
            self._covariance = None
        self._by_parameter = static_sensitivities(rig, values, elevation, self._motion)

    def at(self, load: float, zero_load: float | None) -> Expected:
        """The motion at a load [N] from that at the load of the zero; None: from preload."""
        validity = self._bits | (NO_ZERO if zero_load is None else 0)
        inside = float(np.clip(load, self._loads[0], self._loads[-1]))
        validity |= OUTSIDE if abs(inside - load) > self._tolerance else 0
        begin = self._loads[0] if zero_load is None else zero_load
        motion, slopes = (self._between(curves, inside) - self._between(curves, begin)
                          for curves in (self._motion, self._by_parameter))
        validity |= 0 if np.isfinite(motion).all() else NO_EQUILIBRIUM
        validity |= NO_COVARIANCE if self._covariance is None else 0
        covariance = np.zeros((3, 3)) if self._covariance is None else (
            slopes.T @ self._covariance @ slopes)
        return Expected(motion, self._between(self._slope, inside), covariance, validity)

    def _between(self, curves: Array, load: float) -> Array:
        """Curves (..., LOADS) at a load, linear between two loads."""
        place = float(np.interp(load, self._loads, np.arange(LOADS)))
        low = min(int(place), LOADS - 2)
        share = place - low
        return np.asarray((1.0 - share) * curves[..., low] + share * curves[..., low + 1])
