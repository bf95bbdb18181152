"""Geometry of a rig: probes and motion of C both ways, their zero, loads at C, frames, sizes.

Frame ids are those of the messages. `ring` is the frame of all displacements: origin C, x to the
rear, y up the ring's axis, z to the left. `rig` has the same origin and the axes of REP 103:
x forward, y to the left, z up. A probe's x axis points along its line of sight, as REP 117 wants
it of sensor_msgs/Range.
"""

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
import math
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from saddlering_ros.rig.description import Probes, Rig
from saddlering_ros.rig.units import FULL_SCALE_LOAD


@dataclass(frozen=True)
class Displacement:
    """Motion of C: delta_x, delta_y [m], gamma [rad], the probes' parity [m]; arrays or floats."""

    delta_x: Any
    delta_y: Any
    gamma: Any
    parity: Any

    @property
    def channels(self) -> NDArray[np.float64]:
        """The same as one array (4, ...)."""
        return np.array([self.delta_x, self.delta_y, self.gamma, self.parity])


CHANNELS: tuple[str, ...] = ('delta_x', 'delta_y', 'gamma', 'parity')
"""Names of the fields of `Displacement`, in the order used everywhere."""

MOTION = CHANNELS[:3]
"""Those of the motion, without the parity, which is 0 for a rigid ring."""


def gap_increment(probes: Probes, gaps: ArrayLike, zero_gaps: ArrayLike) -> NDArray[np.float64]:
    """d_i = polarity_i (gap_i - gap_i at zero); `gaps` (4, ...) and `zero_gaps` (4,) in metres."""
    readings = np.asarray(gaps, dtype=np.float64)
    shape = (4,) + (1,) * (readings.ndim - 1)
    polarity = np.asarray(probes.polarity).reshape(shape)
    zero = np.asarray(zero_gaps, dtype=np.float64).reshape(shape)
    return np.asarray(polarity * (readings - zero))


def probes_to_displacement(probes: Probes, increments: ArrayLike) -> Displacement:
    """Displacement from probe increments d, shape (4, ...) [m].

    delta_x = (d1 - d3)/2 - gamma h_s, delta_y = (d2 + d4)/2, gamma = atan((d2 - d4)/L),
    parity = (d1 + d3)/2. With h_s = 0, the default rig, the first is (d1 - d3)/2.
    """
    first, second, third, fourth = np.asarray(increments, dtype=np.float64)
    gamma = np.arctan((second - fourth) / probes.axial_span)
    # Without a height, delta_x is known even where an axial probe, and so gamma, is not.
    lean = gamma * probes.radial_height if probes.radial_height else 0.0
    return Displacement(
        delta_x=(first - third) / 2.0 - lean, delta_y=(second + fourth) / 2.0, gamma=gamma,
        parity=(first + third) / 2.0)


def mirrored_gap(probes: Probes, gaps: NDArray[np.float64]) -> NDArray[np.float64]:
    """Gaps [m] that the absent radial probe would read at a rigid ring, from those of the other.

    There d3 = -d1. The gap is put within the range of the probes; displacements count from zero.
    """
    here, there = (probes.polarity[number - 1] for number in (probes.absent, probes.partner))
    if here != there:
        return gaps
    return np.asarray(probes.min_range + probes.max_range - gaps)


def with_absent(probes: Probes, increments: NDArray[np.float64]) -> NDArray[np.float64]:
    """Increments (4, N) of all probes from those (C, N) of the probes that the rig has."""
    if not probes.absent:
        return increments
    return np.insert(increments, probes.absent - 1, -increments[probes.partner_row], axis=0)


def measured_displacement(probes: Probes, increments: ArrayLike) -> Displacement:
    """Displacement from measured increments d, shape (4, ...) [m].

    The parity is NaN if a radial probe is absent, as its increment comes from the other.
    """
    displacement = probes_to_displacement(probes, increments)
    if not probes.absent:
        return displacement
    return replace(displacement, parity=np.full_like(np.asarray(displacement.parity), np.nan))


def displacement_to_probes(probes: Probes, displacement: Displacement) -> NDArray[np.float64]:
    """Probe increments d, shape (4, ...) [m], that a displacement causes (the exact inverse)."""
    radial = np.asarray(displacement.delta_x) + displacement.gamma * probes.radial_height
    tilt = np.tan(displacement.gamma) * probes.axial_span / 2.0
    parity = np.asarray(displacement.parity)
    return np.stack([
        parity + radial, displacement.delta_y + tilt, parity - radial, displacement.delta_y - tilt,
    ])


@dataclass(frozen=True)
class ResolvedLoad:
    """The load at C, as (...) arrays; the dead weight is not in it."""

    force_x: NDArray[np.float64]  # [N] to the rear
    force_y: NDArray[np.float64]  # [N] upwards
    moment: NDArray[np.float64]  # [N m] in the sense of gamma


