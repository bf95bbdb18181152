"""Conversion of dataclasses to arrays of the kernels: rig, contact law, extension, rollers."""

from collections.abc import Sequence
from dataclasses import dataclass, fields
from functools import lru_cache
from operator import attrgetter
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from saddlering_ros.effects import own_parameters
from saddlering_ros.effects.extension import (
    Hysteron,
    NO_EXTENSION,
    READING,
    RingExtension,
    RowGeometry,
    shared_parameters,
)
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

    arrays (3, 3, J): per row its cosines (falling), weights (number of rollers at this cosine
    times the share of the force that they carry) and gaps [m]; uniform (3,): whether all gaps of
    a row are equal. Equal rows are one object (`rows_of` keeps them), and are compared as such.
    """

    arrays: Floats
    uniform: NDArray[np.bool_]
    counts: tuple[int, int, int]

    @property
    def flat(self) -> Floats:
        """A flat copy of `arrays` for the kernels, shape (9 J,)."""
        return np.array(self.arrays.reshape(-1), dtype=np.float64)


def roller_angles(row: RollerRow) -> Floats:
    """phi_i = 2 pi i / N, shape (N,), from the rear (x > 0)."""
    return np.arange(row.rollers, dtype=np.float64) * (2.0 * np.pi / row.rollers)


def mixed(count: int) -> Floats:
    """Numbers (N,) spread evenly between -1 and 1, in an order in which neighbours differ widely.

    Fractional parts of multiples of the golden ratio (H. Weyl, Math. Ann. 77 (1916) 313).
    """
    golden = 0.5 * (np.sqrt(5.0) - 1.0)
    return np.asarray(2.0 * np.modf((np.arange(count) + 0.5) * golden)[0] - 1.0)


def _row(row: RollerRow, geometry: RowGeometry) -> tuple[Floats, Floats, Floats, bool]:
    angle = roller_angles(row)
    half_gap = 0.5 * row.clearance + geometry.gap
    if geometry.wear.is_none and geometry.oval_amplitude == geometry.gap_spread == 0.0:
        index = np.arange(row.rollers // 2 + 1)
        twins = np.where((index == 0) | (2 * index == row.rollers), 1.0, 2.0)
        return np.cos(angle[index]), twins, np.full(index.size, half_gap), True
    wear = geometry.wear.profile(angle)
    weight = 1.0 - geometry.wear.loss * wear
    gap = (half_gap + geometry.wear.gap * wear
           + geometry.gap_spread * mixed(row.rollers)
           + geometry.oval_amplitude * np.cos(2.0 * (angle - geometry.oval_angle)))
    cosine = np.cos(angle)
    order = np.argsort(-cosine, kind='stable')
    return cosine[order], weight[order], gap[order], False


def _padded(rows: Sequence[Floats]) -> Floats:
    """Rows (3, J_i) in one array (3, 3, J); unused places have a large gap and carry no load.

    The kernels compute up to the next multiple of VECTOR rollers, and J leaves room for them.
    """
    longest = max(row.shape[1] for row in rows)
    arrays = np.zeros((len(rows), 3, (longest // VECTOR + 2) * VECTOR))
    arrays[:, 2] = FAR_OFF
    for place, row in zip(arrays, rows, strict=True):
        place[:, :row.shape[1]] = row
    return arrays


@lru_cache(maxsize=512)
def _rows_cached(axial: RollerRow, radial: RollerRow, upper: RowGeometry, lower: RowGeometry,
                 centre: RowGeometry) -> Rows:
    parts = [_row(axial, upper), _row(axial, lower), _row(radial, centre)]
    arrays = _padded([np.stack(part[:3]) for part in parts])
    arrays.flags.writeable = False
    uniform = np.array([part[3] for part in parts])
    counts = (parts[0][0].size, parts[1][0].size, parts[2][0].size)
    if counts[0] == counts[1]:
        return Rows(arrays, uniform, counts)
    # The kernels have one number for both axial rows: split the twins of the merged row again.
    wide = [_spread(axial, geometry) for geometry in (upper, lower)]
    return Rows(_padded([*wide, arrays[2]]), np.array([False, False, uniform[2]]),
                (axial.rollers, axial.rollers, counts[2]))


def rows_of(rig: Rig, extension: RingExtension = NO_EXTENSION) -> Rows:
    """The three rows of a rig under an extension (cached)."""
    return _of_extension(extension).rows(rig)


def spread_rows(rig: Rig, extension: RingExtension) -> Rows:
    """The three rows with a place for every roller, also for equal mirror twins."""
    axial, radial = rig.axial_rows, rig.radial_row
    parts = [_spread(axial, extension.upper_row), _spread(axial, extension.lower_row),
             _spread(radial, extension.radial_row)]
    return Rows(_padded(parts), np.zeros(3, dtype=bool),
                (axial.rollers, axial.rollers, radial.rollers))


def _spread(row: RollerRow, geometry: RowGeometry) -> Floats:
    cosine, weight, gap, merged = _row(row, geometry)
    if not merged:
        return np.stack([cosine, weight, gap])
    full = np.cos(roller_angles(row))
    full = full[np.argsort(-full, kind='stable')]
    return np.stack([full, np.ones(row.rollers), np.full(row.rollers, gap[0])])


def _field(name: str, neutral: Any) -> list[tuple[Any, ...]]:
    """Fields of the model's record for one extension parameter, by its neutral value."""
    if isinstance(neutral, RowGeometry):
        return [(f'{name}_stiffness', 'f8')]  # gaps and wear are in `Rows`
    if isinstance(neutral, Hysteron):
        return [(name, [(part.name, 'f8') for part in fields(Hysteron)])]
    if isinstance(neutral, tuple):
        return [(name, 'f8', (len(neutral),))]
    return [(name, 'f8')]


