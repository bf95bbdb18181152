"""Samples, aligned rows and ring displacements in batches: what the computations take and give."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from saddlering_ros.rig import CHANNELS

Stamps = NDArray[np.int64]
Floats = NDArray[np.float64]
Bits = NDArray[np.uint8]
Rows = NDArray[np.intp] | NDArray[np.bool_] | slice
"""Rows of a batch: indices, a mask, or a slice."""

SECOND = 1_000_000_000

NOT_KNOWN = dict(zip(CHANNELS, (1, 2, 4, 8), strict=True))
"""Bits of unknown channels in `validity`, as in RingDisplacement.msg."""

_BITS = np.array(list(NOT_KNOWN.values()), np.uint8)

BRIDGED = 16
"""Bit of a result that was interpolated across a reading that was refused."""

DOUBTFUL_LOAD = 32
"""Bit of a simulation by a load that came there in a step that the hydraulics cannot make."""

ANY_TIME = (0, 0)
"""In place of the first and last stamp of a recording: none is known."""


def unknown(channels: Floats) -> Bits:
    """Bits (N,) for the channels (4, N) that are NaN."""
    is_unknown = np.isnan(channels)
    if not np.count_nonzero(is_unknown):
        return np.zeros(channels.shape[1], np.uint8)
    marks: Bits = (is_unknown * _BITS[:, None]).sum(axis=0, dtype=np.uint8)
    return marks


def is_published(validity: Bits) -> NDArray[np.bool_]:
    """Mask (N,) of rows with any of delta_x, delta_y and gamma; the others are not published."""
    nothing = NOT_KNOWN['delta_x'] | NOT_KNOWN['delta_y'] | NOT_KNOWN['gamma']
    return np.asarray(validity & nothing != nothing)


def is_pause(recording: tuple[int, int], before: int, after: int) -> bool:
    """Whether two stamps [ns] lie in one recording: the time between them is a pause of a test.

    recording: first and last stamp [ns], or ANY_TIME.
    """
    return recording[0] <= before and after <= recording[1]


@dataclass(frozen=True)
class Samples:
    """Readings of one topic: stamps (N,) [ns], values (N,), the ends of its range (or NaN)."""

    stamps: Stamps
    values: Floats
    low: float = float('nan')
    high: float = float('nan')

    def __len__(self) -> int:
        return len(self.stamps)

    def pick(self, rows: Rows) -> Samples:
        """The samples of some rows."""
        return Samples(self.stamps[rows], self.values[rows], self.low, self.high)


def no_samples() -> Samples:
    """An empty batch of samples."""
    return Samples(np.empty(0, np.int64), np.empty(0))


@dataclass(frozen=True)
class AlignedRows:
    """Load samples in order of their stamps, with the readings of the C probes there.

    stamps (N,) [ns]; time (N,) [s] since the first load stamp (after the last restart); loads
    (N,) [N]; gaps (C, N) [m], NaN where a probe has no reading; given (N,): where every probe
    reads or does not work, so that the row serves for a zero; published (N,): also those during
    a shorter silence of a probe, which are published once there is a zero; restart: how often
    the load's stamps had jumped back before these rows.
    """

    stamps: Stamps
    time: Floats
    loads: Floats
    gaps: Floats
    given: NDArray[np.bool_]
    published: NDArray[np.bool_]
    restart: int

    def __len__(self) -> int:
        return len(self.stamps)

    def pick(self, rows: Rows) -> AlignedRows:
        """Some of the rows."""
        return AlignedRows(self.stamps[rows], self.time[rows], self.loads[rows],
                           self.gaps[:, rows], self.given[rows], self.published[rows],
                           self.restart)

    @staticmethod
    def join(batches: Sequence[AlignedRows]) -> AlignedRows:
        """Several batches of one test as one."""
        if len(batches) == 1:
            return batches[0]
        return AlignedRows(**_joined(batches), restart=batches[-1].restart)


@dataclass(frozen=True)
class Displacements:
    """A batch of ring displacements.

    stamps (N,) [ns]; channels (4, N): delta_x, delta_y [m], gamma [rad], parity [m], NaN where not
    known; zero_stamps (N,) [ns] and zero_loads (N,) [N]: the zero they count from; elevations (N,)
    [rad], NaN where not known (also if not given); validity (N,): 0, or a sum of the constants of
    RingDisplacement.msg; zero_durations (N,) [s]: how long the zero's samples took.
    """

    stamps: Stamps
    channels: Floats
    zero_stamps: Stamps
    zero_loads: Floats
    elevations: Floats = field(default_factory=lambda: np.empty(0))
    validity: Bits = field(default_factory=lambda: np.empty(0, np.uint8))
    zero_durations: Floats = field(default_factory=lambda: np.empty(0))

    def __post_init__(self) -> None:
        count = len(self.stamps)
        if len(self.elevations) != count:
            object.__setattr__(self, 'elevations', np.full(count, np.nan))
        if len(self.validity) != count:
            object.__setattr__(self, 'validity', np.zeros(count, np.uint8))
        if len(self.zero_durations) != count:
            object.__setattr__(self, 'zero_durations', np.zeros(count))

    def __len__(self) -> int:
        return len(self.stamps)


def no_displacements() -> Displacements:
    """An empty batch of displacements."""
    return Displacements(np.empty(0, np.int64), np.empty((4, 0)), np.empty(0, np.int64),
                         np.empty(0))


def join(batches: Sequence[Displacements]) -> Displacements:
    """Several batches as one."""
    if len(batches) == 1:
        return batches[0]
    if not batches:
        return no_displacements()
    return Displacements(**_joined(batches))


def _joined(batches: Sequence[AlignedRows] | Sequence[Displacements]) -> dict[str, Any]:
    """The arrays (..., N) of batches of one kind by name, one behind the other."""
    arrays = [name for name, value in vars(batches[0]).items() if isinstance(value, np.ndarray)]
    return {name: np.concatenate([getattr(batch, name) for batch in batches], axis=-1)
            for name in arrays}


def pick(batch: Displacements, rows: Rows) -> Displacements:
    """The given rows of a batch."""
    return Displacements(batch.stamps[rows], batch.channels[:, rows], batch.zero_stamps[rows],
                         batch.zero_loads[rows], batch.elevations[rows], batch.validity[rows],
                         batch.zero_durations[rows])


def in_order(batch: Displacements) -> Displacements:
    """The same rows by stamp."""
    return pick(batch, np.argsort(batch.stamps, kind='stable'))