def resolve_load(rig: Rig, load: ArrayLike, elevation: ArrayLike) -> ResolvedLoad:
    """Resolve load P [N] along the barrel axis at `elevation` [rad], applied at the trunnion.

    F_x = P cos(theta), F_y = -P sin(theta), M = P (y_t cos(theta) + x_t sin(theta)).
    """
    magnitude = np.asarray(load, dtype=np.float64)
    cosine, sine = np.cos(elevation), np.sin(elevation)
    arm = rig.trunnion.y * cosine + rig.trunnion.x * sine
    return ResolvedLoad(magnitude * cosine, -magnitude * sine, magnitude * arm)


RIG_FRAME, RING_FRAME, CYLINDER_FRAME = 'rig', 'ring', 'hydraulic_cylinder'


@dataclass(frozen=True)
class Frame:
    """A frame in its parent's axes: translation (x, y, z) [m], quaternion (x, y, z, w)."""

    name: str
    parent: str
    translation: tuple[float, float, float]
    rotation: tuple[float, float, float, float]


def frames_of(rig: Rig, elevation: float | None = None) -> tuple[Frame, ...]:
    """Every frame of `rig`; that of the cylinder only at a known `elevation` [rad].

    The radial probes are drawn at the pitch radius of the radial row and the axial ones at the
    height of C, because the rig file states no such distance.
    """
    half = math.sqrt(0.5)
    # x to the rear, y up, z to the left, in forward, left, up: half a turn about (0, 1, 1).
    ring = Frame(RING_FRAME, RIG_FRAME, (0.0, 0.0, 0.0), (0.0, half, half, 0.0))
    radius, height = rig.radial_row.pitch_radius, rig.probes.radial_height
    lever = rig.probes.axial_span / 2.0
    places = ((radius, height, 0.0), (-lever, 0.0, math.pi / 2), (-radius, height, math.pi),
              (lever, 0.0, math.pi / 2))
    probes = [
        _in_load_plane(f'eddy_current_{number}', x, y, angle if sign > 0 else angle + math.pi)
        for number, (sign, (x, y, angle)) in enumerate(
            zip(rig.probes.polarity, places, strict=True), 1)]
    if elevation is None:
        return (ring, *probes)
    cylinder = _in_load_plane(CYLINDER_FRAME, rig.trunnion.x, rig.trunnion.y, -elevation)
    return (ring, *probes, cylinder)


def displaced_frame(delta_x: float, delta_y: float, gamma: float) -> Frame:
    """The frame of the ring as it stands displaced [m, m, rad]: gamma turns it from y to x."""
    return _in_load_plane('ring_displaced', delta_x, delta_y, -gamma)


def _in_load_plane(name: str, x: float, y: float, angle: float) -> Frame:
    """A frame at (x, y) of the ring, turned by `angle` [rad] from x to y."""
    return Frame(name, RING_FRAME, (x, y, 0.0),
                 (0.0, 0.0, math.sin(angle / 2.0), math.cos(angle / 2.0)))


NOMINAL_RADIUS = 0.6
"""Pitch radius [m] of the nominal rig; its full scale is 25 t."""


def size_factor(unit: str, rig: Rig) -> float:
    """Factor from a size on the nominal rig to that on a rig: forces follow its full scale."""
    load = rig.full_scale_load / FULL_SCALE_LOAD
    moment = load * (rig.axial_rows.pitch_radius / NOMINAL_RADIUS)
    factors = {'N': load, 'N m': moment, 'm/N': 1.0 / load, 'rad/(N m)': 1.0 / moment,
               'm/N^0.5': load**-0.5}
    return factors.get(unit, 1.0)


WINDOW_SECONDS = 0.5
"""Longest zero window [s]: long enough to average white noise, shorter than any hold."""

STEADY_SHARE = 0.01
"""The window ends when the load leaves its start by this share of full scale."""

MIN_WINDOW_SECONDS = 0.1
"""A window over less time than this [s] is no zero: a load on its way through the preload, to 25 t
in a few seconds, stays in the band for tens of milliseconds. It must be below WINDOW_SECONDS, at
which every window ends."""

LEAP_SHARE = 0.05
"""A gap that leaves its start by this share of the probe's span is no rest: the device begins to
read, or somebody touches the probe."""

MAX_LEAPS = 10
"""Windows that are given up for this. Then the probe has no zero, and the others have."""

NEAR_PRELOAD_SHARE = 0.04
"""A load within preload plus this share of full scale (1 t) counts as preload."""

MIN_SAMPLES = 5
"""A steady stretch with fewer samples is none: at 50 Hz, the rate of static tests, five span
MIN_WINDOW_SECONDS."""

BLOCK = 8192
"""Samples of a record looked at together."""

CONVERTED = 512
"""Samples made numbers of Python together: most zeros end within a second."""

Samples = tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]
"""Time (N,) [s], load (N,) [N] and gaps (4 or none, N) [m] of a stretch of a record."""


@dataclass(frozen=True)
class ZeroReading:
    """Readings at zero: load [N], gaps (4,) [m]; rows [start, end) averaged; if near preload."""

    load: float
    gaps: tuple[float, ...]
    start: int
    end: int
    near_preload: bool


