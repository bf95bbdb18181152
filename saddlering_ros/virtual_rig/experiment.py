"""A test on the virtual rig: schedule of the load, physics of the ring, recorder of the bag.

The controller of the cylinder reaches static steps and dynamic ramps. Load, rollers, friction,
joints and probes follow. The recorder adds sampling, noise and quantisation.
"""

from dataclasses import dataclass, field, replace
import math
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from saddlering_ros.bags.write import write_bag
from saddlering_ros.errors import VirtualRigError
from saddlering_ros.record.record import TestMetadata
from saddlering_ros.rig import ContactParameters, FULL_SCALE_LOAD, Rig, TONNE
from saddlering_ros.virtual_rig import integrator as at
from saddlering_ros.virtual_rig.effects import EffectRequest
from saddlering_ros.virtual_rig.effects_probes import ProbeMotion, Recording
from saddlering_ros.virtual_rig.effects_ring import Floats, FrictionElements, LoadPath, Motion
from saddlering_ros.virtual_rig.integrator import low_pass, make_rollers, Scatter, slow_noise

Stamps = NDArray[np.int64]

CONTROLLER_LAG = {'static': 0.15, 'dynamic': 0.03}
"""Time constant [s] of each of the controller's two lags; they round corners and settle steps."""

LEAK_SHARE, LEAK_TIME = 4e-4, 4.0
"""A held load sags by this share of itself with this time constant [s]."""


@dataclass(frozen=True)
class Schedule:
    """A test: kind, loads [N] and times [s].

    static: hold at `lowest`, then one hold per step up to `peak` and back, reached by ramps of
    `ramp` seconds. dynamic: rest, ramp up, ramp down, rest; `ramp` is one way, `hold` the stay at
    the peak.
    """

    test: str
    peak: float
    lowest: float
    step: float
    hold: float
    ramp: float
    rest: float  # before the first and after the last move
    cycles: int
    step_error: float  # rms by which held loads miss their target

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

    rest [s]: length of each rest in place of an eighth; the ramp does not change.
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


HELD_SHARE = 0.5
"""Friction at the start takes at most this share of the force that acts on its element."""


@dataclass(frozen=True)
class PhysicalRig:
    """One particular rig: description, true contact law, scatter and number, and its faults."""

    rig: Rig
    contact: ContactParameters
    elevation: float
    effects: tuple[EffectRequest, ...] = ()
    scatter: Scatter = field(default_factory=Scatter)
    number: int = 1

    def act(self, stage: str, target: object) -> None:
        """Let the effects of a stage change its target in place."""
        for request in self.effects:
            if request.effect.stage == stage:
                request.effect.act(target, request.values, request.form)


@dataclass(frozen=True)
class PhysicalRun:
    """The motion before any instrument."""

    time: Floats  # (N,) [s]
    load: Floats  # (N,) [N] at an exact cell
    motion: Motion  # of C, absolute
    increments: Floats  # (4, N) [m]: at the probes since the start


def run_test(physical: PhysicalRig, load: Floats, step: float, seed: int = 0) -> PhysicalRun:
    """Let the rig go through `load` [N], given at thirds of equal steps, (3 N + 1,), `step` [s].

    It starts at rest under load[0]. VirtualRigError if the motion cannot be followed.
    """
    count = len(load)
    path = LoadPath(
        physical.rig, step / 3.0 * np.arange(count, dtype=np.float64), load, load.copy(),
        np.full(count, physical.elevation, dtype=np.float64),
        np.full(count, physical.rig.trunnion.y, dtype=np.float64))
    physical.act('load', path)
    # Forces [N] and moment [N m] at C, (N, 3), with the dead weight.
    cosine, sine = np.cos(path.elevation), np.sin(path.elevation)
    arm = path.trunnion_y * cosine + path.rig.trunnion.x * sine
    weight = path.rig.carriage.weight
    forces = np.stack([path.arriving * cosine, -path.arriving * sine - weight,
                       path.arriving * arm + weight * path.rig.carriage.weight_x], axis=1)
    rollers = make_rollers(physical.rig, physical.contact, physical.scatter, physical.number)
    physical.act('rollers', rollers)
    elements = FrictionElements([], [])
    physical.act('friction', elements)
    friction = np.array(elements.rows).reshape(-1, at.FRICTION_COLUMNS)
    force = forces[0]
    # Friction cannot push the ring: it takes half of its load at most.
    acting = np.abs(friction[:, :3] @ force)
    most = HELD_SHARE * acting / np.maximum(friction[:, at.F_LIMIT], 1e-12)
    z = np.clip(np.array(elements.initial), -most, most)
    mass = np.array([physical.rig.carriage.mass] * 2 + [physical.rig.carriage.inertia])
    # A position with the gaps closed on the side that the force presses on.
    start = np.array([np.copysign(0.5 * physical.rig.radial_row.clearance, force[0]),
                      np.copysign(0.5 * physical.rig.axial_rows.clearance, force[1]), 0.0])
    rest, failed_steps = at.settle(rollers.table, friction, z, mass, force, start)
    if failed_steps:
        raise VirtualRigError('the ring finds no rest at the start of the test: give a preload '
                              'above zero, or effects of smaller size')
    positions, failed_steps = at.integrate(rollers.table, friction, z, mass, rest, step, forces)
    if failed_steps > len(positions) // 1000 or not np.all(np.isfinite(positions)):
        raise VirtualRigError(f'the motion cannot be followed in {failed_steps} of '
                              f'{len(positions)} steps: give effects of smaller size')
    every = slice(None, None, 3)
    force_x, force_y, moment = forces[every].T
    x, y, tilt = positions.T.copy()
    motion = Motion(
        rig=physical.rig, time=path.time[every], x=x, y=y, tilt=tilt, force_x=force_x.copy(),
        force_y=force_y.copy(), moment=moment.copy(), load=path.arriving[every].copy())
    physical.act('motion', motion)
    # Motion (4, N) [m] of the ring at the four probes, for small tilts.
    probes = motion.rig.probes
    radial, lever = motion.x + motion.tilt * probes.radial_height, 0.5 * probes.axial_span
    increments = np.stack([radial, motion.y + lever * motion.tilt, -radial,
                           motion.y - lever * motion.tilt])
    seen = ProbeMotion(motion, increments - increments[:, :1], seed)
    physical.act('probes', seen)
    return PhysicalRun(motion.time, path.measured[every].copy(), motion, seen.increments)


