"""From dataclasses to the flat arrays of the kernels: rig, contact law, extension, elevation."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import ArrayLike, NDArray

from saddlering_ros.effects.extension import Hysteron, NO_EXTENSION, RingExtension, RowGeometry
from saddlering_ros.rig import ContactParameters, Rig, RollerRow
from saddlering_ros.ring.kernels import layout as at

Floats = NDArray[np.float64]

VECTOR = 8
"""Rollers of a row are worked on in groups of so many."""

FAR_OFF = 1.0
"""Gap [m] of a place in a row that holds no roller."""


@dataclass(frozen=True)
class Rows:
    """Rollers of upper, lower and middle row as the kernels want them.

    arrays (3, 3, J): per row its cosines (falling), weights (rollers at that cosine times the
    share of the force they carry) and gaps [m]; uniform (3,): whether all gaps of a row are equal.
    """

    arrays: Floats
    uniform: NDArray[np.bool_]
    counts: tuple[int, int, int]

    @property
    def flat(self) -> Floats:
        """The kernels' own copy of `arrays`, shape (9 J,)."""
        return np.array(self.arrays.reshape(-1), dtype=np.float64)


@dataclass(frozen=True)
class RingModel:
    """One simulator's constants: scalars (M,) by `layout`, and its rows."""

    scalars: Floats
    rows: Rows


def roller_angles(row: RollerRow) -> Floats:
    """phi_i = 2 pi i / N, shape (N,), from the rear (x > 0)."""
    return np.arange(row.rollers, dtype=np.float64) * (2.0 * np.pi / row.rollers)


def mixed(count: int) -> Floats:
    """Numbers (N,) evenly between -1 and 1, mixed so that any few neighbours reach over all.

    Multiples of the golden ratio less their whole parts (H. Weyl, Math. Ann. 77 (1916) 313).
    """
    golden = 0.5 * (np.sqrt(5.0) - 1.0)
    return np.asarray(2.0 * np.modf((np.arange(count) + 0.5) * golden)[0] - 1.0)


