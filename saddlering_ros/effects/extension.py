"""Extensions of the ring model: extension parameters, all neutral by default.

An effect of the catalogue (saddlering_ros/effects) is a mapping from its few parameters to these
extension parameters. The order of the fields is the way of the signal: load path, ring,
measurement.
"""

from __future__ import annotations

from dataclasses import dataclass, Field, field, fields, replace
from functools import lru_cache, partial
from itertools import zip_longest
from typing import Any

import numpy as np
from numpy.typing import NDArray

Three = tuple[float, float, float]
Four = tuple[float, float, float, float]
NO_PROBE: Four = (0.0, 0.0, 0.0, 0.0)


@dataclass(frozen=True)
class Hysteron:
    """A rate-free friction element: z in [-1, 1] follows a coordinate, the force is limit times z.

    limit: force [N] (or angle [rad], or moment [N m]) at full slip; presliding: travel [m] (or
    rad, or N) over which it builds up;
    sharpness: 0 exponential approach (Dahl, LuGre at low speed), 1 elastic-plastic (Jenkins),
    linear mixture between; initial: z at the start of the record. Radial friction cannot push the
    ring: there it takes at most the radial load.
    """

    limit: float = 0.0
    presliding: float = 1e-6
    sharpness: float = 0.5
    initial: float = 0.0


@dataclass(frozen=True)
class Wear:
    """A worn arc of one row: its rollers carry a share `loss` less and/or are `gap` [m] lower.

    centre, half_width [rad] from the rear (x > 0); edge [rad]: width of the soft edges.
    """

    centre: float = 0.0
    half_width: float = 0.5
    loss: float = 0.0
    gap: float = 0.0
    edge: float = 0.1

    def profile(self, angle: NDArray[np.float64]) -> NDArray[np.float64]:
        """Share of the full wear, 0 to 1, at roller angles [rad] (smooth edges, periodic)."""
        off_centre = np.abs(np.angle(np.exp(1j * (angle - self.centre))))
        return np.asarray(0.5 * (1.0 - np.tanh((off_centre - self.half_width) / self.edge)))


@dataclass(frozen=True)
class RowGeometry:
    """How one row departs from equal rollers at phi = 2 pi i / N: wear, waves of the gap, phase.

    stiffness: factor on K of the whole row; gap: extra gap of every roller [m], gap_spread [m]: by
    which rollers have more or less of it than their neighbours, evenly from -spread to spread;
    waves [m]: gap + a cos(m phi) + b sin(m phi), a and b of one maximum m, of two, and so on;
    phase: angle phi of the first roller, as a share of the pitch between two rollers.
    """

    stiffness: float = 1.0
    gap: float = 0.0
    gap_spread: float = 0.0
    wear: Wear = field(default_factory=Wear)
    waves: tuple[float, ...] = ()
    phase: float = 0.0

    def beside(self, waves: tuple[float, ...]) -> RowGeometry:
        """The same row with more waves."""
        pairs = zip_longest(self.waves, waves, fillvalue=0.0)
        return replace(self, waves=tuple(own + more for own, more in pairs))


MOTION, ROLLERS, READING = 'motion', 'rollers', 'reading'
"""Target of an extension parameter.

MOTION: loads, friction and damping inside the equation of motion, so that the same rollers touch
at another time or measured load. ROLLERS: stiffness and gaps of rollers. READING: all that is
added to the contact motion and to the probes' readings.
"""

STAGES = ('load path', 'ring', 'measurement')
"""The way of the signal, in order; an effect sets parameters of one stage only."""


def declared(stage: str, acts_on: str, neutral: Any) -> Any:
    """A field for an extension parameter, which has no effect at its neutral value."""
    return field(default=neutral, metadata={'stage': stage, 'acts_on': acts_on})


in_load_path = partial(declared, 'load path', MOTION)
"""A parameter between the load cell and the ring."""

in_ring = partial(declared, 'ring')
"""A parameter of the ring itself, and its target."""

in_measurement = partial(declared, 'measurement', READING)
"""A parameter of probes, cables and clocks."""


@dataclass(frozen=True, order=True)
class OwnParameter:
    """An extension parameter that one effect alone sets, declared in that effect's file.

    It has no effect at 0. The kernels read it by its name, as they do the fields of RingExtension.
    """

    name: str
    stage: str
    acts_on: str

    def of(self, extension: RingExtension) -> float:
        """Its value in an extension."""
        return dict(extension.own).get(self, 0.0)

    def add(self, extension: RingExtension, value: float) -> RingExtension:
        """The extension with `value` added to the parameter."""
        own = {**dict(extension.own), self: self.of(extension) + value}
        there = ((parameter, number) for parameter, number in own.items() if number)
        return replace(extension, own=tuple(sorted(there)))