LEVELS = 2**16  # of converters with 16 bits
CELL_SPAN = 3e5 / FULL_SCALE_LOAD
"""Span of the load cell to both sides over the full scale, in 2^16 levels."""

EPOCH = 1_760_000_000
"""Time [s since 1970], in October 2025, before which a test begins that states no other."""

RATES = {'static': 50.0, 'dynamic': 1000.0}
STEPS = {'static': 0.01, 'dynamic': 0.001}
"""Default sample rates [Hz] and integration steps [s]."""


@dataclass(frozen=True)
class Instruments:
    """How good the instruments are."""

    noise: float = 0.3e-6  # rms of a probe's total noise [m]
    slow_share: float = 0.3  # share of it that wanders (rms)
    slow_time: float = 4.0  # [s] of the wander
    load_noise: float = 50.0  # rms of the cell's white noise [N]; slow: a third of it
    jitter: float = 0.02  # rms of stamps as a share of the sampling period
    gap: float = 1e-3  # at zero [m]
    gap_scatter: float = 30e-6  # rms difference of the probes' gaps [m]
    quantised: bool = True


@dataclass(frozen=True)
class TestPlan:
    """A test to be generated: the rig, its schedule, its recording, the seed of chance."""

    __test__ = False

    physical: PhysicalRig
    schedule: Schedule
    seed: int = 0
    instruments: Instruments = field(default_factory=Instruments)
    rate: float | None = None
    probe_rate: float | None = None
    step: float | None = None
    rig_name: str = 'virtual rig'
    run_name: str = ''
    begin: int | None = None  # when it starts [whole s since 1970]; None leaves it to chance

    def __post_init__(self) -> None:
        for name in ('rate', 'probe_rate'):
            value = getattr(self, name)
            if value is not None and not 1.0 <= value <= 100e3:
                raise VirtualRigError(f'{name} is {value:g} Hz: give 1 to 100000')
        load_rate, probe_rate = self.rates
        samples = self.schedule.duration * (load_rate + 4.0 * probe_rate)
        if samples > 20e6:
            raise VirtualRigError(f'the test would have {samples:.3g} samples: give a lower '
                                  'rate or a shorter test (20 million at most)')
        if self.seed < 0:
            raise VirtualRigError(f'seed is {self.seed}: give a whole number from 0 up')

    @property
    def rates(self) -> tuple[float, float]:
        """Sample rates [Hz] of the load and of each probe."""
        load = RATES[self.schedule.test] if self.rate is None else self.rate
        return load, load if self.probe_rate is None else self.probe_rate


@dataclass(frozen=True)
class TestRecord:
    """Recorded samples: stamps int64 [ns], readings of the load [N] and of the gaps [m]."""

    __test__ = False

    facts: TestMetadata
    load_stamps: Stamps
    load: Floats
    probe_stamps: tuple[Stamps, ...]
    gaps: tuple[Floats, ...]
    log_delay: int
    truth: PhysicalRun