class ZeroWindow:
    """Streaming zero: give it every sample in order until it returns a reading.

    The window opens at a sample near preload (or, with `anywhere`, at any), and closes after
    WINDOW_SECONDS, or when the load leaves the window's first load by STEADY_SHARE of full scale.
    A window with too few samples or over too short a time is no rest, and opens anew. So does the
    first whole window after a load above preload, in which the ring settles. The sample that
    closes the window is not part of it. A window in which a gap leaps is none either, and a probe
    that stays at one end of its range, as before its device reads, has no zero (NaN). Live nodes
    and commands use this object, so that their zeros are equal to the last bit.
    """

    def __init__(self, rig: Rig, *, anywhere: bool = False) -> None:
        self._steady = STEADY_SHARE * rig.full_scale_load
        self._highest = rig.preload + NEAR_PRELOAD_SHARE * rig.full_scale_load
        self._low, self._high = rig.probes.min_range, rig.probes.max_range
        self._leap = LEAP_SHARE * (self._high - self._low)
        self._leaps = 0
        self._anywhere = anywhere
        self._settles = False
        self._count = 0
        self._open()

    def _open(self) -> None:
        self._opened_at = self._newest = 0.0
        self._first_load = 0.0
        self._start = 0
        # How many of the last samples given the open window holds.
        self.samples = 0
        self._load_sum = 0.0
        self._first_gaps: list[float] = []
        self._gap_sums: list[float] = []
        self._is_moved: list[bool] = []  # by probe, since the first gap

    def push_batch(self, time: NDArray[np.float64], load: NDArray[np.float64],
                   gaps: NDArray[np.float64]) -> ZeroReading | None:
        """Add a batch of samples (N,), gaps (4 or none, N); those after a reading do not count."""
        for begin in range(0, len(time), CONVERTED):
            rows = slice(begin, begin + CONVERTED)
            if not (self.samples or self._anywhere) and (load[rows] > self._highest).all():
                self._count += len(load[rows])
                self._settles = True
                continue
            for sample in zip(time[rows].tolist(), load[rows].tolist(), gaps[:, rows].T.tolist(),
                              strict=True):
                reading = self.push(*sample)
                if reading is not None:
                    return reading
        return None

    def push(self, time: float, load: float, gaps: Sequence[float] = ()) -> ZeroReading | None:
        """Add a sample: time [s], load [N], gaps [m] (none for a node that sees the load only)."""
        index = self._count
        self._count += 1
        is_whole = time - self._opened_at > WINDOW_SECONDS
        if self.samples and (is_whole or abs(load - self._first_load) > self._steady):
            if self._settles:
                self._settles = not is_whole
            elif (self.samples >= MIN_SAMPLES
                    and self._newest - self._opened_at >= MIN_WINDOW_SECONDS):
                mean = self._load_sum / self.samples
                gaps_at_zero = tuple(
                    total / self.samples if is_moved or self._low < first < self._high
                    else math.nan for total, is_moved, first in zip(
                        self._gap_sums, self._is_moved, self._first_gaps, strict=True))
                return ZeroReading(mean, gaps_at_zero, self._start, index, mean <= self._highest)
            self._open()
        if not self._anywhere and load > self._highest:
            self._settles = True
            return None
        if self._leaps < MAX_LEAPS and any(
                abs(gap - first) > self._leap
                for gap, first in zip(gaps, self._first_gaps, strict=False)):
            self._leaps += 1
            self._open()
        if not self.samples:
            self._opened_at, self._first_load, self._start = time, load, index
            self._first_gaps = list(gaps)
            self._gap_sums, self._is_moved = [0.0] * len(gaps), [False] * len(gaps)
        self.samples += 1
        self._newest = time
        self._load_sum += load
        for i, gap in enumerate(gaps):
            first = self._first_gaps[i]
            self._gap_sums[i] += gap if abs(gap - first) <= self._leap else math.nan
            self._is_moved[i] |= gap != first
        return None


def zero_of_record(rig: Rig, time: NDArray[np.float64], load: NDArray[np.float64]) -> ZeroReading:
    """`zero_of_blocks` of a whole record without probes: time (N,) [s], load (N,) [N]."""
    return zero_of_blocks(rig, lambda: [(time, load, np.empty((0, len(time))))])


def zero_of_blocks(rig: Rig, blocks: Callable[[], Iterable[Samples]]) -> ZeroReading:
    """The zero of a record that comes in blocks of samples, as often as they are asked for.

    A record without a rest near preload has the zero of the first steady stretch at any load, or
    of its first sample; `near_preload` is False then.
    """
    for anywhere in (False, True):
        window = ZeroWindow(rig, anywhere=anywhere)
        for time, load, gaps in blocks():
            reading = window.push_batch(time, load, gaps)
            if reading is not None:
                return reading
    time, load, gaps = next(block for block in iter(blocks()) if len(block[0]))
    return ZeroReading(float(load[0]), tuple(gaps[:, 0].tolist()), 0, 1, False)
