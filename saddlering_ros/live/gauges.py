"""Numbers of the page: the load, the elevation and the raw gaps at the present time."""

import math
import time
from typing import Any, NamedTuple

from saddlering_ros.rig import TONNE

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
            else _probe(self._readings.get(f'probe_{number}')) for number in (1, 2, 3, 4)]}
        if (load := self._readings.get('load')) is not None:
            shown['load'] = {'t': round(load.value / TONNE, 3), 'kN': round(load.value / 1e3, 2),
                             'is_old': load.is_old}
        if (elevation := self._readings.get('elevation')) is not None:
            shown['elevation'] = {'deg': round(math.degrees(elevation.value), 2),
                                  'is_measured': True, 'is_old': elevation.is_old}
        elif assumed_elevation is not None:
            shown['elevation'] = {'deg': assumed_elevation, 'is_measured': False, 'is_old': False}
        return shown


def _probe(reading: Reading | None) -> dict[str, Any] | None:
    """Gap and span in mm, the margin to the nearer end, and its judgement."""
    if reading is None or not math.isfinite(reading.value):
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