RIG_FIELDS = (
    'radius', 'radial_row_height', 'axial_rollers', 'radial_rollers', 'axial_clearance',
    'radial_clearance', 'mass', 'inertia', 'weight', 'weight_x', 'trunnion_x', 'trunnion_y',
    'elevation', 'full_scale', 'cosine', 'sine', 'axial_span', 'probe_plane_height')
"""Constants of rig and elevation; cosine and sine of the elevation without bracket play."""

EXTENSION_FIELDS = [
    (part, item.metadata['stage'], item.metadata['acts_on'])
    for item in shared_parameters()
    for part in _field(item.name, getattr(NO_EXTENSION, item.name))
] + [((item.name, 'f8'), item.stage, item.acts_on) for item in own_parameters()]
"""Fields of the model's record for extension parameters, with their stage and target."""

MODEL = np.dtype([
    *((name, 'f8') for name in (*RIG_FIELDS, *PARAMETER_NAMES)),
    *(part for part, _, _ in EXTENSION_FIELDS)])
"""The record of the kernels, read by name: rig, contact law, every extension parameter.

All fields are floats, so that a record is also a row of floats.
"""

_shared_values = attrgetter(*(item.name for item in shared_parameters()))


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
    own = dict(extension.own)
    return numbers + [own.get(item, 0.0) for item in own_parameters()]


class _OfExtension:
    """Parts of a model that depend on the extension: its numbers, and rows of the last rig."""

    def __init__(self, extension: RingExtension) -> None:
        self.numbers = _numbers(extension)
        self._geometry = extension.upper_row, extension.lower_row, extension.radial_row
        self._rows: tuple[Rig, Rows] | None = None
        self._record: tuple[Rig, Floats] | None = None
        self._at: tuple[Rig, float, Model] | None = None

    def at(self, rig: Rig, elevation: float) -> Model:
        """The record of a model, an array of one, at an elevation; not to be written to."""
        known = self._at
        if known is None or known[0] is not rig or known[1] != elevation:
            model = at_elevation(self.record(rig).view(MODEL), elevation)
            model.flags.writeable = False
            known = self._at = rig, elevation, model
        return known[2]

    def record(self, rig: Rig) -> Floats:
        """Numbers (M,) of the record of a model, without contact law and elevation."""
        if self._record is None or self._record[0] is not rig:
            axial, radial, carriage = rig.axial_rows, rig.radial_row, rig.carriage
            counts = self.rows(rig).counts
            of_rig = [axial.pitch_radius, radial.height, counts[0], counts[2], axial.clearance,
                      radial.clearance, carriage.mass, carriage.inertia, carriage.weight,
                      carriage.weight_x, rig.trunnion.x, rig.trunnion.y, 0.0,
                      rig.full_scale_load, 0.0, 0.0, rig.probes.axial_span,
                      rig.probes.radial_height]
            no_law = [0.0] * len(PARAMETER_NAMES)
            self._record = rig, np.array([*of_rig, *no_law, *self.numbers], dtype=np.float64)
        return self._record[1]

    def rows(self, rig: Rig) -> Rows:
        """The three rows of a rig."""
        if self._rows is None or self._rows[0] is not rig:
            self._rows = rig, _rows_cached(rig.axial_rows, rig.radial_row, *self._geometry)
        return self._rows[1]


