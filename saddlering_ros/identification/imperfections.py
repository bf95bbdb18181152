"""Small errors of a rig that no fit can see, and those that its certificates state."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from saddlering_ros.estimation.process import Array
from saddlering_ros.identification.observation import Observation
from saddlering_ros.rig import Rig


@dataclass(frozen=True)
class Imperfection:
    """A small imperfection of every rig, and its effect on predicted increments."""

    name: str
    words: str
    load: Callable[[Array, float], Array] = lambda load, full_scale: load
    rig: Callable[[Rig], Rig] = lambda rig: rig
    elevation: float = 0.0
    delay: float = 0.0
    reading: Callable[[Array], Array] = lambda increments: increments

    def on_load(self, one: Observation, full_scale: float) -> Array:
        """The loads [N] of an observation with this imperfection, for its simulation."""
        load = one.fine_load
        if one.dynamic and self.delay:
            load = np.asarray(np.interp(one.fine_time - self.delay, one.fine_time, load))
        return self.load(load, full_scale)


def _parabola(height: float, load: Array, full_scale: float) -> Array:
    """A load [N] whose error is a parabola over its range; height: share of full scale."""
    return load + height * 4.0 * load * (full_scale - load) / full_scale


def _other_dimension(name: str, change: float, rig: Rig) -> Rig:
    """The rig with one dimension changed [m], or its weight by a share."""
    if name == 'weight':
        carriage = rig.carriage
        return replace(rig, carriage=replace(carriage, weight=(1.0 + change) * carriage.weight))
    if name == 'trunnion_x':
        return replace(rig, trunnion=replace(rig.trunnion, x=rig.trunnion.x + change))
    if name == 'trunnion_y':
        return replace(rig, trunnion=replace(rig.trunnion, y=rig.trunnion.y + change))
    if name == 'clearance_axial':
        row = rig.axial_rows
        return replace(rig, axial_rows=replace(row, clearance=row.clearance + change))
    row = rig.radial_row
    return replace(rig, radial_row=replace(row, clearance=row.clearance + change))


DELAY = 1e-3
"""Delay [s] of the probes whose effect is reported."""

IMPERFECTIONS = (
    Imperfection('load_nonlinearity', '0.1 % of full scale load nonlinearity',
                 load=partial(_parabola, 0.001)),
    Imperfection('axial_clearance', '5 µm of axial clearance',
                 rig=partial(_other_dimension, 'clearance_axial', 5e-6)),
    Imperfection('radial_clearance', '5 µm of radial clearance',
                 rig=partial(_other_dimension, 'clearance_radial', 5e-6)),
    Imperfection('elevation', '0.1 deg of elevation', elevation=float(np.radians(0.1))),
    Imperfection('load_gain', '0.5 % of load gain', load=lambda load, _: 1.005 * load),
    Imperfection('delay', '1 ms between the clocks of load and probes', delay=DELAY),
)
"""Small errors that no fit can detect; the change of the parameters by each is reported."""

def certified_errors(rig: Rig) -> list[Imperfection]:
    """One standard uncertainty of each instrument and dimension that a certificate states."""
    stated = rig.instruments
    made: list[Imperfection] = []
    gain, offset, bend = stated.load_gain, stated.load_offset, stated.load_nonlinearity
    if gain is not None:
        made.append(Imperfection('load_gain', '', load=lambda load, _: (1.0 + gain) * load))
    if offset is not None:
        made.append(Imperfection('load_offset', '', load=lambda load, _: load + offset))
    if bend is not None:
        made.append(Imperfection('load_nonlinearity', '', load=partial(_parabola, bend)))
    if stated.elevation is not None:
        made.append(Imperfection('elevation', '', elevation=stated.elevation))
    for name, delay in (('probe_lag', stated.probe_lag), ('clock', stated.clock)):
        if delay is not None:
            made.append(Imperfection(name, '', delay=delay))
    made += [Imperfection(name, '', rig=partial(_other_dimension, name, change))
             for name, change in (
                 ('clearance_axial', stated.clearance), ('clearance_radial', stated.clearance),
                 ('weight', stated.weight), ('trunnion_x', stated.trunnion),
                 ('trunnion_y', stated.trunnion)) if change is not None]
    if stated.axial_span is not None:
        share = stated.axial_span / rig.probes.axial_span
        made.append(Imperfection('axial_span', '', reading=partial(_tilt_gain, share)))
    if stated.radial_height is not None:
        made.append(Imperfection(
            'radial_height', '', reading=partial(_tilt_in_radial, stated.radial_height)))
    for number in rig.probes.present:
        if stated.probe_gain is not None:
            made.append(Imperfection(f'probe_gain_{number}', '', reading=partial(
                _probe_error, rig, number, 1, stated.probe_gain[number - 1])))
        if stated.probe_nonlinearity is not None:
            made.append(Imperfection(f'probe_nonlinearity_{number}', '', reading=partial(
                _probe_error, rig, number, 2, stated.probe_nonlinearity)))
    return made


def _tilt_gain(share: float, seen: Array) -> Array:
    """Increments (B, 3, N) with a tilt that is read by another span."""
    return np.asarray(seen * np.array([1.0, 1.0, 1.0 + share])[:, None])


def _tilt_in_radial(height: float, seen: Array) -> Array:
    """Increments (B, 3, N) with radial probes that stand higher."""
    read = seen.copy()
    read[:, 0] += height * seen[:, 2]
    return read


def _probe_error(rig: Rig, number: int, power: int, size: float, seen: Array) -> Array:
    """Increments (B, 3, N) with an error of one probe: size times its increment to a power."""
    half, read = 0.5 * rig.probes.axial_span, seen.copy()
    sign = 1.0 if number in (1, 2) else -1.0
    if number in (1, 3):
        own = sign * (seen[:, 0] + rig.probes.radial_height * seen[:, 2])
        read[:, 0] += (1.0 if rig.probes.absent else 0.5) * sign * size * own**power
        return read
    own = seen[:, 1] + sign * half * seen[:, 2]
    read[:, 1] += 0.5 * size * own**power
    read[:, 2] += sign * 0.5 * size * own**power / half
    return read
