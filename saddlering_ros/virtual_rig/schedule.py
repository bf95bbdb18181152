"""Load courses of the hydraulic cylinder: static steps and dynamic ramps of a controller."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from saddlering_ros.errors import VirtualRigError
from saddlering_ros.rig import FULL_SCALE_LOAD, Rig, TONNE
from saddlering_ros.virtual_rig.numerics import low_pass

Floats = NDArray[np.float64]

CONTROLLER_LAG = {'static': 0.15, 'dynamic': 0.03}
"""Time constant [s] of each of the controller's two lags; they round corners and settle steps."""

LEAK_SHARE, LEAK_TIME = 4e-4, 4.0
"""A held load sags by this share of itself with this time constant [s]."""


@dataclass(frozen=True)
class Schedule:
    """A test: kind, peak, lowest load and step [N], hold, ramp and rest times [s], cycles.

    static: hold at `lowest`, then one hold per step up to `peak` and back, reached by ramps of
    `ramp` seconds. dynamic: rest, ramp up, ramp down, rest; `ramp` is one way, `hold` the stay at
    the peak. rest: before the first and after the last move. step_error: rms by which held
    loads miss their target [N].
    """

    test: str
    peak: float
    lowest: float
    step: float
    hold: float
    ramp: float
    rest: float
    cycles: int
    step_error: float

    def __post_init__(self) -> None:
        if self.test not in CONTROLLER_LAG:
            raise VirtualRigError(f'test is {self.test!r}: give static or dynamic')
        for name in ('step', 'ramp', 'rest'):
            if not 0.0 < getattr(self, name) < 1e7:
                raise VirtualRigError(
                    f'{name} is {getattr(self, name):g}: give a number above zero')
        if not 0.0 <= self.hold < 1e5 or (self.test == 'static' and self.hold == 0.0):
            raise VirtualRigError(f'hold is {self.hold:g} s: give seconds above zero')
        if not 0.0 <= self.lowest < self.peak < 1e8:
            raise VirtualRigError(f'loads from {self.lowest:g} to {self.peak:g} N make no test: '
                                  'give a peak above the preload')
        if self.cycles < 1:
            raise VirtualRigError(f'cycles is {self.cycles}: give 1 or more')
        if self.duration > 7200.0:
            raise VirtualRigError(f'the test would last {self.duration:.0f} s: give shorter '
                                  'holds, larger steps or fewer cycles (two hours at most)')

    def corners(self) -> tuple[Floats, Floats]:
        """Times [s] and loads [N] between which the set point is straight."""
        time, load = [0.0, self.rest], [self.lowest, self.lowest]
        for target in self._targets():
            time.append(time[-1] + self.ramp)
            load.append(target)
            stay = self.hold if self.test == 'static' or target == self.peak else 0.0
            time.append(time[-1] + stay)
            load.append(target)
        time.append(time[-1] + self.rest)
        load.append(load[-1])
        return np.array(time), np.array(load)

    @property
    def duration(self) -> float:
        """Length of the test [s]."""
        targets = self._targets()
        stays = len(targets) if self.test == 'static' else targets.count(self.peak)
        return 2.0 * self.rest + self.ramp * len(targets) + self.hold * stays

    def _targets(self) -> list[float]:
        if self.test == 'dynamic':
            return [self.peak, self.lowest] * self.cycles
        count = int(np.ceil(self.peak / self.step - 1e-9))
        if count * self.cycles > 10_000:
            raise VirtualRigError(f'step is {self.step:g} N: give a step of at least 1 kg')
        levels = [min(self.step * number, self.peak) for number in range(1, count + 1)]
        up = [level for level in levels if level > self.lowest]
        down = [*up[-2::-1], self.lowest]
        return (up + down) * self.cycles


def static_schedule(rig: Rig, *, hold: float = 5.0, step: float | None = None,
                    peak: float | None = None, cycles: int = 1,
                    lowest: float | None = None) -> Schedule:
    """0 to full scale and back in steps of a 25th; it starts and ends at the preload."""
    share = rig.full_scale_load / FULL_SCALE_LOAD
    return Schedule(
        test='static', peak=rig.full_scale_load if peak is None else peak,
        lowest=rig.preload if lowest is None else lowest,
        step=share * TONNE if step is None else step, hold=hold, ramp=1.0, rest=hold + 2.0,
        cycles=cycles, step_error=100.0 * share)


def dynamic_schedule(rig: Rig, *, duration: float = 10.0, speed: float = 1.0,
                     peak: float | None = None, cycles: int = 1, hold: float = 0.0,
                     lowest: float | None = None, rest: float | None = None) -> Schedule:
    """A ramp to full scale and back, `duration` [s], rests of an eighth; `speed` cuts the ramp.

    rest [s]: of each rest in place of an eighth; the ramp stays as it is.
    """
    if not 0.0 < duration <= 7200.0 or not 0.0 < speed <= 1000.0:
        raise VirtualRigError(f'a ramp test of {duration:g} s at {speed:g} times the speed: '
                              'give numbers above zero')
    eighth = max(duration / 8.0, 1.0)
    ramp = max(duration - 2.0 * eighth, 0.2 * duration) / 2.0 / speed
    return Schedule(
        test='dynamic', peak=rig.full_scale_load if peak is None else peak,
        lowest=rig.preload if lowest is None else lowest, step=TONNE, hold=hold, ramp=ramp,
        rest=eighth if rest is None else rest, cycles=cycles, step_error=0.0)


def controlled_load(schedule: Schedule, spacing: float, count: int,
                    random: np.random.Generator) -> Floats:
    """Load [N] at `count` instants `spacing` [s] apart, as the controller reaches it, (count,)."""
    time, target = schedule.corners()
    if schedule.step_error > 0.0:
        held = np.repeat(random.normal(0.0, schedule.step_error, (len(time) + 1) // 2), 2)
        target = np.where(target > schedule.lowest, target + held[:len(time)], target)
    instants = spacing * np.arange(count)
    load: Floats = np.interp(instants, time, target)
    moved = load - load[0]
    load = moved - LEAK_SHARE * low_pass(moved, spacing, LEAK_TIME) + load[0]
    for _ in range(2):
        load = low_pass(load, spacing, CONTROLLER_LAG[schedule.test])
    return load