def _of_extension(extension: RingExtension) -> _OfExtension:
    """Cached with the extension, because a fit simulates it for every run and neighbour."""
    known: _OfExtension | None = vars(extension).get('_of_model')
    if known is None:
        known = _OfExtension(extension)
        object.__setattr__(extension, '_of_model', known)
    return known


def model_of(rig: Rig, elevation: float, extension: RingExtension = NO_EXTENSION) -> Model:
    """The record of a model, an array of one, without the contact law (see `with_contact`).

    It is kept and cannot be written to.
    """
    return _of_extension(extension).at(rig, elevation)


def at_elevation(models: Model, elevation: float) -> Model:
    """Copies (B,) of records with the elevation [rad] of a run put in."""
    at_run = models.copy()
    at_ring = elevation + at_run['elevation_error']
    at_run['elevation'] = elevation
    at_run['cosine'], at_run['sine'] = np.cos(at_ring), np.sin(at_ring)
    return at_run


def with_contact(model: Model, contacts: ArrayLike) -> Model:
    """Copies (B,) of the record of a model, each with a contact law of `contacts` (B, 6)."""
    laws = np.atleast_2d(np.asarray(contacts, dtype=np.float64))
    batch = np.repeat(model.view(np.float64)[None], laws.shape[0], axis=0)
    first = len(RIG_FIELDS)
    batch[:, first:first + laws.shape[1]] = laws
    return batch.view(MODEL)[:, 0]


def model_rows(rig: Rig, contacts: Floats, extensions: Sequence[RingExtension]) -> Model:
    """Records (B,) of contact laws (B, 6), each with its extension, without an elevation."""
    rows: list[Floats] = []
    last = None
    for extension in extensions:
        # Neighbours in the contact law share one extension and follow each other.
        if extension is not last:
            own = _of_extension(extension).record(rig)
            last = extension
        rows.append(own)
    numbers = np.array(rows)
    first = len(RIG_FIELDS)
    numbers[:, first:first + contacts.shape[1]] = contacts
    return numbers.view(MODEL)[:, 0]


_MOVES = np.array([
    acts_on != READING
    for part, _, acts_on in EXTENSION_FIELDS
    for _ in range(np.dtype([part]).itemsize // 8)])
_NEUTRAL = np.array(_numbers(NO_EXTENSION), dtype=np.float64)


def floats(models: Model) -> Floats:
    """Records (B,) as rows of numbers (B, M)."""
    return models.view(np.float64).reshape(models.size, MODEL.itemsize // 8)


def read_motion_only(models: Model) -> NDArray[np.bool_]:
    """Mask (B,) of the models without additions to the motion and to the readings."""
    added = floats(models)[:, len(RIG_FIELDS) + len(PARAMETER_NAMES):][:, ~_MOVES]
    return np.asarray((added == _NEUTRAL[~_MOVES]).all(axis=1))


def same_motions(models: Model, rows: Sequence[Rows]) -> NDArray[np.intp]:
    """For each of the models (B,) with its rows, the first model with the same roller motion.

    Two such models differ only in additions to the motion and to the readings.
    """
    numbers = floats(models).copy()
    own = numbers[:, len(RIG_FIELDS) + len(PARAMETER_NAMES):]
    own[:, ~_MOVES] = 0.0
    first: dict[tuple[bytes, Rows], int] = {}
    keys = [(number.tobytes(), row) for number, row in zip(numbers, rows, strict=True)]
    return np.array([first.setdefault(key, index) for index, key in enumerate(keys)])


def stack_rows(rows: Sequence[Rows]) -> tuple[Floats, NDArray[np.bool_]]:
    """Rows of a batch, flat: (R, 9 J) and uniform (R, 3); R = 1 if all are equal."""
    if all(row is rows[0] for row in rows):
        return rows[0].flat[None], rows[0].uniform[None]
    longest = max(row.arrays.shape[2] for row in rows)
    arrays = np.zeros((len(rows), 3, 3, longest))
    arrays[:, :, 2] = FAR_OFF
    for place, row in zip(arrays, rows, strict=True):
        place[:, :, :row.arrays.shape[2]] = row.arrays
    return arrays.reshape(len(rows), -1), np.array([row.uniform for row in rows])
