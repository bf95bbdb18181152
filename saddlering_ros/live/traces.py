"""What a screen shows of the topics: streams as a few hundred points, and the newest readings.

Time is cut into cells, all streams alike. Of each cell the mean and the extremes are kept, so that
not one sample that stands out is lost. As time goes on, neighbouring cells become one; what is
older than the window is dropped. Memory and work per sample do not grow. The curves of earlier
tests are kept as they were.
"""

from collections import deque
from collections.abc import Mapping
from dataclasses import dataclass, fields
import math
import time
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from saddlering_ros.record.batches import Floats, SECOND, Stamps
from saddlering_ros.rig import TONNE

FIRST_CELL = 10_000_000
"""Width of a cell at the start [ns]."""

BACKWARDS = SECOND // 4
"""A stamp that is further back than this [ns] is another replay, not a late sample."""

APART = 30 * SECOND
"""A stamp that is further ahead than this [ns] of all others begins another test."""

MAX_PAST = 30
"""Earlier tests whose curves are kept: a third of a megabyte each."""

LEFTOVERS = 1.0
"""Time after a jump in which other streams may still carry earlier samples [s]."""


@dataclass
class Cells:
    """Cells of one stream, in order: number (N,); count, total, low, high (C, N).

    count: known samples of each channel; changed (N,): the turn in which the cell changed last.
    """

    number: Stamps
    count: Stamps
    total: Floats
    low: Floats
    high: Floats
    changed: Stamps

    @classmethod
    def of(cls, number: Stamps, values: Floats, turn: int) -> 'Cells':
        """A cell of that number for each of N samples (C, N), NaN where not known."""
        is_known = np.isfinite(values)
        return cls(number, is_known.astype(np.int64), np.where(is_known, values, 0.0),
                   np.where(is_known, values, np.inf), np.where(is_known, values, -np.inf),
                   np.full(len(number), turn, np.int64))

    def __len__(self) -> int:
        return len(self.number)

    def pick(self, rows: NDArray[Any]) -> 'Cells':
        return Cells(self.number[rows], self.count[:, rows], self.total[:, rows],
                     self.low[:, rows], self.high[:, rows], self.changed[rows])

    def means(self) -> Floats:
        """Means (C, N) of the cells; NaN where not known."""
        return np.where(self.count > 0, self.total / np.maximum(self.count, 1), np.nan)


def merged(*several: Cells) -> Cells:
    """All these cells; those of the same number become one."""
    joined = Cells(*(np.concatenate([getattr(cells, field.name) for cells in several], axis=-1)
                     for field in fields(Cells)))
    joined = joined.pick(np.argsort(joined.number, kind='stable'))
    if not len(joined):
        return joined
    first = np.flatnonzero(np.diff(joined.number, prepend=joined.number[0] - 1))
    return Cells(
        joined.number[first], np.add.reduceat(joined.count, first, axis=1),
        np.add.reduceat(joined.total, first, axis=1),
        np.minimum.reduceat(joined.low, first, axis=1),
        np.maximum.reduceat(joined.high, first, axis=1),
        np.maximum.reduceat(joined.changed, first))


@dataclass(frozen=True)
class CurvesOfTest:
    """The curves of one test, and its peaks (C, 2), lowest and highest, by stream.

    number: counted from 1; origin, newest [ns]: first and last stamp; width of a cell [ns].
    """

    number: int
    origin: int
    newest: int
    width: int
    cells: Mapping[str, Cells]
    peaks: Mapping[str, Floats]

    def since(self, turn: int, scales: Mapping[str, float]) -> dict[str, dict[str, Any]]:
        """Changes after `turn`: by stream the cells' numbers, and means and extremes scaled.

        Four digits; None stands for an unknown value. scales: by stream, the factor of its values.
        """
        streams: dict[str, dict[str, Any]] = {}
        for name, cells in self.cells.items():
            new = cells.pick(cells.changed > turn)
            if len(new):
                rows = {'mean': new.means(), 'low': new.low, 'high': new.high}
                streams[name] = {'cell': new.number.tolist()} | {
                    kind: [[value if math.isfinite(value) else None for value in channel]
                           for channel in np.round(scales[name] * values, 4).tolist()]
                    for kind, values in rows.items()}
        return streams


