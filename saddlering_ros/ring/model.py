"""Conversion of dataclasses to arrays of the kernels: rig, contact law, extension, rollers."""

from collections.abc import Sequence
from dataclasses import dataclass, fields
from functools import lru_cache
from operator import attrgetter
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from saddlering_ros.effects import extension as effect_extension
from saddlering_ros.effects import own_parameters
from saddlering_ros.effects.extension import Hysteron, NO_EXTENSION, RingExtension, RowGeometry
from saddlering_ros.rig import PARAMETER_NAMES, Rig, RollerRow

Floats = NDArray[np.float64]
Model = NDArray[np.void]

VECTOR = 8
"""Number of rollers that are computed at once."""

FAR_OFF = 1.0
"""Gap [m] of an unused place of a row."""


@dataclass(frozen=True, eq=False)
class Rows:
    """Rollers of upper, lower and radial row in the form of the kernels.

    flat (9 J,): per row its cosines (falling), weights (number of rollers at this cosine times
    the share of the force that they carry) and gaps [m]; uniform (3,): whether all gaps of a row
    are equal; counts: places of an axial and of the radial row. Equal rows are one object
    (`rows_of` keeps them), and are compared as such. Nothing may write to them.
    """

    flat: Floats
    uniform: NDArray[np.bool_]
    counts: tuple[int, int]


def mixed(count: int) -> Floats:
    """Numbers (N,) spread evenly between -1 and 1, in an order in which neighbours differ widely.

    Fractional parts of multiples of the golden ratio (H. Weyl, Math. Ann. 77 (1916) 313).
    """
    golden = 0.5 * (np.sqrt(5.0) - 1.0)
    return np.asarray(2.0 * np.modf((np.arange(count) + 0.5) * golden)[0] - 1.0)


