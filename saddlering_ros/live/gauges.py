"""Numbers of the page: the load, the elevation and the raw gaps at the present time."""

from dataclasses import dataclass
import math
import time
from typing import Any

from saddlering_ros.rig import TONNE

FRESH = 2.0
"""A reading is current for so long [s]; after that it is shown as the last one."""

NARROW, ENDED = 0.10, 0.01
"""Shares of a probe's span: a margin below NARROW is a warning, one below ENDED an error."""


@dataclass(frozen=True)
class GaugeReading:
    """A value in SI units, its sensor's range (NaN: not stated), when it came [s, monotonic]."""

    value: float
    low: float
    high: float
    at: float

    @property
    def is_old(self) -> bool:
        """Whether it is no longer current."""
        return time.monotonic() - self.at > FRESH


class Gauges:
    """The newest reading of every sensor by name; from any thread that holds the page's lock."""

    def __init__(self) -> None:
        self._readings: dict[str, GaugeReading] = {}

    def push(self, name: str, value: float, low: float = math.nan, high: float = math.nan) -> None:
        """Take a reading: 'load' [N], 'elevation' [rad], 'probe_1' to 'probe_4' [m]."""
        self._readings[name] = GaugeReading(value, low, high, time.monotonic())

    def as_page(self, assumed_elevation: float | None = None, absent: int = 0) -> dict[str, Any]:
        """Load in t and kN, elevation in degrees, gaps in mm with margin; None where none came.

        Each holds `is_old`: it is the last one of a test that has ended. assumed_elevation
        [degrees]: the value of the simulator, if the rig measures none; absent: the number of the
        probe that the rig does not have.
        """
        load, elevation = self._readings.get('load'), self._readings.get('elevation')
        return {
            'load': None if load is None else {
                't': round(load.value / TONNE, 3), 'kN': round(load.value / 1e3, 2),
                'is_old': load.is_old},
            'elevation': {'deg': round(math.degrees(elevation.value), 2), 'is_measured': True,
                          'is_old': elevation.is_old}
            if elevation is not None else None if assumed_elevation is None
            else {'deg': assumed_elevation, 'is_measured': False, 'is_old': False},
            'probes': [{'is_absent': True} if number == absent
                       else _probe(self._readings.get(f'probe_{number}'))
                       for number in (1, 2, 3, 4)]}


def _probe(found: GaugeReading | None) -> dict[str, Any] | None:
    """Gap and span in mm, the margin to the nearer end, and its judgement."""
    if found is None or not math.isfinite(found.value):
        return None
    shown = {'gap': _mm(found.value), 'low': None, 'high': None, 'margin': None, 'level': 'ok',
             'is_old': found.is_old}
    span = found.high - found.low
    if not span > 0.0:
        return shown
    margin = min(found.value - found.low, found.high - found.value)
    level = 'ok' if margin >= NARROW * span else 'warning' if margin >= ENDED * span else 'error'
    return {**shown, 'low': _mm(found.low), 'high': _mm(found.high), 'margin': _mm(margin),
            'level': level}


def _mm(value: float) -> float:
    return round(1e3 * value, 4)
