"""Effects in the load path: the load of the cell and the load on the ring."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from saddlering_ros.rig import Rig
from saddlering_ros.virtual_rig.effects import effect, TrueSize
from saddlering_ros.virtual_rig.numerics import compiled, follow, LAWS

Floats = NDArray[np.float64]

INITIAL = TrueSize('initial', '1', -0.3, 0.3, 0.0)
RATE_FREE = ('jenkins', 'dahl', 'bouc_wen')
X_AND_T = ('delta_x', 'delta_y', 'gamma')


@dataclass
class LoadPath:
    """The load on its way, (N,) each: time [s], of an exact cell [N], at the ring [N].

    elevation [rad] and trunnion_y [m] as they really are, (N,); effects change the last three.
    """

    rig: Rig
    time: Floats
    measured: Floats
    arriving: Floats
    elevation: Floats
    trunnion_y: Floats


@compiled()
def hysteresis(law: int, values: Floats, presliding: float, initial: float) -> Floats:
    """State z (N,) of a friction element that follows `values` (N,)."""
    state = np.empty(values.shape[0])
    z = initial
    state[0] = z
    for n in range(1, values.shape[0]):
        z, _ = follow(law, z, values[n] - values[n - 1], presliding, 0.0, 1.0)
        state[n] = z
    return state


@effect('load_gain', 'load', X_AND_T, [TrueSize('gain', '1', 0.01, 0.08, 0.03, signed=True)])
def load_gain(path: LoadPath, values: Mapping[str, float], form: str) -> None:
    """The cell reads too much by a share."""
    path.arriving /= 1.0 + values['gain']


@effect('load_offset', 'load', X_AND_T,
        [TrueSize('offset', 'N', 500.0, 4000.0, 2000.0, signed=True)])
def load_offset(path: LoadPath, values: Mapping[str, float], form: str) -> None:
    """The cell reads too much by a constant."""
    path.arriving -= values['offset']


@effect('load_nonlinearity', 'load', X_AND_T,
        [TrueSize('curvature', '1', 0.003, 0.03, 0.01, signed=True)])
def load_nonlinearity(path: LoadPath, values: Mapping[str, float], form: str) -> None:
    """The cell's characteristic is a parabola."""
    full = path.rig.full_scale_load
    path.arriving += 4.0 * values['curvature'] * path.measured * (1.0 - path.measured / full)


@effect('cylinder_friction', 'load', X_AND_T,
        [TrueSize('force', 'N', 500.0, 8000.0, 3000.0),
         TrueSize('presliding', 'N', 1000.0, 8000.0, 3000.0, positive=True), INITIAL], RATE_FREE)
def cylinder_friction(path: LoadPath, values: Mapping[str, float], form: str) -> None:
    """Seal friction takes a part of the load on the way up and adds it on the way down."""
    z = hysteresis(LAWS[form], path.measured, values['presliding'], values['initial'])
    path.arriving -= values['force'] * z


@effect('elevation_error', 'load', X_AND_T,
        [TrueSize('angle', 'rad', 0.005, 0.04, 0.0175, signed=True)])
def elevation_error(path: LoadPath, values: Mapping[str, float], form: str) -> None:
    """The barrel has another elevation than recorded."""
    path.elevation += values['angle']


@effect('moment_arm', 'load', ('delta_y', 'gamma'),
        [TrueSize('offset', 'm', 0.01, 0.08, 0.03, signed=True)])
def moment_arm(path: LoadPath, values: Mapping[str, float], form: str) -> None:
    """The trunnion lies higher than in the rig file."""
    path.trunnion_y += values['offset']


@effect('bracket_play', 'load', X_AND_T,
        [TrueSize('angle', 'rad', 0.001, 0.015, 0.005),
         TrueSize('presliding', 'N', 1000.0, 8000.0, 3000.0, positive=True), INITIAL], RATE_FREE)
def bracket_play(path: LoadPath, values: Mapping[str, float], form: str) -> None:
    """The bracket tips over its play when the load turns round."""
    z = hysteresis(LAWS[form], path.measured, values['presliding'], values['initial'])
    path.elevation += values['angle'] * z


# -- in no catalogue ---------------------------------------------------------------------------


@effect('out:load_cell_lens', 'load', X_AND_T, [TrueSize('share', '1', 0.005, 0.03, 0.015)])
def load_cell_lens(path: LoadPath, values: Mapping[str, float], form: str) -> None:
    """Hysteresis of the cell's body: a lens that closes at both ends of the range."""
    full = path.rig.full_scale_load
    z = hysteresis(LAWS['dahl'], path.measured, 0.1 * full, 1.0)
    share = np.clip(path.measured / full, 0.0, 1.0)
    path.arriving -= values['share'] * full * z * np.sin(np.pi * share) ** 2


@effect('out:pump_ripple', 'load', X_AND_T,
        [TrueSize('force', 'N', 300.0, 4000.0, 1500.0),
         TrueSize('frequency', 'Hz', 0.7, 6.0, 2.3, positive=True)])
def pump_ripple(path: LoadPath, values: Mapping[str, float], form: str) -> None:
    """The pump makes the load swing, the more the higher it is; the cell's filter hides it."""
    swing = np.sin(2.0 * np.pi * values['frequency'] * path.time)
    path.arriving += values['force'] * swing * path.measured / path.rig.full_scale_load


@effect('out:valve_stick', 'load', X_AND_T,
        [TrueSize('force', 'N', 500.0, 5000.0, 2500.0),
         TrueSize('spacing', 'N', 2e4, 8e4, 4e4, positive=True)])
def valve_stick(path: LoadPath, values: Mapping[str, float], form: str) -> None:
    """The load at the ring sticks and slips: a saw over the load."""
    phase = path.measured / values['spacing']
    path.arriving += values['force'] * (phase - np.floor(phase) - 0.5) * np.minimum(phase, 1.0)
