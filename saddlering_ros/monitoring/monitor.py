"""A residual watched sample by sample; live and offline are the same steps, bit for bit."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from saddlering_ros.monitoring.detector import Alarm, Detector, threshold_of
from saddlering_ros.monitoring.errors import MonitoringError
from saddlering_ros.monitoring.innovations import BlockNoise, Whitener

Array = NDArray[np.float64]

CHANNELS = ('delta_x', 'delta_y', 'gamma')
MAX_GAP = 3.0
"""A longer pause between samples, in blocks, ends the block and the memory of the noise."""


@dataclass(frozen=True)
class MonitorSettings:
    """How to watch: block [s], one false alarm in so many hours of testing, materiality (3,).

    materiality: [m, m, rad] what the residual may be without an alarm, for as long as it likes.
    """

    materiality: tuple[float, float, float]
    block: float = 0.02
    false_alarm_hours: float = 1000.0

    def __post_init__(self) -> None:
        if not (self.block > 0.0 and self.false_alarm_hours > 0.0):
            raise MonitoringError('monitoring: block and false_alarm_hours must be above 0')
        if not all(value >= 0.0 for value in self.materiality):
            raise MonitoringError('monitoring: materiality must be 0 or more')


@dataclass(frozen=True)
class Raised:
    """A latched alarm in the units of the channel.

    time, since [s]; size [m or rad]: mean residual since the onset; follows: what the residual
    follows most closely since then (load, rate, direction or none; '' if it is too short to say).
    """

    channel: str
    time: float
    since: float
    size: float
    evidence: float
    follows: str


@dataclass(frozen=True)
class Report:
    """What watching a whole record found; lapses: when and why the promise did not hold."""

    blocks: int
    seconds: float
    alarm: Raised | None
    lapses: tuple[str, ...]


class Monitor:
    """Watches residuals (3,) with their time [s] and load [N]; the first alarm is latched."""

    def __init__(self, noise: Sequence[BlockNoise], settings: MonitorSettings) -> None:
        self._settings = settings
        self._whiteners = [Whitener(item) for item in noise]
        self._detector = Detector(
            len(noise), threshold_of(settings.false_alarm_hours, settings.block))
        self._materiality = np.array(settings.materiality)
        self._means: list[Array] = []
        self._begin, self._last = np.nan, np.nan
        self._sum, self._count = np.zeros(len(noise) + 1), 0
        self.alarm: Raised | None = None
        self.lapses: list[str] = []

    @property
    def blocks(self) -> int:
        """Blocks judged so far."""
        return self._detector.block

    def renew_zero(self, time: float) -> None:
        """The zero was taken anew: the evidence so far is of another zero."""
        self._lapse(time, 'the zero was renewed')

    def step(self, time: float, residual: Array, load: float) -> Raised | None:
        """Take one sample; the alarm when it is raised, None before and after."""
        if not (np.isfinite(residual).all() and np.isfinite(load)):
            return None
        if time - self._last > MAX_GAP * self._settings.block:
            self._lapse(time, f'no samples for {time - self._last:.3g} s')
        self._last = time
        raised = None
        if self._count and time - self._begin >= self._settings.block:
            raised = self._judge()
        if not self._count:
            self._begin = time
        self._sum[:-1] += residual
        self._sum[-1] += load
        self._count += 1
        return raised

    def _judge(self) -> Raised | None:
        mean = self._sum / self._count
        self._sum, self._count = np.zeros_like(self._sum), 0
        self._means.append(np.append(mean, self._begin))
        found = [whitener.step(float(value)) for whitener, value in
                 zip(self._whiteners, mean, strict=False)]
        innovations, scales = np.array(found).T
        alarm = self._detector.step(innovations, self._materiality / scales)
        if alarm is None or self.alarm is not None:
            return None
        self.alarm = self._raised(alarm)
        return self.alarm

    def _lapse(self, time: float, reason: str) -> None:
        self.lapses.append(f'{time:.3f} s: {reason}')
        self._sum, self._count = np.zeros_like(self._sum), 0
        for whitener in self._whiteners:
            whitener.reset()
        self._detector.reset()

    def _raised(self, alarm: Alarm) -> Raised:
        since = min(alarm.since, len(self._means) - 1)
        part = np.array(self._means[since:])
        return Raised(
            CHANNELS[alarm.channel], float(self._means[-1][-1]), float(part[0, -1]),
            float(part[:, alarm.channel].mean()), alarm.evidence,
            follows(part[:, alarm.channel], part[:, -2]))


def follows(residual: Array, load: Array) -> str:
    """Which of load, its rate and its direction the residual (N,) follows most closely."""
    if residual.size < 10:
        return ''
    rate = np.gradient(load)
    regressors = {'load': load, 'rate of the load': rate, 'direction of the load': np.sign(rate)}
    strength = {
        name: abs(float(np.corrcoef(residual, values)[0, 1]))
        for name, values in regressors.items() if np.ptp(values) > 0.0 and np.ptp(residual) > 0.0
    }
    best = max(strength, key=lambda name: strength[name], default='')
    return best if best and strength[best] > 0.5 else 'none of load, rate and direction'


def watch(
    time: Array, residual: Array, load: Array, noise: Sequence[BlockNoise],
    settings: MonitorSettings,
) -> Report:
    """Watch a record: time (N,) [s], residual (3, N) [m, m, rad], load (N,) [N]."""
    monitor = Monitor(noise, settings)
    for now, values, force in zip(time.tolist(), residual.T, load.tolist(), strict=True):
        monitor.step(now, values, force)
    return Report(monitor.blocks, monitor.blocks * settings.block, monitor.alarm,
                  tuple(monitor.lapses))
