"""The zero of a test: mean readings over the first steady stretch of the record near preload."""

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from saddlering_ros.rig.description import Rig

WINDOW_SECONDS = 0.5
"""Longest zero window [s]: long enough to average white noise, shorter than any hold."""

STEADY_SHARE = 0.01
"""The window ends when the load leaves its start by this share of full scale."""

MIN_WINDOW_SECONDS = 0.1
"""A window over less time than this [s] is no zero: a load on its way through the preload, to 25 t
in a few seconds, stays in the band for tens of milliseconds. It must be below WINDOW_SECONDS, at
which every window ends."""

NEAR_PRELOAD_SHARE = 0.04
"""A load within preload plus this share of full scale (1 t) counts as preload."""

MIN_SAMPLES = 5
"""A steady stretch with fewer samples is none."""

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
    Too few samples, or samples over too short a time (the load was passing, or the stream began or
    broke off there), are no rest: the window opens anew.
    The sample that closes the window is not part of it. Live nodes and offline commands use this
    same object, so that their zeros are the same to the last bit.
    """

    def __init__(self, rig: Rig, *, anywhere: bool = False) -> None:
        self._steady = STEADY_SHARE * rig.full_scale_load
        self._highest = rig.preload + NEAR_PRELOAD_SHARE * rig.full_scale_load
        self._anywhere = anywhere
        self._count = 0
        self._open()

    def _open(self) -> None:
        self._opened_at = self._newest = 0.0
        self._first_load = 0.0
        self._start = 0
        self._samples = 0
        self._load_sum = 0.0
        self._gap_sums: list[float] = []

    @property
    def samples(self) -> int:
        """How many of the last samples given the open window holds."""
        return self._samples

    def push_batch(self, time: NDArray[np.float64], load: NDArray[np.float64],
                   gaps: NDArray[np.float64]) -> ZeroReading | None:
        """Add a batch of samples (N,), gaps (4 or none, N); those after a reading do not count."""
        if not (self._samples or self._anywhere) and (load > self._highest).all():
            self._count += len(load)
            return None
        for begin in range(0, len(time), CONVERTED):
            part = slice(begin, begin + CONVERTED)
            for sample in zip(time[part].tolist(), load[part].tolist(), gaps[:, part].T.tolist(),
                              strict=True):
                reading = self.push(*sample)
                if reading is not None:
                    return reading
        return None

    def push(self, time: float, load: float, gaps: Sequence[float] = ()) -> ZeroReading | None:
        """Add a sample: time [s], load [N], gaps [m] (none for a node that sees the load only)."""
        index = self._count
        self._count += 1
        is_over = (time - self._opened_at > WINDOW_SECONDS
                   or abs(load - self._first_load) > self._steady)
        if self._samples and is_over:
            if (self._samples >= MIN_SAMPLES
                    and self._newest - self._opened_at >= MIN_WINDOW_SECONDS):
                return self._reading(index)
            self._open()
        if not self._anywhere and load > self._highest:
            return None
        if not self._samples:
            self._opened_at, self._first_load, self._start = time, load, index
            self._gap_sums = [0.0] * len(gaps)
        self._samples += 1
        self._newest = time
        self._load_sum += load
        for i, gap in enumerate(gaps):
            self._gap_sums[i] += gap
        return None

    def _reading(self, end: int) -> ZeroReading:
        load = self._load_sum / self._samples
        return ZeroReading(load, tuple(total / self._samples for total in self._gap_sums),
                           self._start, end, load <= self._highest)


def zero_of_record(rig: Rig, time: NDArray[np.float64], load: NDArray[np.float64],
                   gaps: NDArray[np.float64] | None = None) -> ZeroReading:
    """The zero of a whole record: time (N,) [s], load (N,) [N], gaps (4, N) [m] or None.

    Falls back to the first steady stretch at any load, and then to the first sample, when the
    record has none near preload; `near_preload` tells.
    """
    rows = np.empty((0, len(time))) if gaps is None else np.asarray(gaps, dtype=np.float64)

    def blocks() -> Iterator[Samples]:
        for start in range(0, len(time), BLOCK):
            block = slice(start, start + BLOCK)
            yield time[block], load[block], rows[:, block]

    return zero_of_blocks(rig, blocks)


def zero_of_blocks(rig: Rig, blocks: Callable[[], Iterable[Samples]]) -> ZeroReading:
    """The zero of a record that comes in blocks of samples, as often as they are asked for."""
    for anywhere in (False, True):
        window = ZeroWindow(rig, anywhere=anywhere)
        for time, load, gaps in blocks():
            reading = window.push_batch(time, load, gaps)
            if reading is not None:
                return reading
    time, load, gaps = next(block for block in iter(blocks()) if len(block[0]))
    return ZeroReading(float(load[0]), tuple(gaps[:, 0].tolist()), 0, 1, False)
