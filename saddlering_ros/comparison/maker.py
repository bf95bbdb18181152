"""Figures by which makers judge wear: tilting clearance and axial reduction of a static test.

Makers of slewing rings (Rothe Erde, Slewing Bearings, maintenance; Liebherr, Product catalogue
slewing bearings, wear measurement) define both as differences against a base measurement that was
made at marked positions when the ring went into service, under the same defined loads:

- tilting clearance: axial movement between the rings at the raceway, on the side of the load, from
  the smaller to the larger defined load;
- axial reduction: approach of the rings along the axis under the larger defined load.

This suite states no limit values; a user's own table belongs beside the figures.
"""

from __future__ import annotations

from dataclasses import dataclass
import math

import numpy as np

from saddlering_ros.record import displacement_of_run, plateaus, Record
from saddlering_ros.rig import Rig


@dataclass(frozen=True)
class MakerFigures:
    """Figures of one static test under two defined loads.

    elevation [rad]; low, high: the defined loads [N]; tilting_clearance and axial_reduction [m],
    each with its standard deviation [m].
    """

    elevation: float
    low: float
    high: float
    tilting_clearance: float
    tilting_clearance_std: float
    axial_reduction: float
    axial_reduction_std: float

    def as_dict(self) -> dict[str, float]:
        """In millimetres, as makers state them."""
        return {
            'elevation_deg': math.degrees(self.elevation), 'low_N': self.low, 'high_N': self.high,
            'tilting_clearance_mm': 1e3 * self.tilting_clearance,
            'tilting_clearance_std_mm': 1e3 * self.tilting_clearance_std,
            'axial_reduction_mm': 1e3 * self.axial_reduction,
            'axial_reduction_std_mm': 1e3 * self.axial_reduction_std,
        }

    def wear_since(self, base: MakerFigures) -> dict[str, float]:
        """The difference to a base measurement [mm], with its standard deviation [mm]."""
        return {
            'tilting_clearance_mm': 1e3 * (self.tilting_clearance - base.tilting_clearance),
            'tilting_clearance_std_mm': 1e3 * math.hypot(
                self.tilting_clearance_std, base.tilting_clearance_std),
            'axial_reduction_mm': 1e3 * (self.axial_reduction - base.axial_reduction),
            'axial_reduction_std_mm': 1e3 * math.hypot(
                self.axial_reduction_std, base.axial_reduction_std),
        }


def maker_figures(rig: Rig, record: Record, loads: tuple[float, float]) -> MakerFigures:
    """The figures of a static test under two defined loads [N].

    Readings are those of the rising branch, interpolated between the held loads. The standard
    deviation is that of the plateaus' means.
    """
    steps = plateaus(record)
    zero = np.array(displacement_of_run(rig, record).zero.gaps)
    rising = np.flatnonzero(steps.branch >= 0)[: int(np.argmax(steps.load)) + 1]
    order = rising[np.argsort(steps.load[rising])]
    polarity = np.array(rig.probes.polarity)
    increments = polarity[:, None] * (steps.gaps[:, order] - zero[:, None])
    readings = np.array([np.interp(loads, steps.load[order], row) for row in increments])
    errors = np.array([np.interp(loads, steps.load[order], row)
                       for row in steps.gaps_std_error[:, order]])
    change, deviation = np.diff(readings, axis=1)[:, 0], np.hypot(errors[:, 0], errors[:, 1])
    lever = rig.axial_rows.pitch_radius / rig.probes.axial_span
    raceway = np.array([0.5 - lever, 0.5 + lever])
    axial, axial_deviation = change[[1, 3]], deviation[[1, 3]]
    return MakerFigures(
        record.elevation, *loads,
        tilting_clearance=abs(float(raceway @ axial)),
        tilting_clearance_std=float(np.linalg.norm(raceway * axial_deviation)),
        axial_reduction=-float(axial.mean()),
        axial_reduction_std=0.5 * float(np.linalg.norm(axial_deviation)))


def common_loads(before: Record, after: Record) -> tuple[float, float]:
    """The smallest and the largest load [N] that both static tests held."""
    held = [plateaus(record, errors=False).load for record in (before, after)]
    return max(float(load.min()) for load in held), min(float(load.max()) for load in held)