def record_test(plan: TestPlan) -> TestRecord:
    """Carry out the test and record it; the same plan gives the same record, bit for bit."""
    schedule, physical = plan.schedule, plan.physical
    chance = [np.random.default_rng([plan.seed, stream]) for stream in range(12)]
    step = plan.step if plan.step is not None else STEPS[schedule.test]
    steps = math.ceil(schedule.duration / step)
    load = controlled_load(schedule, step / 3.0, 3 * steps + 1, chance[0])
    run = run_test(physical, load, step, plan.seed)
    recording = Recording()
    physical.act('recording', recording)
    drawn = EPOCH - 3600 * int(chance[1].integers(0, 20_000))
    begin = drawn if plan.begin is None else plan.begin
    (load_rate, probe_rate), jitter = plan.rates, plan.instruments.jitter
    margin = 2.0 / min(load_rate, probe_rate)
    time = _instants(margin, run.time[-1] - margin, load_rate, jitter, chance[2])
    probe_times = [_instants(0.0, run.time[-1], probe_rate, jitter, chance[3 + probe])
                   for probe in range(4)]
    gaps = tuple(_gaps(plan, run, recording, probe, times, chance[7 + probe])
                 for probe, times in enumerate(probe_times))
    probe_stamps = tuple(
        _stamps(begin, times + recording.clock_offset + recording.clock_skew * times)
        for times in probe_times)
    facts = TestMetadata(schedule.test, math.degrees(physical.elevation), plan.rig_name,
                         plan.run_name)
    noise, random = plan.instruments.load_noise, chance[11]
    reading = _between(run.time, run.load, time) + noise * random.normal(size=len(time))
    reading += slow_noise(time, noise / 3.0, plan.instruments.slow_time, random)
    reading = np.minimum(reading, recording.load_limit)
    if plan.instruments.quantised:
        level = 2.0 * CELL_SPAN * physical.rig.full_scale_load / LEVELS
        reading = level * np.rint(reading / level)
    return TestRecord(
        facts, _stamps(begin, time), np.asarray(reading),
        probe_stamps, gaps, int(chance[1].integers(1_500, 9_000)) * 1000, run)


def write_record(path: Path | str, record: TestRecord, rig: Rig, *,
                 overwrite: bool = False) -> Path:
    """Write the record as a bag, complete or not at all; the hash of `rig` goes into it."""
    facts = replace(record.facts, details={**record.facts.details, 'rig_hash': rig.digest})
    return write_bag(path, facts, record.load_stamps, record.load, record.probe_stamps,
                     record.gaps, rig.probes, log_delay=record.log_delay, overwrite=overwrite)


def _instants(first: float, last: float, rate: float, jitter: float,
              random: np.random.Generator) -> Floats:
    """When samples are taken [s]: a random phase, then `rate` with jitter, in microseconds."""
    period = 1.0 / rate
    phase = random.uniform(0.05, 0.95) * period
    count = max(int((last - first - phase) * rate), 2)
    wander = np.clip(jitter * random.normal(size=count), -0.3, 0.3) * period
    instants = first + phase + period * np.arange(count) + wander
    return np.asarray(np.clip(np.round(instants, 6), first, last))


def _stamps(begin: int, seconds: Floats) -> Stamps:
    return np.asarray(begin * 1_000_000_000 + np.rint(seconds * 1e9).astype(np.int64))


def _gaps(plan: TestPlan, run: PhysicalRun, recording: Recording, probe: int, times: Floats,
          random: np.random.Generator) -> Floats:
    """Readings of one probe [m]: its motion, its noise, its amplifier, its converter."""
    instruments, probes = plan.instruments, plan.physical.rig.probes
    slow = instruments.noise * instruments.slow_share
    white = instruments.noise * math.sqrt(max(1.0 - instruments.slow_share**2, 0.0))
    offset = instruments.gap_scatter * random.normal()
    noise = white * random.normal(size=len(times))
    noise += slow_noise(times, slow, instruments.slow_time, random)
    increment = _between(run.time, run.increments[probe], times) + noise
    increment = recording.disturb(probe + 1, times, increment)
    gap = instruments.gap + offset + probes.polarity[probe] * increment
    level = (probes.max_range - probes.min_range) / LEVELS
    if instruments.quantised:
        gap = probes.min_range + level * np.rint((gap - probes.min_range) / level)
    return np.asarray(np.clip(gap, probes.min_range, probes.max_range))


def _between(grid: Floats, values: Floats, times: Floats) -> Floats:
    """Values at `times` by cubic interpolation on an even grid (Catmull and Rom)."""
    step = grid[1] - grid[0]
    place = np.clip((times / step).astype(np.int64), 0, len(grid) - 2)
    u = times / step - place
    before = values[np.maximum(place - 1, 0)]
    here, there = values[place], values[place + 1]
    after = values[np.minimum(place + 2, len(grid) - 1)]
    return np.asarray(here + 0.5 * u * (
        there - before + u * (2.0 * before - 5.0 * here + 4.0 * there - after
                              + u * (3.0 * (here - there) + after - before))))