@dataclass(frozen=True)
class RingExtension:
    """All extension parameters; a default instance is the plain ring model.

    A field is the only declaration of a parameter that a shipped law reads, with or without the
    files of its effects; `own` holds those that effects declare themselves. The kernels read
    either by its name. Load path: P [N] at the ring from the measured P_m, elevation [rad],
    trunnion [m]. Ring: geometry of the rows, friction, series compliances, creep, settling, second
    mode. Measurement: tuples of four are per probe 1..4.
    """

    # Load path
    load_gain: float = in_load_path(0.0)  # P = P_m / (1 + g)
    load_offset: float = in_load_path(0.0)  # P = P_m - P0 [N]
    load_nonlinearity: float = in_load_path(0.0)  # P = P_m + 4 c P_m (P_fs - P_m) / P_fs
    cylinder_friction: Hysteron = in_load_path(Hysteron(presliding=2000.0))
    elevation_error: float = in_load_path(0.0)  # [rad]
    moment_arm: float = in_load_path(0.0)  # trunnion y_t + e [m]
    # Limit in [rad], presliding in [N]
    bracket_play: Hysteron = in_load_path(Hysteron(presliding=2000.0))
    # Ring
    upper_row: RowGeometry = in_ring(ROLLERS, RowGeometry())
    lower_row: RowGeometry = in_ring(ROLLERS, RowGeometry())
    radial_row: RowGeometry = in_ring(ROLLERS, RowGeometry())
    # Limits of the next three in [N], [N] and [N m], presliding in [m], [m] and [rad]
    radial_friction: Hysteron = in_ring(MOTION, Hysteron(presliding=2e-6))
    axial_friction: Hysteron = in_ring(MOTION, Hysteron(presliding=3e-6))
    tilt_friction: Hysteron = in_ring(MOTION, Hysteron(presliding=3e-6))
    damping_penetration_share: float = in_ring(MOTION, 0.0)  # 0 constant D, 1 all grows with p
    damping_penetration_exponent: float = in_ring(MOTION, 0.0)  # m of p^m; 0: n of the row
    # 1 / (p beyond which it grows no more) [1/m]
    damping_penetration_saturation: float = in_ring(MOTION, 0.0)
    radial_compliance: float = in_ring(READING, 0.0)  # delta_x += c F_x [m/N]
    axial_compliance: float = in_ring(READING, 0.0)  # delta_y += c F_y [m/N]
    tilt_compliance: float = in_ring(READING, 0.0)  # gamma += c M [rad/(N m)]
    ovalisation: float = in_ring(READING, 0.0)  # d1 and d3 += c F_x [m/N]
    opening_compliance: float = in_ring(READING, 0.0)  # gamma += c max(0, M - M0) [rad/(N m)]
    opening_moment: float = in_ring(READING, 0.0)  # M0 [N m]
    opening_spread: float = in_ring(READING, 0.0)  # w: M0 spread over M0 - w to M0 + w [N m]
    creep_radial: float = in_ring(READING, 0.0)  # delta_x += c LP_T(delta_x)
    creep_axial: float = in_ring(READING, 0.0)  # delta_y, gamma += c LP_T(.)
    creep_time: float = in_ring(READING, 10.0)  # T [s]
    settling_x: float = in_ring(READING, 0.0)  # delta_x += s max P so far [m/N]
    settling_y: float = in_ring(READING, 0.0)  # [m/N]
    settling_tilt: float = in_ring(READING, 0.0)  # [rad/N]
    resonance_frequency: float = in_ring(READING, 0.0)  # second mode [rad/s]; 0: none
    resonance_damping: float = in_ring(READING, 0.05)  # share of the critical damping
    # Share of the motion in the second mode, of delta_x, delta_y, gamma
    resonance_share: Three = in_ring(READING, (1.0, 1.0, 1.0))
    # Measurement
    probe_height: float = in_measurement(0.0)  # d1, -d3 += h gamma [m]
    probe_bracket: Four = in_measurement(NO_PROBE)  # d_i += b P [m/N]
    probe_gain: Four = in_measurement(NO_PROBE)  # d_i (1 + g)
    probe_nonlinearity: Four = in_measurement(NO_PROBE)  # d_i += q d_i^2 [1/m]
    probe_drift: Four = in_measurement(NO_PROBE)  # d_i += r t [m/s]
    probe_lag: Four = in_measurement(NO_PROBE)  # low-pass, both time constants [s]
    probe_lag_second: Four = in_measurement(NO_PROBE)  # share of them in a second stage
    pickup_cosine: Four = in_measurement(NO_PROBE)  # d_i += a cos(w t) + b sin(w t) [m]
    pickup_sine: Four = in_measurement(NO_PROBE)  # [m]
    pickup_frequency: float = in_measurement(50.0)  # [Hz]
    saturation_low: Four = in_measurement((-1.0, -1.0, -1.0, -1.0))  # d_i clipped here [m]
    saturation_high: Four = in_measurement((1.0, 1.0, 1.0, 1.0))  # [m]
    clock_offset: float = in_measurement(0.0)  # probes' clock = load's clock + tau [s]
    clock_skew: float = in_measurement(0.0)  # ... + skew * time [s/s]

    # Declared by effects: parameter and value, in order of their names
    own: tuple[tuple[OwnParameter, float], ...] = ()

    def only(self, acts_on: str) -> RingExtension:
        """The same extension without the parameters that act on something else."""
        kept = {item.name: getattr(self, item.name) for item in shared_parameters()
                if item.metadata['acts_on'] == acts_on}
        own = tuple(item for item in self.own if item[0].acts_on == acts_on)
        return RingExtension(**kept, own=own)


@lru_cache(maxsize=1)
def shared_parameters() -> tuple[Field[Any], ...]:
    """Extension parameters that are fields, in the order of the signal's way."""
    return tuple(item for item in fields(RingExtension) if item.metadata)


NO_EXTENSION = RingExtension()


def at_probe(values: Four, probe: int, value: float) -> Four:
    """The same tuple with `value` added at probe 1 to 4, or at all probes for 0."""
    changed = [old + (value if probe in (0, number) else 0.0)
               for number, old in enumerate(values, start=1)]
    return changed[0], changed[1], changed[2], changed[3]