def _row(row: RollerRow, geometry: RowGeometry) -> tuple[Floats, Floats, Floats, bool]:
    angle = roller_angles(row)
    half_gap = 0.5 * row.clearance + geometry.gap
    if geometry.wear.is_none and geometry.oval_amplitude == geometry.gap_spread == 0.0:
        index = np.arange(row.rollers // 2 + 1)
        twins = np.where((index == 0) | (2 * index == row.rollers), 1.0, 2.0)
        return (np.cos(angle[index]), twins,
                np.full(index.size, half_gap), True)
    wear = geometry.wear.profile(angle)
    weight = 1.0 - geometry.wear.loss * wear
    gap = (half_gap + geometry.wear.gap * wear
           + geometry.gap_spread * mixed(row.rollers)
           + geometry.oval_amplitude * np.cos(2.0 * (angle - geometry.oval_angle)))
    cosine = np.cos(angle)
    order = np.argsort(-cosine, kind='stable')
    return cosine[order], weight[order], gap[order], False


def _padded(rows: Sequence[Floats]) -> Floats:
    """Rows (3, J_i) in one array (3, 3, J); what is filled up stands far off and carries nothing.

    The kernels go on to the next multiple of VECTOR rollers: J leaves room for that.
    """
    longest = max(row.shape[1] for row in rows)
    arrays = np.zeros((len(rows), 3, (longest // VECTOR + 2) * VECTOR))
    arrays[:, 2] = FAR_OFF
    for place, row in zip(arrays, rows, strict=True):
        place[:, :row.shape[1]] = row
    return arrays


@lru_cache(maxsize=512)
def _rows_cached(axial: RollerRow, middle: RollerRow, upper: RowGeometry, lower: RowGeometry,
                 centre: RowGeometry) -> Rows:
    parts = [_row(axial, upper), _row(axial, lower), _row(middle, centre)]
    arrays = _padded([np.stack(part[:3]) for part in parts])
    arrays.flags.writeable = False
    uniform = np.array([part[3] for part in parts])
    counts = (parts[0][0].size, parts[1][0].size, parts[2][0].size)
    return Rows(arrays, uniform, counts)


def rows_of(rig: Rig, extension: RingExtension = NO_EXTENSION) -> Rows:
    """The three rows of a rig under an extension (kept between calls)."""
    rows = _rows_cached(rig.axial_rows, rig.middle_row, extension.upper_row, extension.lower_row,
                        extension.middle_row)
    if rows.counts[0] == rows.counts[1]:
        return rows
    # The kernels know one count for both axial rows: spread the row that was merged.
    wide = [_spread(rig.axial_rows, geometry)
            for geometry in (extension.upper_row, extension.lower_row)]
    return Rows(_padded([*wide, rows.arrays[2]]), np.array([False, False, rows.uniform[2]]),
                (rig.axial_rows.rollers, rig.axial_rows.rollers, rows.counts[2]))


def _spread(row: RollerRow, geometry: RowGeometry) -> Floats:
    cosine, weight, gap, merged = _row(row, geometry)
    if not merged:
        return np.stack([cosine, weight, gap])
    full = np.cos(roller_angles(row))
    full = full[np.argsort(-full, kind='stable')]
    return np.stack([full, np.ones(row.rollers), np.full(row.rollers, gap[0])])


def _put_hysteron(scalars: Floats, place: int, hysteron: Hysteron) -> None:
    scalars[place:place + 4] = (hysteron.limit, hysteron.presliding, hysteron.sharpness,
                                hysteron.initial)


def scalars_of(rig: Rig, elevation: float, extension: RingExtension = NO_EXTENSION) -> Floats:
    """The model's scalars (M,) without the contact law, which `with_contact` puts in."""
    m = np.zeros(at.MODEL_SIZE)
    rows = rows_of(rig, extension)
    m[at.RADIUS] = rig.axial_rows.pitch_radius
    m[at.MIDDLE_HEIGHT] = rig.middle_row.height
    m[at.AXIAL_ROLLERS], m[at.MIDDLE_ROLLERS] = rows.counts[0], rows.counts[2]
    m[at.AXIAL_CLEARANCE] = rig.axial_rows.clearance
    m[at.MIDDLE_CLEARANCE] = rig.middle_row.clearance
    m[at.MASS], m[at.INERTIA] = rig.carriage.mass, rig.carriage.inertia
    m[at.WEIGHT], m[at.WEIGHT_X] = rig.carriage.weight, rig.carriage.weight_x
    m[at.TRUNNION_X], m[at.TRUNNION_Y] = rig.trunnion.x, rig.trunnion.y
    m[at.ELEVATION], m[at.FULL_SCALE] = elevation, rig.full_scale_load
    m[at.COSINE] = np.cos(elevation + extension.elevation_error)
    m[at.SINE] = np.sin(elevation + extension.elevation_error)
    m[at.AXIAL_SPAN], m[at.RADIAL_HEIGHT] = rig.probes.axial_span, rig.probes.radial_height
    m[at.LOAD_GAIN], m[at.LOAD_OFFSET] = extension.load_gain, extension.load_offset
    m[at.LOAD_CURVE] = extension.load_nonlinearity
    m[at.ELEVATION_ERROR], m[at.MOMENT_ARM] = extension.elevation_error, extension.moment_arm
    _put_hysteron(m, at.CYLINDER_LIMIT, extension.cylinder_friction)
    _put_hysteron(m, at.BRACKET_LIMIT, extension.bracket_play)
    _put_hysteron(m, at.RADIAL_LIMIT, extension.radial_friction)
    _put_hysteron(m, at.TILT_LIMIT, extension.tilt_friction)
    m[at.UPPER_STIFFNESS] = extension.upper_row.stiffness
    m[at.LOWER_STIFFNESS] = extension.lower_row.stiffness
    m[at.MIDDLE_STIFFNESS] = extension.middle_row.stiffness
    m[at.DAMPING_SHARE] = extension.damping_penetration_share
    m[at.DAMPING_EXPONENT] = extension.damping_penetration_exponent
    m[at.DAMPING_LEVELLING] = extension.damping_penetration_levelling
    m[at.RADIAL_COMPLIANCE] = extension.radial_compliance
    m[at.AXIAL_COMPLIANCE] = extension.axial_compliance
    m[at.TILT_COMPLIANCE] = extension.tilt_compliance
    m[at.OPENING_COMPLIANCE] = extension.opening_compliance
    m[at.OPENING_MOMENT] = extension.opening_moment
    m[at.OPENING_SPREAD] = extension.opening_spread
    m[at.CREEP_RADIAL], m[at.CREEP_AXIAL] = extension.creep_radial, extension.creep_axial
    m[at.CREEP_TIME] = extension.creep_time
    m[at.SETTLING_X], m[at.SETTLING_Y] = extension.settling_x, extension.settling_y
    m[at.SETTLING_TILT] = extension.settling_tilt
    m[at.RESONANCE_FREQUENCY] = extension.resonance_frequency
    m[at.RESONANCE_DAMPING] = extension.resonance_damping
    m[at.RESONANCE_SHARE] = extension.resonance_share
    m[at.OVALISATION], m[at.PROBE_HEIGHT] = extension.ovalisation, extension.probe_height
    m[at.PICKUP_FREQUENCY] = extension.pickup_frequency
    m[at.CLOCK_OFFSET], m[at.CLOCK_SKEW] = extension.clock_offset, extension.clock_skew
    fours = (
        (at.BRACKET, extension.probe_bracket), (at.GAIN, extension.probe_gain),
        (at.CURVE, extension.probe_nonlinearity), (at.DRIFT, extension.probe_drift),
        (at.LAG, extension.probe_lag), (at.LAG_SECOND, extension.probe_lag_second),
        (at.PICKUP_COSINE, extension.pickup_cosine),
        (at.PICKUP_SINE, extension.pickup_sine), (at.CLIP_LOW, extension.saturation_low),
        (at.CLIP_HIGH, extension.saturation_high),
    )
    for place, values in fours:
        m[place:place + 4] = values
    return m


def with_contact(scalars: Floats, contacts: ArrayLike) -> Floats:
    """Copies of `scalars` (M,) with each contact law of `contacts` (B, 6) put in; shape (B, M)."""
    laws = np.atleast_2d(np.asarray(contacts, dtype=np.float64))
    batch = np.repeat(scalars[None, :], laws.shape[0], axis=0)
    batch[:, at.K1:at.K1 + 6] = laws
    return batch


def build_model(rig: Rig, contact: ContactParameters, elevation: float,
                extension: RingExtension = NO_EXTENSION) -> RingModel:
    """Constants of one simulator: rig, contact law, elevation [rad] and extension."""
    scalars = with_contact(scalars_of(rig, elevation, extension), contact.to_array())[0]
    return RingModel(scalars, rows_of(rig, extension))


def stack_rows(rows: Sequence[Rows]) -> tuple[Floats, NDArray[np.bool_]]:
    """Rows of a batch, flat: (R, 9 J) and uniform (R, 3); R = 1 where all are the same."""
    if all(row is rows[0] for row in rows):
        return rows[0].flat[None], rows[0].uniform[None]
    longest = max(row.arrays.shape[2] for row in rows)
    arrays = np.zeros((len(rows), 3, 3, longest))
    arrays[:, :, 2] = FAR_OFF
    for place, row in zip(arrays, rows, strict=True):
        place[:, :, :row.arrays.shape[2]] = row.arrays
    return arrays.reshape(len(rows), -1), np.array([row.uniform for row in rows])