@lru_cache(maxsize=64)
def _waves(rollers: int, phase: float, count: int) -> Floats:
    """cos(m phi) and sin(m phi) at each roller for m = 1, 2, ... (count, rollers)."""
    places = np.arange(rollers) + phase
    turns = 2.0 * np.pi / rollers * np.outer(np.arange(count) // 2 + 1, places)
    return np.where(np.arange(count)[:, None] % 2, np.sin(turns), np.cos(turns))


def _row(row: RollerRow, geometry: RowGeometry, twins: bool) -> Floats:
    """Cosines, weights and gaps (3, J) of a row; `twins`: equal mirror twins share a place."""
    index = np.arange(row.rollers // 2 + 1 if twins else row.rollers, dtype=np.float64)
    # From the rear (x > 0).
    angle = (index + geometry.phase) * (2.0 * np.pi / row.rollers)
    cosine = np.cos(angle)
    half_gap = 0.5 * row.clearance + geometry.gap
    if twins:
        alone = (index == 0) | (2 * index == row.rollers)
        return np.stack([cosine, np.where(alone, 1.0, 2.0), np.full(index.size, half_gap)])
    worn = geometry.wear.loss or geometry.wear.gap
    wear = geometry.wear.profile(angle) if worn else np.zeros(row.rollers)
    gap = half_gap + geometry.wear.gap * wear + geometry.gap_spread * mixed(row.rollers)
    if geometry.waves:
        gap += geometry.waves @ _waves(row.rollers, geometry.phase, len(geometry.waves))
    order = np.argsort(-cosine, kind='stable')
    return np.stack([cosine, 1.0 - geometry.wear.loss * wear, gap])[:, order]


@lru_cache(maxsize=512)
def _rows(axial: RollerRow, radial: RollerRow, geometry: tuple[RowGeometry, ...],
          twins: bool) -> Rows:
    """Rows of upper, lower and radial geometry; `twins`: equal mirror twins share a place."""
    equal = [
        twins and not any(
            (part.wear.loss, part.wear.gap, part.gap_spread, part.phase, *part.waves))
        for part in geometry]
    # The kernels have one number of places for both axial rows.
    equal[0] = equal[1] = equal[0] and equal[1]
    if twins and not any(equal):
        return _rows(axial, radial, geometry, False)
    parts = [_row(row, part, same)
             for row, part, same in zip((axial, axial, radial), geometry, equal, strict=True)]
    counts = parts[0].shape[1], parts[2].shape[1]
    # The kernels compute up to the next multiple of VECTOR rollers. Unused places have a large
    # gap and carry no load.
    arrays = np.zeros((3, 3, (max(counts) // VECTOR + 2) * VECTOR))
    arrays[:, 2] = FAR_OFF
    for place, part in zip(arrays, parts, strict=True):
        place[:, :part.shape[1]] = part
    return Rows(arrays.reshape(-1), np.array(equal), counts)


def _geometry(extension: RingExtension) -> tuple[RowGeometry, ...]:
    return extension.upper_row, extension.lower_row, extension.radial_row


def rows_of(rig: Rig, extension: RingExtension = NO_EXTENSION) -> Rows:
    """The three rows of a rig under an extension (cached)."""
    return _prepared(rig, extension)[0]


def spread_rows(rig: Rig, extension: RingExtension) -> Rows:
    """The three rows with a place for every roller, also for equal mirror twins."""
    return _rows(rig.axial_rows, rig.radial_row, _geometry(extension), False)


def _field(name: str, neutral: Any) -> tuple[Any, ...]:
    """Field of the model's record for one extension parameter, by its neutral value."""
    if isinstance(neutral, RowGeometry):
        return f'{name}_stiffness', 'f8'  # gaps and wear are in `Rows`
    if isinstance(neutral, Hysteron):
        return name, [(part.name, 'f8') for part in fields(Hysteron)]
    if isinstance(neutral, tuple):
        return name, 'f8', (len(neutral),)
    return name, 'f8'


RIG_FIELDS = (
    'radius', 'radial_row_height', 'axial_rollers', 'radial_rollers', 'axial_clearance',
    'radial_clearance', 'mass', 'inertia', 'weight', 'weight_x', 'trunnion_x', 'trunnion_y',
    'elevation', 'full_scale', 'cosine', 'sine', 'axial_span', 'probe_plane_height')
"""Constants of rig and elevation; cosine and sine of the elevation without bracket play."""

EXTENSION_FIELDS = [
    *((_field(one.name, getattr(NO_EXTENSION, one.name)), one.metadata['stage'],
       one.metadata['acts_on']) for one in effect_extension.shared_parameters()),
    *(((one.name, 'f8'), one.stage, one.acts_on) for one in own_parameters())]
"""Fields of the model's record for extension parameters, with their stage and target."""

MODEL = np.dtype([
    *((name, 'f8') for name in (*RIG_FIELDS, *PARAMETER_NAMES)),
    *(entry for entry, _, _ in EXTENSION_FIELDS)])
"""The record of the kernels, read by name: rig, contact law, every extension parameter.

All fields are floats, so that a record is also a row of floats.
"""


def columns(*names: str) -> list[int]:
    """Indices of fields of the model's record, with all their parts, in its row of floats."""
    places: list[int] = []
    for name in names:
        kind, start = MODEL.fields[name][:2]  # type: ignore[index]
        places += range(start // 8, (start + kind.itemsize) // 8)
    return places


_ELEVATION, _COSINE, _SINE, _ELEVATION_ERROR = columns(
    'elevation', 'cosine', 'sine', 'elevation_error')
_LAW = slice(len(RIG_FIELDS), len(RIG_FIELDS) + len(PARAMETER_NAMES))
_shared_values = attrgetter(*(
    parameter.name for parameter in effect_extension.shared_parameters()))


def _numbers(extension: RingExtension) -> list[float]:
    """Numbers of the extension in the order of `MODEL`."""
    numbers: list[float] = []
    for value in _shared_values(extension):
        if value.__class__ is float:
            numbers.append(value)
        elif isinstance(value, tuple):
            numbers += value
        elif isinstance(value, Hysteron):
            numbers += value.limit, value.presliding, value.sharpness, value.initial
        else:
            numbers.append(value.stiffness if isinstance(value, RowGeometry) else value)
    own_values = dict(extension.own)
    return numbers + [own_values.get(parameter, 0.0) for parameter in own_parameters()]


def _prepared(rig: Rig, extension: RingExtension) -> tuple[Rows, Floats]:
    """Rows of a model, and numbers (M,) of its record without contact law and elevation.

    They are kept with the extension for its last rig: a fit simulates it for every run and
    neighbour.
    """
    kept: tuple[Rig, Rows, Floats] | None = vars(extension).get('_prepared')
    if kept is None or kept[0] is not rig:
        axial, radial, carriage = rig.axial_rows, rig.radial_row, rig.carriage
        rows = _rows(axial, radial, _geometry(extension), True)
        kept = rig, rows, np.array([
            axial.pitch_radius, radial.height, *rows.counts, axial.clearance, radial.clearance,
            carriage.mass, carriage.inertia, carriage.weight, carriage.weight_x, rig.trunnion.x,
            rig.trunnion.y, 0.0, rig.full_scale_load, 0.0, 0.0, rig.probes.axial_span,
            rig.probes.radial_height, *[0.0] * len(PARAMETER_NAMES), *_numbers(extension)],
            dtype=np.float64)
        object.__setattr__(extension, '_prepared', kept)
    return kept[1:]


def models_of(rig: Rig, elevation: float, contacts: Floats,
              extensions: Sequence[RingExtension]) -> Model:
    """Records (B,) of contact laws (B, 6), each with its extension, at an elevation [rad]."""
    numbers = np.array([_prepared(rig, extension)[1] for extension in extensions])
    numbers[:, _LAW] = contacts
    return _turned(numbers, elevation)


def model_of(rig: Rig, elevation: float, contact: ArrayLike,
             extension: RingExtension = NO_EXTENSION) -> Model:
    """The record of a model, an array of one, of a contact law (6,) at an elevation [rad]."""
    return models_of(rig, elevation, np.atleast_2d(contact), [extension])


def at_elevation(models: Model, elevation: float) -> Model:
    """Copies (B,) of records at another elevation [rad]."""
    return _turned(floats(models).copy(), elevation)


def _turned(numbers: Floats, elevation: float) -> Model:
    """Rows of numbers (B, M) as records; numbers, since NumPy copies records very slowly."""
    at_ring = elevation + numbers[:, _ELEVATION_ERROR]
    numbers[:, _ELEVATION] = elevation
    numbers[:, _COSINE], numbers[:, _SINE] = np.cos(at_ring), np.sin(at_ring)
    return numbers.view(MODEL)[:, 0]


_MOVES = np.array([
    acts_on != effect_extension.READING
    for entry, _, acts_on in EXTENSION_FIELDS
    for _ in range(np.dtype([entry]).itemsize // 8)])
_NEUTRAL = np.array(_numbers(NO_EXTENSION), dtype=np.float64)


def floats(models: Model) -> Floats:
    """Records (B,) as rows of numbers (B, M)."""
    return models.view(np.float64).reshape(models.size, MODEL.itemsize // 8)


def read_motion_only(models: Model) -> NDArray[np.bool_]:
    """Mask (B,) of the models without additions to the motion and to the readings."""
    added = floats(models)[:, _LAW.stop:][:, ~_MOVES]
    return np.asarray((added == _NEUTRAL[~_MOVES]).all(axis=1))


def same_motions(models: Model, rows: Sequence[Rows]) -> NDArray[np.intp]:
    """For each of the models (B,) with its rows, the first model with the same roller motion.

    Two such models differ only in additions to the motion and to the readings.
    """
    numbers = floats(models).copy()
    numbers[:, _LAW.stop:][:, ~_MOVES] = 0.0
    first: dict[tuple[bytes, Rows], int] = {}
    keys = [(number.tobytes(), row) for number, row in zip(numbers, rows, strict=True)]
    return np.array([first.setdefault(key, index) for index, key in enumerate(keys)])


def stack_rows(rows: Sequence[Rows]) -> tuple[Floats, NDArray[np.bool_]]:
    """Rows of a batch, flat: (R, 9 J) and uniform (R, 3); R = 1 if all are equal."""
    if all(row is rows[0] for row in rows):
        return rows[0].flat[None], rows[0].uniform[None]
    arrays = np.zeros((len(rows), 3, 3, max(row.flat.size for row in rows) // 9))
    arrays[:, :, 2] = FAR_OFF
    for place, row in zip(arrays, rows, strict=True):
        place[:, :, :row.flat.size // 9] = row.flat.reshape(3, 3, -1)
    return arrays.reshape(len(rows), -1), np.array([row.uniform for row in rows])