class Traces:
    """All streams of the page on one grid of time cells.

    channels: how many each stream has, by name; limit: cells per stream at most; window: the
    longest time kept [s]. `version` changes whenever data sent before are void. The streams show
    one test: stamps that jump back, or by more than APART ahead, begin the next one. `received`
    counts the samples of the test by stream, `left_out` those of all that are not drawn.
    """

    def __init__(self, channels: Mapping[str, int], limit: int = 1200,
                 window: float = 600.0) -> None:
        self._channels, self._limit = dict(channels), limit
        self._window = int(window * SECOND)
        self.number = 1
        self.version = self.turn = self.left_out = self._start = 0
        self.past: deque[CurvesOfTest] = deque(maxlen=MAX_PAST)
        self._leftovers_until = 0.0
        self._forget()

    def clear(self) -> None:
        """Begin anew; what was drawn is kept as an earlier test."""
        if self.current is not None:
            self.past.append(self.current)
            self.number += 1
        self._forget()

    def _forget(self) -> None:
        self.version += 1
        self.origin: int | None = None
        self.newest = 0
        self.width = FIRST_CELL
        self.received = dict.fromkeys(self._channels, 0)
        self._last: dict[str, int] = {}
        self._ended: dict[str, int] = {}
        self._cells = {name: Cells.of(np.empty(0, np.int64), np.empty((count, 0)), 0)
                       for name, count in self._channels.items()}
        self._peaks = {name: np.full((count, 2), np.nan) for name, count in self._channels.items()}

    @property
    def current(self) -> CurvesOfTest | None:
        """The test that is shown; None before its first sample."""
        if self.origin is None:
            return None
        return CurvesOfTest(self.number, self.origin, self.newest, self.width, self._cells,
                          self._peaks)

    def push(self, name: str, stamps: Stamps, values: Floats) -> None:
        """Take samples: stamps (N,) [ns], values (C, N), NaN in channels that are not known."""
        step = np.diff(stamps)
        jumps = np.flatnonzero((step < -BACKWARDS) | (step > APART)) + 1
        for rows in np.split(np.arange(len(stamps)), jumps):
            if len(rows):
                self._push(name, stamps[rows], values[:, rows])

    def begin(self, start: int, end: int) -> None:
        """A test from start to end [ns] is announced: what is drawn of another one goes."""
        if self.origin is not None and not start - SECOND <= self.origin <= end:
            self._begin_anew(start)

    def _push(self, name: str, stamps: Stamps, values: Floats) -> None:
        """Take samples of one test."""
        if self._is_leftover(name, int(stamps.min())):
            self.left_out += len(stamps)
            return
        self.received[name] += len(stamps)
        self._last[name] = int(stamps.max())
        good = np.isfinite(values).any(axis=0)
        self.left_out += int(np.count_nonzero(~good))
        stamps, values = stamps[good], values[:, good]
        if not len(stamps):
            return
        if self.origin is None:
            self.origin = int(stamps.min())
        self.newest = max(self.newest, int(stamps.max()))
        while (min(self.newest - self.origin, self._window) // self.width) >= self._limit:
            self.width *= 2
            self.version += 1
            for cells in self._cells.values():
                cells.number //= 2
            self._cells = {name: merged(cells) for name, cells in self._cells.items()}
        oldest = (self.newest - self.origin - self._window) // self.width
        first = min((int(cells.number[0]) for cells in self._cells.values() if len(cells)),
                    default=0)
        if oldest > self._limit // 8 + first:
            self.version += 1
            self._cells = {name: cells.pick(cells.number >= oldest)
                           for name, cells in self._cells.items()}
        self.turn += 1
        peaks = np.column_stack([self._peaks[name], values])
        self._peaks[name] = np.column_stack(
            [np.fmin.reduce(peaks, axis=1), np.fmax.reduce(peaks, axis=1)])
        number = (stamps - self.origin) // self.width
        self._cells[name] = merged(self._cells[name], Cells.of(number, values, self.turn))

    def _is_leftover(self, name: str, started: int) -> bool:
        """Whether samples from that stamp on belong to the test before; begins a new one if due.

        Streams are drained one after another: when one has jumped, the others may still hold the
        end of what was before, which is left out for LEFTOVERS.
        """
        ended = self._ended.pop(name, self._start)
        is_old = (started >= ended - BACKWARDS if ended > self._start
                  else ended < self._start and started < self._start - BACKWARDS)
        if is_old and time.monotonic() <= self._leftovers_until:
            self._ended[name] = ended
            return True
        last = self._last.get(name)
        if (last is not None and started < last - BACKWARDS) or (
                self.origin is not None and started > self.newest + APART):
            self._begin_anew(started, name)
        return False

    def _begin_anew(self, start: int, first: str = '') -> None:
        """Begin the test that starts at that stamp; of it the stream `first` has come."""
        ended = {name: stamp for name, stamp in self._last.items() if name != first}
        self.clear()
        self._start, self._ended = start, ended
        self._leftovers_until = time.monotonic() + LEFTOVERS

    def means(self, name: str) -> Floats:
        """Means (C, N) of the drawn cells of a stream; NaN where not known."""
        return self._cells[name].means()


FRESH = 2.0
"""A reading is current for so long [s]; after that it is shown as the last one."""

NARROW, ENDED = 0.10, 0.01
"""Shares of a probe's span: a margin below NARROW is a warning, one below ENDED an error."""


class Reading(NamedTuple):
    """A value in SI units, its sensor's range (NaN: not stated), when it came [s, monotonic]."""

    value: float
    low: float
    high: float
    at: float

    @property
    def is_old(self) -> bool:
        return time.monotonic() - self.at > FRESH


class Gauges:
    """The newest reading of every sensor by name; from any thread that holds the page's lock."""

    def __init__(self) -> None:
        self._readings: dict[str, Reading] = {}

    def push(self, name: str, value: float, low: float = math.nan, high: float = math.nan) -> None:
        """Take a reading: 'load' [N], 'elevation' [rad], 'probe_1' to 'probe_4' [m]."""
        self._readings[name] = Reading(value, low, high, time.monotonic())

    def as_page(self, assumed_elevation: float | None = None, absent: int = 0) -> dict[str, Any]:
        """Load in t and kN, elevation in degrees, gaps in mm with margin; None where none came.

        Each holds `is_old`: it is the last one of a test that has ended. assumed_elevation
        [degrees]: the value of the simulator, if the rig measures none; absent: the number of the
        probe that the rig does not have.
        """
        shown: dict[str, Any] = {'load': None, 'elevation': None, 'probes': [
            {'is_absent': True} if number == absent
            else _probe(self._known(f'probe_{number}')) for number in (1, 2, 3, 4)]}
        if (load := self._known('load')) is not None:
            shown['load'] = {'t': round(load.value / TONNE, 3), 'kN': round(load.value / 1e3, 2),
                             'is_old': load.is_old}
        if (elevation := self._known('elevation')) is not None:
            shown['elevation'] = {'deg': round(math.degrees(elevation.value), 2),
                                  'is_measured': True, 'is_old': elevation.is_old}
        elif assumed_elevation is not None:
            shown['elevation'] = {'deg': assumed_elevation, 'is_measured': False, 'is_old': False}
        return shown

    def _known(self, name: str) -> Reading | None:
        """The newest reading; None for one that is no number, which JSON does not have."""
        reading = self._readings.get(name)
        return reading if reading is not None and math.isfinite(reading.value) else None


def _probe(reading: Reading | None) -> dict[str, Any] | None:
    """Gap and span in mm, the margin to the nearer end, and its judgement."""
    if reading is None:
        return None
    gap, low, high = reading.value, reading.low, reading.high
    shown = {'gap': round(1e3 * gap, 4), 'low': None, 'high': None, 'margin': None, 'level': 'ok',
             'is_old': reading.is_old}
    if high > low:
        margin = min(gap - low, high - gap)
        share = margin / (high - low)
        shown |= {
            'low': round(1e3 * low, 4), 'high': round(1e3 * high, 4),
            'margin': round(1e3 * margin, 4),
            'level': 'ok' if share >= NARROW else 'warning' if share >= ENDED else 'error'}
    return shown
