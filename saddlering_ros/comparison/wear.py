"""Figures by which makers of slewing rings judge wear, and their limits."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import product
import math
from typing import Any

import numpy as np

from saddlering_ros.estimation.noise import noise_alone
from saddlering_ros.record.batches import Floats
from saddlering_ros.record.displacement import displacement_of_run
from saddlering_ros.record.plateaus import Plateaus, plateaus
from saddlering_ros.record.record import Record
from saddlering_ros.rig import Rig
from saddlering_ros.rig.description import WEAR_LIMITS

AXIAL = [1, 3]
"""Rows of the axial probes, 2 and 4."""


@dataclass(frozen=True)
class MakerFigures:
    """Figures by which makers judge wear, of one static test under two defined loads.

    Makers of slewing rings (Rothe Erde, Slewing Bearings, maintenance; Liebherr, Product catalogue
    slewing bearings, wear measurement) define both as differences against a base measurement that
    was made at marked positions when the ring went into service, under the same defined loads.
    The tilting clearance is the axial movement between the rings at the raceway, on the side of
    the load, from the smaller to the larger defined load. The axial reduction is the approach of
    the rings along the axis under the larger one. This suite states no limit values; the user's
    own stand in the rig file as `rig.wear_limits`.

    elevation [rad]; low, high: the defined loads [N]; tilting_clearance and axial_reduction [m],
    each with the standard deviation of its readings [m]; gain: standard uncertainty of the gain of
    the probes by their certificate, 0 if none states it.
    """

    elevation: float
    low: float
    high: float
    tilting_clearance: float
    tilting_clearance_std: float
    axial_reduction: float
    axial_reduction_std: float
    gain: float = 0.0

    def as_dict(self) -> dict[str, float]:
        """In millimetres, as makers state them."""
        return {'elevation_deg': math.degrees(self.elevation), 'low_N': self.low,
                'high_N': self.high, **self.wear_since(None)}

    def wear_since(self, base: 'MakerFigures | None') -> dict[str, float]:
        """The difference to a base measurement, or to none [mm], with its standard deviation [mm].

        The gain of the probes is the same in both, so that it counts for the difference alone.
        """
        answer: dict[str, float] = {}
        for name in WEAR_LIMITS:
            wear = getattr(self, name) - getattr(base, name, 0.0)
            spreads = [getattr(one, f'{name}_std', 0.0) for one in (self, base)]
            answer |= {f'{name}_mm': 1e3 * wear,
                       f'{name}_std_mm': 1e3 * math.hypot(*spreads, self.gain * wear)}
        return answer


def judged_wear(wear: Mapping[str, float], limits: Mapping[str, float]) -> list[dict[str, Any]]:
    """The wear [mm] by the user's limits [m]: within, beyond, or open within two deviations."""
    answer = []
    for name, limit in limits.items():
        left = 1e3 * limit - wear[f'{name}_mm']
        is_open = abs(left) < 2.0 * wear[f'{name}_std_mm']
        answer.append({
            'figure': name, 'limit_mm': 1e3 * limit, 'share': wear[f'{name}_mm'] / (1e3 * limit),
            'state': 'open' if is_open else 'within' if left > 0.0 else 'beyond'})
    return answer


def maker_figures(rig: Rig, record: Record, loads: tuple[float, float]) -> MakerFigures:
    """The figures of a static test under two defined loads [N].

    Readings are those of the rising branch, interpolated between the held loads.
    """
    steps = plateaus(record)
    zero = np.array(displacement_of_run(rig, record).zero.gaps)[AXIAL]
    rising = np.flatnonzero(steps.branch >= 0)[: int(np.argmax(steps.load)) + 1]
    order = rising[np.argsort(steps.load[rising])]
    polarity = np.array(rig.probes.polarity)[AXIAL]
    increments = polarity[:, None] * (steps.gaps[AXIAL][:, order] - zero[:, None])
    readings, errors = (
        np.array([np.interp(loads, steps.load[order], row) for row in rows])
        for rows in (increments, standard_errors(record, steps)[:, order]))
    axial, deviation = np.diff(readings, axis=1)[:, 0], np.hypot(errors[:, 0], errors[:, 1])
    lever = rig.axial_rows.pitch_radius / rig.probes.axial_span
    raceway = np.array([0.5 - lever, 0.5 + lever])
    return MakerFigures(
        record.elevation, *loads,
        tilting_clearance=abs(float(raceway @ axial)),
        tilting_clearance_std=float(np.linalg.norm(raceway * deviation)),
        axial_reduction=-float(axial.mean()),
        axial_reduction_std=0.5 * float(np.linalg.norm(deviation)),
        gain=max(rig.instruments.probe_gain or (0.0,)))


def common_loads(before: Record, after: Record) -> tuple[float, float]:
    """The smallest and the largest load [N] that both static tests held."""
    held = [plateaus(record).load for record in (before, after)]
    return max(float(load.min()) for load in held), min(float(load.max()) for load in held)


def standard_errors(record: Record, steps: Plateaus) -> Floats:
    """Standard errors (2, M) [m] of the plateaus' readings of the axial probes.

    They are those of means of the noise that a probe shows on all plateaus.
    """
    step, errors = float(np.median(np.diff(record.time))), []
    for row in record.gaps[AXIAL]:
        held = (row[start:stop] for start, stop in zip(steps.start, steps.stop, strict=True))
        parts = [readings[np.isfinite(readings)] for readings in held]
        lasting = step * np.array([max(len(readings), 1) for readings in parts], dtype=float)
        errors.append(np.sqrt(noise_alone(parts, step).variances(lasting)))
    return np.array(errors)


def figures_of_sessions(
    rig: Rig, before: Sequence[Record], after: Sequence[Record],
) -> tuple[MakerFigures, MakerFigures] | None:
    """Figures of the first static tests at one elevation, one of each session."""
    for first, second in product(before, after):
        alike = abs(first.elevation - second.elevation) < math.radians(0.5)
        if first.test == second.test == 'static' and alike and not rig.probes.absent:
            loads = common_loads(first, second)
            return maker_figures(rig, first, loads), maker_figures(rig, second, loads)
    return None
